"""A straight run with what its recording knows of it: true association, reference poses and map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import FloatArray, IntArray, freeze
from mht_slam.association import MISSED, Association
from mht_slam.errors import RecordingError
from mht_slam.measurements import BearingScan, StraightRun


@dataclass(frozen=True, eq=False)
class LabelledRun:
    """A straight run cut from a recording, with its truth, which no method may see.

    Attributes
    ----------
    name : recording, kind and place of the run: "dlr strict scans 5-13".
    scan_indices : of its scans in the recording.
    run : bearings only. The order of the detections is random, from a generator seeded by the
        scan's index: a recording's own order goes by distance or by angle and could tell them
        apart.
    truth : the true association. A detection without an identity is a false alarm.
    identities : the recording's landmark id of each row of `truth.table`.
    reference_poses : (m, 3) x, y in metres and theta in radians of the m scans, in the recording's
        frame; forward is along theta.
    reference_landmarks : (n, 2) metres, in the frame of the poses, one for each row of
        `truth.table`.
    label_suspect : whether any label in it is suspect.
    """

    name: str
    scan_indices: tuple[int, ...]
    run: StraightRun
    truth: Association
    identities: tuple[int, ...]
    reference_poses: FloatArray
    reference_landmarks: FloatArray
    label_suspect: bool = False

    @property
    def n(self) -> int:
        """Number of landmarks."""
        return self.truth.n_landmarks


def assemble_run(
    name: str,
    scan_indices: Sequence[int],
    bearings: Sequence[FloatArray],
    identities: Sequence[IntArray],
    *,
    poses: FloatArray,
    landmarks: Mapping[int, tuple[float, float]],
    label_suspect: bool = False,
) -> LabelledRun:
    """Shuffle the detections of each scan and give the run with its truth.

    Parameters
    ----------
    scan_indices : m indices in the recording, which also seed the shuffles.
    bearings, identities : for each scan its (n_detections,) bearings, radians counter-clockwise
        from forward, and landmark ids, -1 for a false alarm.
    poses : (m, 3) reference poses of these scans.
    landmarks : reference position of each id.

    Raises `RecordingError` for an identity without a reference position.
    """
    orders = [
        np.random.default_rng(scan).permutation(len(of_scan))
        for scan, of_scan in zip(scan_indices, bearings, strict=True)
    ]
    shuffled = [ids[order].tolist() for ids, order in zip(identities, orders, strict=True)]
    truth = Association.from_labels(
        [[None if i == MISSED else i for i in scan_ids] for scan_ids in shuffled]
    )
    ids_of_rows = tuple(_identity(row.tolist(), shuffled) for row in truth.table)
    absent = [i for i in ids_of_rows if i not in landmarks]
    if absent:
        raise RecordingError(
            f"{name}: landmark {absent[0]} has no reference position: "
            "read the recording with its reference map"
        )
    return LabelledRun(
        name=name,
        scan_indices=tuple(scan_indices),
        run=StraightRun(
            BearingScan(scan[order]) for scan, order in zip(bearings, orders, strict=True)
        ),
        truth=truth,
        identities=ids_of_rows,
        reference_poses=freeze(np.array(poses, dtype=np.float64).reshape(len(scan_indices), 3)),
        reference_landmarks=freeze(np.array([landmarks[i] for i in ids_of_rows]).reshape(-1, 2)),
        label_suspect=label_suspect,
    )


def _identity(row: Sequence[int], identities: Sequence[Sequence[int]]) -> int:
    """Return the id behind a row of the truth's table."""
    return next(ids[entry] for ids, entry in zip(identities, row, strict=True) if entry != MISSED)
