"""Runs cut from the recording hold the common landmarks, shuffled, and their truth."""

from dataclasses import replace

import numpy as np
import pytest

from mht_slam.association import MISSED
from mht_slam.datasets import (
    DlrRecording,
    all_scan_runs,
    data_folder,
    labelled_run,
    read_dlr,
    relaxed_runs,
    three_scan_runs,
)
from mht_slam.datasets.dlr_segments import Segment
from mht_slam.errors import OptionError, RecordingError, RecordingNotFoundError
from mht_slam.measurements import BearingScan


def small_recording(identities, suspects=()):
    segment = Segment("strict", 0, len(identities) - 1, 1.0, 0.0, 0.0, 3, 3, 0)
    return DlrRecording(
        # The bearing tells scan and landmark, so that a wrong truth cannot hide.
        scans=tuple(
            BearingScan([0.1 * scan + 0.001 * i for i in ids])
            for scan, ids in enumerate(identities)
        ),
        identities=tuple(np.array(ids) for ids in identities),
        ranges=tuple(np.ones(len(ids)) for ids in identities),
        qualities=tuple(np.ones(len(ids)) for ids in identities),
        label_suspect=tuple(
            np.array([(scan, i) in suspects for i in ids]) for scan, ids in enumerate(identities)
        ),
        segments=(segment,),
        reference_poses=np.array([[0.5 * scan, 0.0, 0.1] for scan in range(len(identities))]),
        reference_landmarks={i: (float(i), -float(i)) for i in range(20)},
    )


IDENTITIES = [[5, 2, -1, 9, 7], [1, 1, 1], [2, 9, 5, -1], [3], [9, -1, 2, 5, 7]]


def assert_truth_reproduces_the_labels(recording, labelled):
    for row, identity in zip(labelled.truth.table, labelled.identities, strict=True):
        for column, scan in enumerate(labelled.scan_indices):
            originals = np.flatnonzero(recording.identities[scan] == identity)
            assert len(originals) == (row[column] != MISSED)
            if row[column] == MISSED:
                continue
            (original,) = originals
            measured = labelled.run.scans[column].bearings[row[column]]
            assert measured == recording.scans[scan].bearings[original]


def test_a_run_takes_the_first_the_middle_and_the_last_scan_and_what_they_share():
    recording = small_recording(IDENTITIES)
    (labelled,) = three_scan_runs(recording)
    assert labelled.scan_indices == (0, 2, 4)
    assert sorted(labelled.identities) == [2, 5, 9]
    assert labelled.n == 3
    assert labelled.truth.is_full
    assert all(scan.labels is None for scan in labelled.run.scans)
    assert_truth_reproduces_the_labels(recording, labelled)


def test_a_run_of_all_scans_takes_what_every_scan_of_the_segment_shares():
    recording = small_recording([[5, 2, -1, 9, 7], [1, 9, 2, 5], [2, 9, 5, -1], [9, 2, 7, 5]])
    (labelled,) = all_scan_runs(recording)
    assert labelled.scan_indices == (0, 1, 2, 3)
    assert sorted(labelled.identities) == [2, 5, 9]
    assert labelled.truth.is_full
    assert_truth_reproduces_the_labels(recording, labelled)
    assert all_scan_runs(small_recording(IDENTITIES)) == []


def test_a_run_of_all_detections_has_misses_and_false_alarms():
    recording = small_recording([[5, 2, -1, 9, 7], [1], [2, 9, 5, -1], [], [9, -1, 2, 5, 7]])
    (labelled,) = relaxed_runs(recording, kind="strict")
    assert labelled.run.n_detections == (5, 1, 4, 0, 5)
    assert sorted(labelled.identities) == [1, 2, 5, 7, 9]
    assert len(labelled.truth.false_alarms) == 3
    assert_truth_reproduces_the_labels(recording, labelled)
    for scan, detection in labelled.truth.false_alarms:
        bearing = labelled.run.scans[scan].bearings[detection]
        assert bearing == pytest.approx(0.1 * scan - 0.001)


