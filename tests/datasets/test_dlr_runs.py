"""Runs cut from the recording hold the common landmarks, shuffled, and their truth."""

import numpy as np
import pytest

from mht_slam.association import MISSED
from mht_slam.datasets import DlrRecording, data_folder, labelled_run, read_dlr, three_scan_runs
from mht_slam.datasets.dlr_segments import Segment
from mht_slam.errors import OptionError, RecordingNotFoundError
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
    )


IDENTITIES = [[5, 2, -1, 9, 7], [1, 1, 1], [2, 9, 5, -1], [3], [9, -1, 2, 5, 7]]


def assert_truth_reproduces_the_labels(recording, labelled):
    for row, identity in zip(labelled.truth.table, labelled.identities, strict=True):
        for column, scan in enumerate(labelled.scan_indices):
            (original,) = np.flatnonzero(recording.identities[scan] == identity)
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
    strict = [segment for segment in recording.segments if segment.kind == "strict"]
    assert min(labelled_run(recording, s, s.scans).n for s in strict) >= 3
