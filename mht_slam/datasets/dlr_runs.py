"""Straight runs cut from the DLR recording, with their true association."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from mht_slam.arrays import IntArray
from mht_slam.association import MISSED, Association
from mht_slam.datasets.dlr import DlrRecording
from mht_slam.datasets.dlr_segments import Segment
from mht_slam.errors import OptionError
from mht_slam.measurements import BearingScan, StraightRun

MIN_LANDMARKS = 3
"""Fewest landmarks of a run that tells associations apart."""


@dataclass(frozen=True, eq=False)
class LabelledRun:
    """A straight run of labelled detections of landmarks that all its scans see.

    Attributes
    ----------
    segment : where the run comes from.
    scan_indices : of its scans in the recording.
    run : bearings only. The order of the detections is random, from a generator seeded by the
        scan's index: the recording's own order goes roughly by distance and could tell them apart.
    truth : the true association, full.
    identities : the recording's landmark id of each row of `truth.table`.
    label_suspect : whether any label in it is suspect.
    """

    segment: Segment
    scan_indices: tuple[int, ...]
    run: StraightRun
    truth: Association
    identities: tuple[int, ...]
    label_suspect: bool

    @property
    def n(self) -> int:
        """Number of landmarks."""
        return self.truth.n_landmarks


def three_scan_runs(recording: DlrRecording, kind: str = "strict") -> list[LabelledRun]:
    """Return the run of the first, middle and last scan of every segment of this kind.

    Its landmarks are those labelled in all three scans, as many as there are, none chosen; runs
    of fewer than three are left out, since two carry the frame and leave nothing to compare. Raises
    `OptionError` for a kind the recording does not have.
    """
    chosen = [segment for segment in recording.segments if segment.kind == kind]
    if not chosen:
        kinds = sorted({segment.kind for segment in recording.segments})
        raise OptionError(f"kind is {kind!r}: the recording has segments of {kinds}")
    runs = [labelled_run(recording, segment, segment.first_middle_last) for segment in chosen]
    return [run for run in runs if run.n >= MIN_LANDMARKS]


def labelled_run(
    recording: DlrRecording, segment: Segment, scan_indices: Sequence[int]
) -> LabelledRun:
    """Return the run of these scans with only the landmarks labelled in every one of them."""
    labels = [recording.identities[scan] for scan in scan_indices]
    common = reduce(np.intersect1d, labels)
    common = common[common != MISSED]
    kept = [
        _shuffled(np.flatnonzero(np.isin(recording.identities[s], common)), s) for s in scan_indices
    ]
    truth = Association.from_labels(
        [ids[chosen].tolist() for ids, chosen in zip(labels, kept, strict=True)]
    )
    return LabelledRun(
        segment=segment,
        scan_indices=tuple(scan_indices),
        run=StraightRun(
            BearingScan(recording.scans[scan].bearings[chosen])
            for scan, chosen in zip(scan_indices, kept, strict=True)
        ),
        truth=truth,
        identities=tuple(labels[0][kept[0]][truth.table[:, 0]].tolist()),
        label_suspect=any(
            bool(recording.label_suspect[scan][chosen].any())
            for scan, chosen in zip(scan_indices, kept, strict=True)
        ),
    )


def _shuffled(detections: IntArray, seed: int) -> IntArray:
    return np.random.default_rng(seed).permutation(detections)
