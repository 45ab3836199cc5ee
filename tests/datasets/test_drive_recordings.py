"""The recordings as drives: odometry leads from scan to scan, references fit what was seen."""

import numpy as np
import pytest

from mht_slam.datasets import data_folder, dlr_drive
from mht_slam.datasets.drive import Drive
from mht_slam.errors import RecordingNotFoundError
from mht_slam.measurements import wrap_angle


@pytest.fixture(scope="module")
def recordings() -> None:
    try:
        data_folder()
    except RecordingNotFoundError as reason:
        pytest.skip(str(reason))


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


def reference_motions(poses: np.ndarray) -> np.ndarray:
    """(m - 1, 3) motions from pose to pose, in the frame of the first."""
    before, moved = poses[:-1], np.diff(poses, axis=0)
    c, s = np.cos(before[:, 2]), np.sin(before[:, 2])
    forward, left = c * moved[:, 0] + s * moved[:, 1], -s * moved[:, 0] + c * moved[:, 1]
    return np.column_stack([forward, left, wrap_angle(moved[:, 2])])


def odometry_errors(drive: Drive) -> np.ndarray:
    """(m - 1, 3) odometry minus reference motion."""
    steps = [scan.odometry for scan in drive.scans[1:]]
    said = np.array([[step.dx, step.dy, step.dtheta] for step in steps])
    return said - reference_motions(drive.reference_poses)


@pytest.mark.usefixtures("recordings")
def test_dlr_is_one_drive_with_odometry_and_a_reference_that_fits() -> None:
    drive = dlr_drive()
    assert len(drive) == 2200
    assert drive.has_odometry
    assert all(s.odometry.covariance is not None for s in drive.scans[1:])
    assert np.degrees(np.median(np.abs(bearing_residuals(drive)))) < 0.3
    assert np.all(np.median(np.abs(odometry_errors(drive)), axis=0) < [0.01, 0.01, 0.02])
