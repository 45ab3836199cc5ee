"""Reader of the Victoria Park recording: tree trunks seen by a forward laser of 180 degrees.

ACFR, University of Sydney (Guivant, Nebot). ``measurements.dat`` has one line per detection: time,
range, bearing from 0 (right) to pi (left) with pi/2 forward, trunk diameter. Lines of equal time
are one scan, so a scan that saw nothing is not in the file. Here bearings are the library's:
counter-clockwise from forward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mht_slam.arrays import FloatArray, IntArray, freeze
from mht_slam.association import MISSED
from mht_slam.datasets.location import data_folder, recording_file
from mht_slam.datasets.tables import FieldReader, read_text
from mht_slam.datasets.victoria_park_windows import (
    StraightWindow,
    TrackedDetection,
    read_tracks,
    read_windows,
)
from mht_slam.errors import RecordingError
from mht_slam.measurements import BearingScan

FOLDER = "victoria_park"
MEASUREMENTS_FILE = "measurements.dat"
WINDOWS_FILE = "straight_windows.csv"
TRACKS_FILE = "tracks.csv"

MEASUREMENT_FIELDS = ("time", "range", "bearing", "diameter")
BEARING_ROUNDING = 0.51e-5
"""Radians: the table of tracks has five decimals."""
RANGE_ROUNDING = 0.51e-3
"""Metres: it has three."""


@dataclass(frozen=True, eq=False)
class LaserScans:
    """The detections of all scans.

    Attributes
    ----------
    times : (n_scans,) seconds, increasing.
    scans : bearings with time, in the file's order (from right to left). No labels.
    ranges, diameters : for each scan the (n_detections,) distances and trunk diameters, metres.
    """

    times: FloatArray
    scans: tuple[BearingScan, ...]
    ranges: tuple[FloatArray, ...]
    diameters: tuple[FloatArray, ...]


@dataclass(frozen=True, eq=False)
class TrackedWindow:
    """A straight window with the identities and references that its tracks give.

    Attributes
    ----------
    window : its row of the table.
    identities : for each scan the (n_detections,) tracks, -1 for a detection in no track.
    reference_poses : (n_scans, 3) x, y in metres and theta in radians; the window's first pose is
        the origin. The pose of a scan without a tracked detection is interpolated in time from the
        scans around it.
    reference_landmarks : track to (x, y), metres, in the same frame.
    """

    window: StraightWindow
    identities: tuple[IntArray, ...]
    reference_poses: FloatArray
    reference_landmarks: dict[int, tuple[float, float]]


@dataclass(frozen=True, eq=False)
class VictoriaParkRecording:
    """The detections and the straight windows in which identities are known."""

    laser: LaserScans
    windows: tuple[TrackedWindow, ...]


def read_victoria_park(folder: Path | None = None) -> VictoriaParkRecording:
    """Read detections, straight windows and tracks.

    `folder` is the ``victoria_park`` folder; None looks in `data_folder()`. Raises
    `RecordingNotFoundError` where a file is missing and `RecordingError`, with file and line, where
    one is malformed, a track names no detection, or the tables contradict each other.
    """
    source = data_folder() / FOLDER if folder is None else Path(folder)
    laser = read_measurements(recording_file(source, MEASUREMENTS_FILE))
    windows_path = recording_file(source, WINDOWS_FILE)
    tracks_path = recording_file(source, TRACKS_FILE)
    windows = read_windows(windows_path, len(laser.scans))
    tracked: list[list[TrackedDetection]] = [[] for _ in windows]
    for detection in read_tracks(tracks_path):
        if not 0 <= detection.window < len(windows):
            raise _error(tracks_path, detection, "window", "no such window")
        tracked[detection.window].append(detection)
    return VictoriaParkRecording(
        laser,
        tuple(
            _tracked_window(laser, window, detections, windows_path, tracks_path)
            for window, detections in zip(windows, tracked, strict=True)
        ),
    )


def read_measurements(path: Path) -> LaserScans:
    """Read the detections; lines of equal time are one scan.

    Raises `RecordingError`, with file and line, for a wrong number of fields, a value that is not
    finite, or time that runs backwards.
    """
    times: list[float] = []
    scans: list[list[tuple[float, float, float]]] = []
    for line, text in enumerate(read_text(path).split("\n"), start=1):
        fields, read = text.split(), FieldReader(path, line)
        if not fields:
            continue
        if len(fields) != len(MEASUREMENT_FIELDS):
            raise read.error(
                "row", f"{len(fields)} fields", f"expected {' '.join(MEASUREMENT_FIELDS)}"
            )
        time, distance, bearing, diameter = (
            read.number(value, name) for value, name in zip(fields, MEASUREMENT_FIELDS, strict=True)
        )
        if times and time < times[-1]:
            raise read.error("time", fields[0], f"it runs backwards from {times[-1]}")
        if not times or time > times[-1]:
            times.append(time)
            scans.append([])
        scans[-1].append((distance, bearing - math.pi / 2, diameter))
    columns = [np.array(scan).T for scan in scans]
    return LaserScans(
        times=freeze(np.array(times)),
        scans=tuple(
            BearingScan(bearings, time=time)
            for time, (_, bearings, _) in zip(times, columns, strict=True)
        ),
        ranges=tuple(freeze(ranges.copy()) for ranges, _, _ in columns),
        diameters=tuple(freeze(diameters.copy()) for _, _, diameters in columns),
    )


def _tracked_window(
    laser: LaserScans,
    window: StraightWindow,
    tracked: list[TrackedDetection],
    windows_path: Path,
    tracks_path: Path,
) -> TrackedWindow:
    """Give every detection of the window its track, and every scan its pose."""
    identities = [np.full(len(laser.scans[scan]), MISSED, np.int64) for scan in window.scans]
    poses: dict[int, tuple[float, float, float]] = {}
    landmarks: dict[int, tuple[float, float]] = {}
    for detection in tracked:
        if detection.scan not in window.scans:
            raise _error(tracks_path, detection, "scan_index", "outside its window")
        if laser.times[detection.scan] != detection.time:
            raise _error(tracks_path, detection, "t_s", "the scan has another time")
        if poses.setdefault(detection.scan, detection.pose) != detection.pose:
            raise _error(tracks_path, detection, "ref_x", "the scan has another pose above")
        if landmarks.setdefault(detection.track, detection.landmark) != detection.landmark:
            raise _error(tracks_path, detection, "ref_lm_x", "the track lies elsewhere above")
        of_scan = identities[detection.scan - window.first_scan]
        if detection.track in of_scan:
            raise _error(tracks_path, detection, "track_in_window", "twice in one scan")
        of_scan[_detection_index(laser, detection, of_scan, tracks_path)] = detection.track
    counts = (
        sum(len(of_scan) for of_scan in identities),
        sum(int((of_scan == MISSED).sum()) for of_scan in identities),
    )
    if counts != (window.n_detections, window.n_untracked):
        raise RecordingError(
            f"{windows_path}: window {window.number}: n_dets, n_untracked_dets: {counts[0]} and "
            f"{counts[1]} are in the other files, {window.n_detections} and {window.n_untracked} "
            "here: take all files from one copy of the recording"
        )
    return TrackedWindow(
        window=window,
        identities=tuple(freeze(of_scan) for of_scan in identities),
        reference_poses=_interpolated(laser, window, poses, windows_path),
        reference_landmarks=landmarks,
    )


def _detection_index(
    laser: LaserScans, detection: TrackedDetection, of_scan: IntArray, path: Path
) -> int:
    """Return the one detection of the scan that has this bearing and range, up to rounding."""
    scan = laser.scans[detection.scan]
    near = np.flatnonzero(
        (np.abs(scan.bearings - detection.bearing) <= BEARING_ROUNDING)
        & (np.abs(laser.ranges[detection.scan] - detection.range) <= RANGE_ROUNDING)
        & (of_scan == MISSED)
    )
    if len(near) != 1:
        what = f"{len(near)} such detections"
        raise _error(path, detection, "bearing_rad_ccw_from_forward", what)
    return int(near[0])


def _interpolated(
    laser: LaserScans,
    window: StraightWindow,
    poses: dict[int, tuple[float, float, float]],
    path: Path,
) -> FloatArray:
    if not poses:
        raise RecordingError(f"{path}: window {window.number}: it has no track: leave it out")
    known = sorted(poses)
    columns = np.array([poses[scan] for scan in known]).T
    columns[2] = np.unwrap(columns[2])
    times, known_times = laser.times[list(window.scans)], laser.times[known]
    return freeze(np.stack([np.interp(times, known_times, column) for column in columns], axis=1))


def _error(path: Path, detection: TrackedDetection, field: str, what: str) -> RecordingError:
    value = {
        "window": detection.window,
        "scan_index": detection.scan,
        "t_s": detection.time,
        "track_in_window": detection.track,
        "ref_x": detection.pose,
        "ref_lm_x": detection.landmark,
        "bearing_rad_ccw_from_forward": detection.bearing,
    }[field]
    return FieldReader(path, detection.line).error(
        field, f"{value}: {what}", "take all files from one copy of the recording"
    )
