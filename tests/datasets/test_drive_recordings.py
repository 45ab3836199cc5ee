"""The recordings as drives: odometry leads from scan to scan, references fit what was seen."""

from pathlib import Path

import numpy as np
import pytest

from mht_slam.association import MISSED
from mht_slam.datasets import (
    car_park_drive,
    data_folder,
    dlr_drive,
    mrclam_drive,
    victoria_park_drive,
    victoria_park_windows,
)
from mht_slam.datasets.drive import Drive
from mht_slam.datasets.drive_odometry import relative_motions
from mht_slam.errors import RecordingNotFoundError
from mht_slam.measurements import wrap_angle


@pytest.fixture(scope="module")
def recordings() -> Path:
    try:
        return data_folder()
    except RecordingNotFoundError as reason:
        pytest.skip(str(reason))


@pytest.fixture(scope="module")
def park_windows(recordings: Path) -> list[Drive]:
    return victoria_park_windows(recordings / "victoria_park")


def bearing_residuals(drive: Drive) -> np.ndarray:
    """Measured minus reference bearing of every detection with a known landmark, radians."""
    found = []
    for scan, ids, (x, y, theta) in zip(
        drive.scans, drive.identities, drive.reference_poses, strict=True
    ):
        for bearing, i in zip(scan.bearings, ids.tolist(), strict=True):
            if i in drive.reference_landmarks:
                a, b = drive.reference_landmarks[i]
                found.append(wrap_angle(bearing - np.arctan2(b - y, a - x) + theta))
    return np.array(found)


def odometry_errors(drive: Drive) -> np.ndarray:
    """(m - 1, 3) odometry minus reference motion."""
    steps = [scan.odometry for scan in drive.scans[1:]]
    said = np.array([[step.dx, step.dy, step.dtheta] for step in steps])
    errors = said - relative_motions(drive.reference_poses)
    return np.column_stack([errors[:, :2], wrap_angle(errors[:, 2])])


def whitened(drive: Drive) -> np.ndarray:
    """The same in standard deviations of the stated covariance."""
    stated = [np.sqrt(np.diag(scan.odometry.covariance)) for scan in drive.scans[1:]]
    return odometry_errors(drive) / stated


def mad(errors: np.ndarray) -> np.ndarray:
    return 1.4826 * np.median(np.abs(errors), axis=0)


@pytest.mark.usefixtures("recordings")
def test_dlr_is_one_drive_with_odometry_and_a_reference_that_fits() -> None:
    drive = dlr_drive()
    assert len(drive) == 2200
    assert drive.has_odometry
    assert all(s.odometry.covariance is not None for s in drive.scans[1:])
    assert np.degrees(np.median(np.abs(bearing_residuals(drive)))) < 0.3
    assert np.all(np.median(np.abs(odometry_errors(drive)), axis=0) < [0.01, 0.01, 0.02])


@pytest.mark.usefixtures("recordings")
def test_the_car_park_steers_like_the_car_of_the_same_group() -> None:
    drive = car_park_drive()
    assert len(drive) == 281
    assert len(drive.reference_landmarks) == 15
    assert np.degrees(mad(bearing_residuals(drive))) < 0.2
    assert np.all(mad(whitened(drive)) < 1.0)


def test_victoria_park_odometry_agrees_with_the_windows(park_windows: list[Drive]) -> None:
    parts = park_windows
    assert len(parts) == 111
    tracked = [(np.concatenate(part.identities) != MISSED).mean() for part in parts]
    assert np.mean(tracked) > 0.8
    errors = np.concatenate([whitened(part) for part in parts])
    assert np.all(mad(errors) < 1.2)
    assert np.degrees(mad(np.concatenate([bearing_residuals(part) for part in parts]))) < 0.2


def test_windows_that_share_a_scan_are_one_stretch_of_the_whole_park(
    park_windows: list[Drive],
) -> None:
    whole, parts = victoria_park_drive(), park_windows
    assert len(whole) == 4207
    assert whole.has_odometry
    assert len(whole.stretches) == 111 - 57
    first, last = whole.stretches[0]
    assert (first, last) == (0, 128)
    longer = whole.part(first, last)
    assert longer.truth().n_landmarks < sum(part.truth().n_landmarks for part in parts[:4])
    inside = whole.part(40, 80).truth([*range(41)])
    assert inside.n_landmarks == parts[1].truth().n_landmarks + only_before(whole, 40)


def only_before(whole: Drive, scan: int) -> int:
    """Detections of a shared scan whose track ends with it."""
    ahead = np.concatenate(whole.identities[scan + 1 : scan + 41])
    return int(np.sum([i != MISSED and i not in ahead for i in whole.identities[scan].tolist()]))


@pytest.mark.usefixtures("recordings")
def test_a_robot_of_mrclam_sees_landmarks_and_moving_clutter() -> None:
    drive = mrclam_drive(3)
    assert set(drive.reference_landmarks) == set(range(6, 21))
    assert set(np.concatenate(drive.identities).tolist()) == {MISSED, *range(6, 21)}
    assert 0.15 < np.mean(np.concatenate(drive.identities) == MISSED) < 0.3
    assert all(np.diff([scan.time for scan in drive.scans]) > 0.1)
    assert np.degrees(mad(bearing_residuals(drive))) < 0.5
    assert np.all(mad(whitened(drive)) < 1.3)
    assert 0.3 < np.mean(np.array(drive.n_detections) == 0) < 0.4
