"""A drive cuts into parts, keeps its truth apart, and hides the recording's own order."""

import numpy as np
import pytest

from mht_slam.association import Association
from mht_slam.datasets.drive import Drive, shuffled_drive, windows
from mht_slam.errors import OptionError
from mht_slam.measurements import BearingScan, Odometry

STEP = Odometry(1.0, 0.0, 0.1, [0.1, 0.1, 0.01])
SCANS = tuple(
    BearingScan(np.linspace(0.1, 1.0, n), time=float(k), odometry=STEP)
    for k, n in enumerate([3, 2, 0, 4, 1])
)
IDENTITIES = tuple(
    np.array(ids, dtype=np.int64) for ids in ([7, 3, -1], [3, 7], [], [9, 8, 7, -1], [9])
)
POSES = np.arange(15.0).reshape(5, 3)


def drive(**changes: object) -> Drive:
    named = {
        "name": "here",
        "scans": SCANS,
        "identities": IDENTITIES,
        "reference_poses": POSES,
        "reference_landmarks": {7: (0.0, 1.0)},
    }
    return Drive(**(named | changes))


def test_the_truth_is_the_identities() -> None:
    labels = [[None if i == -1 else i for i in ids.tolist()] for ids in IDENTITIES]
    assert drive().truth() == Association.from_labels(labels)
    assert drive().truth([3, 0]) == Association.from_labels([labels[3], labels[0]])


def test_a_part_begins_without_odometry_and_keeps_the_reference_frame() -> None:
    part = drive().part(1, 3)
    assert part.n_detections == (2, 0, 4)
    assert part.scans[0].odometry is None
    assert part.scans[1:] == SCANS[2:4]
    assert part.truth() == drive().truth().restrict([1, 2, 3])
    assert part.reference_poses.tolist() == POSES[1:4].tolist()
    assert part.reference_landmarks == {7: (0.0, 1.0)}
    assert part.has_odometry
    assert not drive(scans=tuple(BearingScan(s.bearings) for s in SCANS)).has_odometry


def test_stretches_are_cut_with_the_scans() -> None:
    stretched = drive(stretches=((0, 1), (3, 4)))
    assert drive().stretches == ((0, 4),)
    assert stretched.part(1, 3).stretches == ((0, 0), (2, 2))
    assert stretched.part(2, 2).stretches == ()


@pytest.mark.parametrize(("first", "last"), [(-1, 2), (2, 5), (3, 2)])
def test_scans_that_do_not_exist_are_refused(first: int, last: int) -> None:
    with pytest.raises(OptionError, match="has scans 0 to 4"):
        drive().part(first, last)


def test_lengths_that_disagree_are_refused() -> None:
    with pytest.raises(OptionError, match="one identity for each"):
        drive(identities=IDENTITIES[::-1])
    with pytest.raises(OptionError, match="reference_poses has shape"):
        drive(reference_poses=POSES[1:])


def test_windows_tile_the_drive_and_leave_a_rest_out() -> None:
    cut = windows(drive(), 2)
    assert [window.n_detections for window in cut] == [(3, 2), (0, 4)]


def test_shuffling_moves_identities_with_their_bearings_the_same_way_every_time() -> None:
    scans = [BearingScan(0.01 * np.arange(50), odometry=STEP) for _ in range(2)]
    ids = [np.arange(50)] * 2
    mixed, again = (shuffled_drive("mixed", scans, ids) for _ in range(2))
    for scan, of_scan in zip(mixed.scans, mixed.identities, strict=True):
        assert not np.array_equal(of_scan, np.arange(50))
        np.testing.assert_array_equal(scan.bearings, 0.01 * of_scan)
    assert mixed.scans == again.scans
    assert mixed.scans[0].odometry is None
    assert mixed.scans[1].odometry == STEP
