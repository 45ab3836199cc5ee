"""Simulated drives have the noise, misses, false alarms and odometry that they say."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mht_slam.arrays import FloatArray
from mht_slam.association import MISSED
from mht_slam.datasets.drive import Drive
from mht_slam.errors import OptionError
from mht_slam.measurements import wrap_angle
from mht_slam.simulation import OdometryNoise, simulate_drive
from mht_slam.simulation.drives import CLEARANCE, DRIVE_KINDS, DriveKind
from mht_slam.simulation.sensors import bearings_and_ranges

SIGMA = math.radians(0.5)


def simulated(kind: DriveKind, n: int = 20, m: int = 60, seed: int = 0, **options: float) -> Drive:
    noise = OdometryNoise() if kind == "loop" else None
    rng = np.random.default_rng(seed)
    return simulate_drive(kind, n, m, rng, sigma=SIGMA, odometry=noise, **options)  # type: ignore[arg-type]


def landmarks_of(drive: Drive) -> FloatArray:
    return np.array([drive.reference_landmarks[i] for i in range(len(drive.reference_landmarks))])


def residuals(drive: Drive) -> FloatArray:
    landmarks, found = landmarks_of(drive), []
    for scan, ids, pose in zip(drive.scans, drive.identities, drive.reference_poses, strict=True):
        expected, _ = bearings_and_ranges(pose, landmarks)
        found.append(wrap_angle(scan.bearings - expected[ids])[ids != MISSED])
    return np.concatenate(found)


@pytest.mark.parametrize("kind", DRIVE_KINDS)
def test_identities_are_the_landmarks_seen_and_the_noise_is_sigma(kind: DriveKind) -> None:
    errors = residuals(simulated(kind, 20, 300))
    assert np.std(errors) == pytest.approx(SIGMA, rel=0.1)


@pytest.mark.parametrize("kind", DRIVE_KINDS)
def test_the_stated_share_of_detections_is_false(kind: DriveKind) -> None:
    ids = np.concatenate(simulated(kind, 20, 1000, false_alarms=0.2).identities)
    assert np.mean(ids == MISSED) == pytest.approx(0.2, abs=0.03)
    assert MISSED not in np.concatenate(simulated(kind, false_alarms=0.0).identities)


def test_misses_take_their_share_and_occlusion_hides_what_lies_behind() -> None:
    sure = {"miss": 0.0, "false_alarms": 0.0, "max_range": math.inf}
    everything = simulated("straight", occlusion=False, **sure)
    assert set(everything.n_detections) == {20}
    hidden = simulated("straight", **sure)
    assert sum(hidden.n_detections) < sum(everything.n_detections)
    missed = simulated("straight", 20, 300, occlusion=False, **(sure | {"miss": 0.3}))
    assert np.mean(missed.n_detections) == pytest.approx(14.0, rel=0.05)


@pytest.mark.parametrize("kind", DRIVE_KINDS)
@pytest.mark.parametrize("n", [10, 20, 40])
def test_scans_see_several_landmarks_nearly_always_and_not_all_of_many(
    kind: DriveKind, n: int
) -> None:
    drives = [simulated(kind, n, 60, seed) for seed in range(5)]
    true = [int((ids != MISSED).sum()) for drive in drives for ids in drive.identities]
    assert np.mean(np.array(true) >= 3) > 0.95
    assert 4.0 < np.mean(true) < 10.0


@pytest.mark.parametrize("kind", DRIVE_KINDS)
def test_no_landmark_is_on_the_path_and_the_first_pose_is_the_origin(kind: DriveKind) -> None:
    drive = simulated(kind, rounds=1.0)
    np.testing.assert_allclose(drive.reference_poses[0, :2], 0.0, atol=1e-12)
    apart = drive.reference_poses[:, None, :2] - landmarks_of(drive)
    assert np.linalg.norm(apart, axis=2).min() >= 0.99 * CLEARANCE


def test_a_loop_comes_back_and_open_drives_do_not() -> None:
    poses = simulated("loop", 20, 200, rounds=4.0).reference_poses
    first_round = poses[:50, :2]
    to_first = np.linalg.norm(poses[50:, None, :2] - first_round, axis=2).min(axis=1)
    assert to_first.max() < 4.0
    steps = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)
    np.testing.assert_allclose(steps, 1.0, rtol=0.05)
    straight = simulated("straight").reference_poses
    assert straight[1].tolist() == [1.0, 0.0, 0.0]
    assert np.all(np.diff(straight[:, 0]) > 0.0)


def test_odometry_has_the_errors_that_its_covariance_states() -> None:
    drive = simulated("loop", 10, 2000, rounds=20.0)
    poses = drive.reference_poses
    whitened = []
    for before, after, scan in zip(poses[:-1], poses[1:], drive.scans[1:], strict=True):
        step = scan.odometry
        assert step is not None
        assert step.covariance is not None
        c, s = math.cos(before[2]), math.sin(before[2])
        dx, dy = after[:2] - before[:2]
        motion = np.array([c * dx + s * dy, c * dy - s * dx, after[2] - before[2]])
        error = np.array([step.dx, step.dy, step.dtheta]) - motion
        error[2] = wrap_angle(error[2])
        whitened.append(error / np.sqrt(np.diag(step.covariance)))
    np.testing.assert_allclose(np.std(whitened, axis=0), 1.0, rtol=0.06)
    np.testing.assert_allclose(np.mean(whitened, axis=0), 0.0, atol=0.08)


def test_the_same_seed_gives_the_same_drive() -> None:
    one, other = simulated("smooth", seed=3), simulated("smooth", seed=3)
    assert one.scans == other.scans
    assert one.scans != simulated("smooth", seed=4).scans


def test_what_makes_no_sense_is_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(OptionError, match="odometry is None"):
        simulate_drive("loop", 10, 30, rng, sigma=SIGMA)
    with pytest.raises(OptionError, match="kind is 'spiral'"):
        simulate_drive("spiral", 10, 30, rng, sigma=SIGMA)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="false_alarms is 1"):
        simulate_drive("straight", 10, 30, rng, sigma=SIGMA, false_alarms=1.0)
    with pytest.raises(OptionError, match=r"max_range is 1\.5"):
        simulate_drive("straight", 10, 30, rng, sigma=SIGMA, max_range=1.5)
    with pytest.raises(OptionError, match="turn_sigma is 0"):
        OdometryNoise(turn_sigma=0.0)
