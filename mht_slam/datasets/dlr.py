"""Reader of the DLR spatial cognition recording: identical discs seen by a forward camera.

Kurlbaum and Frese, "A Benchmark Data Set for Data Association". The original file is
``map.circles``; the CSV files beside it hold the same observations as bearings, least-squares
reference poses and landmarks, and nearly straight segments.

The file's robot frame has X to the right and -Y forward and is left-handed: a positive dPhi is a
right turn. Everything here is in the library's frame, x forward, y left, angles counter-clockwise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray, freeze
from mht_slam.association import MISSED, Association
from mht_slam.datasets.dlr_segments import Segment, read_segments
from mht_slam.datasets.location import data_folder, recording_file
from mht_slam.datasets.tables import FieldReader, read_table, read_text
from mht_slam.errors import MeasurementError, RecordingError
from mht_slam.measurements import BearingScan, Odometry

FOLDER = "dlr"
MAP_FILE = "map.circles"
OBSERVATIONS_FILE = "observations.csv"
SEGMENTS_FILE = "segments.csv"
REFERENCE_POSES_FILE = "reference_poses.csv"
REFERENCE_LANDMARKS_FILE = "reference_landmarks.csv"

STEP_FIELDS = ("image", "dX", "dY", "dPhi", "cXX", "cXY", "cYY", "cXPhi", "cYPhi", "cPhiPhi")
LANDMARK_FIELDS = ("pX", "pY", "quality", "cXX", "cXY", "cYY", "ID")

OWN_FROM_FILE_AXES = freeze(np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]))
"""Takes (dX, dY, dPhi) of the file to our (dx forward, dy left, dtheta counter-clockwise)."""


@dataclass(frozen=True, eq=False)
class DlrRecording:
    """The recording: bearings as a method may see them, and apart from them what it may not.

    Attributes
    ----------
    scans : bearings in the file's order (the detector's, roughly from far to near) with odometry
        since the previous scan where the source has it. No labels, no ranges.
    identities : for each scan the (n_detections,) landmark ids, -1 for a false detection.
    ranges : for each scan the (n_detections,) distances, metres.
    qualities : for each scan the (n_detections,) detector confidences, 0 to 1.
    label_suspect : for each scan (n_detections,) bool. From the CSV: the label lies far from its
        landmark. From ``map.circles``: the detection has several ids, of which the first is kept.
    segments : nearly straight stretches, empty where they were not read.
    reference_poses : (n_scans, 3) least-squares x, y in metres and theta in radians, x forward and
        y left of the first pose; (0, 3) where they were not read.
    reference_landmarks : id to (x, y), metres, in the frame of the poses; empty where they were
        not read.
    """

    scans: tuple[BearingScan, ...]
    identities: tuple[IntArray, ...]
    ranges: tuple[FloatArray, ...]
    qualities: tuple[FloatArray, ...]
    label_suspect: tuple[BoolArray, ...]
    segments: tuple[Segment, ...] = ()
    reference_poses: FloatArray = field(default_factory=lambda: freeze(np.empty((0, 3))))
    reference_landmarks: Mapping[int, tuple[float, float]] = field(default_factory=dict)

    def truth(self, scans: Sequence[int]) -> Association:
        """Return the labelled association of these scans, for evaluation."""
        return Association.from_labels(
            [
                [None if label == MISSED else label for label in self.identities[scan].tolist()]
                for scan in scans
            ]
        )


def read_dlr(folder: Path | None = None) -> DlrRecording:
    """Read the whole recording: ``map.circles``, suspect labels, segments and references.

    `folder` is the ``dlr`` folder; None looks in `data_folder()`. Raises `RecordingNotFoundError`
    where a file is missing and `RecordingError`, with file and line, where one is malformed or
    the two sources disagree.
    """
    source = data_folder() / FOLDER if folder is None else Path(folder)
    recording = read_map_circles(recording_file(source, MAP_FILE))
    path = recording_file(source, OBSERVATIONS_FILE)
    observations = read_observations(path, n_scans=len(recording.scans))
    for scan, (one, other) in enumerate(
        zip(recording.identities, observations.identities, strict=True)
    ):
        if not np.array_equal(one, other):
            raise RecordingError(
                f"{path}: scan {scan}: its identities differ from those of {MAP_FILE}: "
                "take both files from one copy of the recording"
            )
    poses_path = recording_file(source, REFERENCE_POSES_FILE)
    poses = read_reference_poses(poses_path)
    if len(poses) != len(recording.scans):
        raise RecordingError(
            f"{poses_path}: {len(poses)} poses for the {len(recording.scans)} scans of "
            f"{MAP_FILE}: take both files from one copy of the recording"
        )
    return DlrRecording(
        scans=recording.scans,
        identities=recording.identities,
        ranges=recording.ranges,
        qualities=recording.qualities,
        label_suspect=observations.label_suspect,
        segments=read_segments(recording_file(source, SEGMENTS_FILE), len(recording.scans)),
        reference_poses=poses,
        reference_landmarks=read_reference_landmarks(
            recording_file(source, REFERENCE_LANDMARKS_FILE)
        ),
    )


def read_map_circles(path: Path) -> DlrRecording:
    """Read the original format, which its own header describes; one scan per STEP.

    Raises `RecordingError` with file and line for an unknown record, a wrong number of fields, a
    value that is not finite, a landmark before the first STEP or one seen twice in a scan.
    """
    steps: list[Odometry] = []
    detections: list[list[_Detection]] = []
    for line, name, fields in _records(path):
        read = FieldReader(path, line)
        if name == "STEP":
            steps.append(_odometry(fields, read))
            detections.append([])
        elif name.startswith("LANDMARK"):
            if not detections:
                raise read.error(name, "before the first STEP", "begin with a STEP")
            detections[-1].append(_detection(fields, read))
            _check_single(detections[-1], read)
        else:
            raise read.error(name, "unknown record", "STEP and LANDMARK are known")
    return _recording(detections, steps)


def read_observations(path: Path, n_scans: int | None = None) -> DlrRecording:
    """Read ``observations.csv``: the same detections without odometry.

    `n_scans` is the number of scans, for those that saw nothing; None ends at the last detection.
    Raises `RecordingError` with file and line.
    """
    detections: list[list[_Detection]] = [[] for _ in range(n_scans or 0)]
    columns = ("scan", "bearing_rad_ccw_from_forward", "range_m", "quality", "id", "label_suspect")
    for read, row in read_table(path, columns):
        scan = read.whole(row["scan"], "scan")
        if scan < 0 or (n_scans is not None and scan >= n_scans):
            raise read.error("scan", f"{scan}", "it is outside the recording")
        detections.extend([] for _ in range(scan + 1 - len(detections)))
        detections[scan].append(
            _Detection(
                bearing=read.number(row["bearing_rad_ccw_from_forward"], "bearing"),
                range=read.number(row["range_m"], "range_m"),
                quality=read.number(row["quality"], "quality"),
                identity=read.whole(row["id"], "id"),
                suspect=read.whole(row["label_suspect"], "label_suspect") != 0,
            )
        )
        _check_single(detections[scan], read)
    return _recording(detections, None)


def read_reference_poses(path: Path) -> FloatArray:
    """Read the least-squares poses, (n_scans, 3) x, y in metres and theta in radians.

    They used odometry, bearings, ranges and identities. Frame: x forward and y left of the first
    pose. Raises `RecordingError` with file and line.
    """
    poses: list[list[float]] = []
    for read, row in read_table(path, ("scan", "x_m", "y_m", "theta_rad")):
        if read.whole(row["scan"], "scan") != len(poses):
            raise read.error("scan", row["scan"], f"scan {len(poses)} comes here")
        poses.append([read.number(row[name], name) for name in ("x_m", "y_m", "theta_rad")])
    return freeze(np.array(poses).reshape(-1, 3))


def read_reference_landmarks(path: Path) -> dict[int, tuple[float, float]]:
    """Read the least-squares landmarks, id to (x, y) in metres, in the frame of the poses.

    Raises `RecordingError` with file and line.
    """
    landmarks: dict[int, tuple[float, float]] = {}
    for read, row in read_table(path, ("id", "x_m", "y_m")):
        identity = read.whole(row["id"], "id")
        if identity in landmarks:
            raise read.error("id", f"{identity} is there twice", "give each landmark once")
        landmarks[identity] = (read.number(row["x_m"], "x_m"), read.number(row["y_m"], "y_m"))
    return landmarks


@dataclass(frozen=True)
class _Detection:
    bearing: float
    range: float
    quality: float
    identity: int
    suspect: bool


def _records(path: Path) -> Iterator[tuple[int, str, list[str]]]:
    """Yield line number, record name and fields of every line that is neither blank nor comment."""
    for line, text in enumerate(read_text(path).split("\n"), start=1):
        words = text.split()
        if words and not words[0].startswith("#"):
            yield line, words[0], words[1:]


def _odometry(fields: list[str], read: FieldReader) -> Odometry:
    if len(fields) != len(STEP_FIELDS):
        raise read.error(
            "STEP", f"{len(fields)} fields", f"it has {len(STEP_FIELDS)}: {' '.join(STEP_FIELDS)}"
        )
    named = dict(zip(STEP_FIELDS, fields, strict=True))
    motion = np.array([read.number(named[name], name) for name in ("dX", "dY", "dPhi")])
    xx, xy, yy, x_phi, y_phi, phi_phi = (read.number(named[name], name) for name in STEP_FIELDS[4:])
    covariance = np.array([[xx, xy, x_phi], [xy, yy, y_phi], [x_phi, y_phi, phi_phi]])
    dx, dy, dtheta = OWN_FROM_FILE_AXES @ motion
    try:
        return Odometry(dx, dy, dtheta, OWN_FROM_FILE_AXES @ covariance @ OWN_FROM_FILE_AXES.T)
    except MeasurementError as cause:
        raise read.error("STEP", str(cause), "give a covariance") from cause


def _detection(fields: list[str], read: FieldReader) -> _Detection:
    if len(fields) < len(LANDMARK_FIELDS):
        raise read.error(
            "LANDMARK",
            f"{len(fields)} fields",
            f"it has {len(LANDMARK_FIELDS)} or more: {' '.join(LANDMARK_FIELDS)}",
        )
    named = dict(zip(LANDMARK_FIELDS, fields, strict=False))
    right, backward = (read.number(named[name], name) for name in ("pX", "pY"))
    for name in ("cXX", "cXY", "cYY"):
        read.number(named[name], name)
    identities = [read.whole(word, "ID") for word in fields[len(LANDMARK_FIELDS) - 1 :]]
    return _Detection(
        bearing=math.atan2(-right, -backward),
        range=math.hypot(right, backward),
        quality=read.number(named["quality"], "quality"),
        identity=identities[0],
        suspect=len(identities) > 1,
    )


def _check_single(detections: list[_Detection], read: FieldReader) -> None:
    """Raise unless the newest detection of the scan is a new landmark or a false one."""
    newest = detections[-1].identity
    if newest < MISSED:
        raise read.error("ID", f"{newest} is no identity", "-1 is a false detection")
    if newest != MISSED and newest in [earlier.identity for earlier in detections[:-1]]:
        raise read.error("ID", f"landmark {newest} is there twice", "a scan sees it at most once")


def _recording(
    detections: list[list[_Detection]], steps: Sequence[Odometry] | None
) -> DlrRecording:
    odometry: Sequence[Odometry | None] = [None] * len(detections) if steps is None else steps
    return DlrRecording(
        scans=tuple(
            BearingScan(np.array([d.bearing for d in scan], dtype=np.float64), odometry=step)
            for scan, step in zip(detections, odometry, strict=True)
        ),
        identities=tuple(
            freeze(np.array([d.identity for d in scan], dtype=np.int64)) for scan in detections
        ),
        ranges=tuple(
            freeze(np.array([d.range for d in scan], dtype=np.float64)) for scan in detections
        ),
        qualities=tuple(
            freeze(np.array([d.quality for d in scan], dtype=np.float64)) for scan in detections
        ),
        label_suspect=tuple(
            freeze(np.array([d.suspect for d in scan], dtype=np.bool_)) for scan in detections
        ),
    )
