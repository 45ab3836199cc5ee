"""Straight runs cut from the DLR recording, with their true association."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import numpy as np

from mht_slam.arrays import IntArray
from mht_slam.association import MISSED
from mht_slam.datasets.dlr import DlrRecording
from mht_slam.datasets.dlr_segments import Segment
from mht_slam.datasets.labelled_runs import LabelledRun, assemble_run
from mht_slam.errors import OptionError, RecordingError

MIN_LANDMARKS = 3
"""Fewest landmarks of a run that tells associations apart."""


def three_scan_runs(recording: DlrRecording, kind: str = "strict") -> list[LabelledRun]:
    """Return the run of the first, middle and last scan of every segment of this kind.

    Its landmarks are those labelled in all three scans, as many as there are, none chosen; runs
    of fewer than three are left out, since two carry the frame and leave nothing to compare. Raises
    `OptionError` for a kind the recording does not have.
    """
    runs = [
        labelled_run(recording, segment, segment.first_middle_last)
        for segment in _segments(recording, kind)
    ]
    return [run for run in runs if run.n >= MIN_LANDMARKS]


def all_scan_runs(recording: DlrRecording, kind: str = "strict") -> list[LabelledRun]:
    """Return every scan of every segment of this kind, with the landmarks labelled in all of them.

    The truth is full. Runs of fewer than three common landmarks are left out. Raises `OptionError`
    for a kind the recording does not have.
    """
    runs = [
        labelled_run(recording, segment, segment.scans) for segment in _segments(recording, kind)
    ]
    return [run for run in runs if run.n >= MIN_LANDMARKS]


def relaxed_runs(recording: DlrRecording, kind: str = "relaxed") -> list[LabelledRun]:
    """Return every scan of every segment of this kind with all its detections.

    The truth has the misses and false alarms of the recording: identity -1 is a false alarm, a
    landmark labelled once a landmark seen once. Raises `OptionError` for a kind the recording does
    not have.
    """
    runs = []
    for segment in _segments(recording, kind):
        kept = [np.arange(len(recording.identities[scan])) for scan in segment.scans]
        runs.append(_run(recording, segment, segment.scans, kept))
    return runs


def labelled_run(
    recording: DlrRecording, segment: Segment, scan_indices: Sequence[int]
) -> LabelledRun:
    """Return the run of these scans with only the landmarks labelled in every one of them."""
    common = reduce(np.intersect1d, [recording.identities[scan] for scan in scan_indices])
    common = common[common != MISSED]
    kept = [np.flatnonzero(np.isin(recording.identities[scan], common)) for scan in scan_indices]
    return _run(recording, segment, scan_indices, kept)


def _segments(recording: DlrRecording, kind: str) -> list[Segment]:
    chosen = [segment for segment in recording.segments if segment.kind == kind]
    if not chosen:
        kinds = sorted({segment.kind for segment in recording.segments})
        raise OptionError(f"kind is {kind!r}: the recording has segments of {kinds}")
    return chosen


def _run(
    recording: DlrRecording,
    segment: Segment,
    scan_indices: Sequence[int],
    kept: Sequence[IntArray],
) -> LabelledRun:
    """Return the run of the kept detections of these scans."""
    if len(recording.reference_poses) != len(recording.scans):
        raise RecordingError(
            f"the recording has {len(recording.scans)} scans and "
            f"{len(recording.reference_poses)} reference poses: read it with read_dlr"
        )
    chosen = list(zip(scan_indices, kept, strict=True))
    return assemble_run(
        f"dlr {segment.kind} scans {segment.first_scan}-{segment.last_scan}",
        scan_indices,
        [recording.scans[scan].bearings[detections] for scan, detections in chosen],
        [recording.identities[scan][detections] for scan, detections in chosen],
        poses=recording.reference_poses[list(scan_indices)],
        landmarks=recording.reference_landmarks,
        label_suspect=any(
            bool(recording.label_suspect[scan][detections].any()) for scan, detections in chosen
        ),
    )