def test_references_belong_to_the_scans_and_to_the_rows_of_the_truth():
    (labelled,) = three_scan_runs(small_recording(IDENTITIES))
    assert labelled.reference_poses.tolist() == [[0.0, 0.0, 0.1], [1.0, 0.0, 0.1], [2.0, 0.0, 0.1]]
    assert labelled.reference_landmarks.tolist() == [[i, -i] for i in labelled.identities]


def test_a_recording_without_its_references_makes_no_run():
    recording = small_recording(IDENTITIES)
    with pytest.raises(RecordingError, match="0 reference poses"):
        three_scan_runs(replace(recording, reference_poses=np.empty((0, 3))))
    with pytest.raises(RecordingError, match=r"landmark \d has no reference position"):
        three_scan_runs(replace(recording, reference_landmarks={}))


def test_suspect_labels_count_where_they_are_used():
    assert three_scan_runs(small_recording(IDENTITIES, {(2, 9)}))[0].label_suspect
    assert not three_scan_runs(small_recording(IDENTITIES, {(0, 7), (0, -1)}))[0].label_suspect


def test_fewer_than_three_common_landmarks_make_no_run():
    assert three_scan_runs(small_recording([[1, 2, 3], [1, 2], [1, 2, 3]])) == []


def test_a_kind_that_the_recording_does_not_have_is_refused():
    with pytest.raises(OptionError, match="strict"):
        three_scan_runs(small_recording(IDENTITIES), kind="curved")


def test_the_order_of_detections_is_not_that_of_the_recording():
    ids = list(range(12))
    labelled = labelled_run(
        small_recording([ids] * 3), small_recording([ids] * 3).segments[0], range(3)
    )
    columns = labelled.truth.table[:, 1:]
    assert (columns != np.arange(12)[:, None]).any(axis=0).all()
    again = labelled_run(
        small_recording([ids] * 3), small_recording([ids] * 3).segments[0], range(3)
    )
    assert again.truth == labelled.truth
    assert again.run == labelled.run


@pytest.fixture(scope="module")
def recording():
    try:
        return read_dlr(data_folder() / "dlr")
    except RecordingNotFoundError as reason:
        pytest.skip(str(reason))


def test_the_strict_segments_give_82_runs_without_a_suspect_label(recording):
    runs = three_scan_runs(recording)
    sizes, counts = np.unique([labelled.n for labelled in runs], return_counts=True)
    assert dict(zip(sizes.tolist(), counts.tolist(), strict=True)) == {3: 40, 4: 24, 5: 10, 6: 8}
    assert not any(labelled.label_suspect for labelled in runs)
    for labelled in runs:
        assert MISSED not in labelled.identities
        assert labelled.truth.is_full
        assert_truth_reproduces_the_labels(recording, labelled)


def test_all_scans_of_a_strict_segment_share_three_landmarks_or_more(recording):
    runs = all_scan_runs(recording)
    assert len(runs) == 82
    assert min(labelled.n for labelled in runs) == 3
    assert all(labelled.truth.is_full for labelled in runs)


def test_the_relaxed_segments_keep_every_detection_and_every_false_alarm(recording):
    runs = relaxed_runs(recording)
    segments = [segment for segment in recording.segments if segment.kind == "relaxed"]
    for labelled, segment in zip(runs, segments, strict=True):
        assert len(labelled.truth.false_alarms) == segment.n_false_detections
        assert sum(labelled.run.n_detections) == sum(
            len(recording.scans[scan]) for scan in segment.scans
        )
        assert_truth_reproduces_the_labels(recording, labelled)


def test_the_references_explain_the_labelled_bearings_of_the_recording(recording):
    errors = [
        np.angle(np.exp(1j * (bearing - expected)))
        for labelled in relaxed_runs(recording)
        for (x, y, theta), scan, rows in zip(
            labelled.reference_poses,
            labelled.run.scans,
            labelled.truth.landmark_of_detection(),
            strict=True,
        )
        for bearing, (lx, ly) in zip(
            scan.bearings[rows != MISSED],
            labelled.reference_landmarks[rows[rows != MISSED]],
            strict=True,
        )
        for expected in [np.arctan2(ly - y, lx - x) - theta]
    ]
    # Reference poses that belong to other scans would miss by tens of degrees.
    assert np.quantile(np.abs(errors), 0.95) < np.deg2rad(1.5)
