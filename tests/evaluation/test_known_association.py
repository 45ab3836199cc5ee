"""Given the association, the graph finds the drive again, in spite of drift and of wrong labels."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mht_slam.association import MISSED, Association
from mht_slam.datasets import data_folder, dlr_drive
from mht_slam.datasets.drive import Drive
from mht_slam.errors import OptionError, RecordingNotFoundError
from mht_slam.evaluation.known_association import DriveGraph, known_association, moved
from mht_slam.evaluation.trajectories import trajectory_errors
from mht_slam.measurements import BearingScan, Odometry
from mht_slam.models import ObservationModel
from mht_slam.simulation import OdometryNoise, simulate_drive
from mht_slam.simulation.drives import SMOOTH, STEP_CHANGE_SIGMA

SIGMA = math.radians(0.5)
MODEL = ObservationModel(sigma=SIGMA, bearing_dof=4.0, motion="odometry", landmark_sigma=30.0)


def loop(seed: int, n_scans: int = 60, sigma: float = SIGMA, **options: float) -> Drive:
    rng = np.random.default_rng(seed)
    noise = OdometryNoise()
    return simulate_drive("loop", 15, n_scans, rng, sigma=sigma, odometry=noise, **options)  # type: ignore[arg-type]


def landmark_ids(drive: Drive, truth: Association) -> list[int]:
    """Identity of each row of the truth."""
    flat = np.concatenate(drive.identities)
    return [
        int(flat[np.flatnonzero(truth.flat_labels() == r)[0]]) for r in range(truth.n_landmarks)
    ]


def test_bearings_without_noise_tell_all_but_the_scale() -> None:
    drive, truth = loop(0, sigma=1e-9), loop(0, sigma=1e-9).truth()
    estimate = known_association(drive.scans, truth, replace(MODEL, sigma=1e-4, landmark_sigma=1e4))
    errors = trajectory_errors(estimate.poses, drive.reference_poses, with_scale=True)
    assert errors.position < 1e-3
    assert errors.alignment.scale == pytest.approx(1.0, abs=0.02)  # 60 steps good to 3 % each
    ids = landmark_ids(drive, truth)
    true = np.array([drive.reference_landmarks[ids[row]] for row in estimate.rows])
    assert len(true) == truth.n_landmarks
    np.testing.assert_allclose(errors.alignment.points(estimate.landmarks), true, atol=3e-3)


@pytest.mark.parametrize("seed", range(3))
def test_bearings_take_away_most_of_the_drift(seed: int) -> None:
    drive = loop(seed)
    estimate = known_association(drive.scans, drive.truth(), MODEL)
    poses = [np.zeros(3)]
    for scan in drive.scans[1:]:
        assert scan.odometry is not None
        poses.append(moved(poses[-1], scan.odometry))
    dead = trajectory_errors(poses, drive.reference_poses, with_scale=False)
    ours = trajectory_errors(estimate.poses, drive.reference_poses, with_scale=False)
    assert ours.position < 0.3 * dead.position
    assert ours.heading < 0.5 * dead.heading


def test_heavy_tails_forgive_wrong_labels_that_a_gaussian_does_not() -> None:
    drive = loop(1, false_alarms=0.0)
    rng = np.random.default_rng(0)
    ids = [of_scan.copy() for of_scan in drive.identities]
    for of_scan in ids:
        if rng.random() < 0.3 and len(of_scan) > 1:
            of_scan[:2] = of_scan[1::-1]
    wrong = Association.from_labels([of_scan.tolist() for of_scan in ids])
    assert wrong.f1(drive.truth()) < 0.95
    gaussian, tails = (
        trajectory_errors(
            known_association(drive.scans, wrong, model).poses,
            drive.reference_poses,
            with_scale=True,
        ).position
        for model in (replace(MODEL, bearing_dof=None), MODEL)
    )
    assert tails < 0.1
    assert tails < 0.3 * gaussian


def test_a_landmark_without_parallax_gets_no_position() -> None:
    ahead = Odometry(1.0, 0.0, 0.0, [1e-4, 1e-4, 1e-6])
    scans = [
        BearingScan([0.0, math.atan2(3.0, 5.0 - k)], odometry=ahead if k else None)
        for k in range(4)
    ]
    graph = DriveGraph(MODEL)
    for scan in scans:
        graph.update(scan, np.array([4, 7]))
    estimate = graph.optimised()
    assert estimate.rows.tolist() == [7]
    np.testing.assert_allclose(estimate.landmarks, [[5.0, 3.0]], atol=0.05)
    assert len(graph.update_seconds) == 4


@pytest.mark.parametrize("kind", ["straight", "smooth"])
def test_without_odometry_the_unit_is_the_first_step(kind: str) -> None:
    drive = simulate_drive(kind, 12, 30, np.random.default_rng(2), sigma=SIGMA)  # type: ignore[arg-type]
    model = ObservationModel(
        sigma=SIGMA,
        motion=kind,  # type: ignore[arg-type]
        detection_probability=0.9,
        false_alarm_rate=0.05,
        expected_landmarks=8.0,
        log_step_sigma=0.3,
        step_change_sigma=STEP_CHANGE_SIGMA,
        **SMOOTH,
    )
    estimate = known_association(drive.scans, drive.truth(), model)
    errors = trajectory_errors(estimate.poses, drive.reference_poses, with_scale=True)
    assert errors.position < 0.2
    assert errors.alignment.scale == pytest.approx(1.0, abs=0.15)


def test_a_scan_without_odometry_is_refused() -> None:
    drive = simulate_drive("straight", 12, 30, np.random.default_rng(2), sigma=SIGMA)
    with pytest.raises(OptionError, match="scan 1 has no odometry"):
        known_association(drive.scans, drive.truth(), MODEL)


def test_nothing_seen_is_dead_reckoning() -> None:
    ahead = Odometry(1.0, 0.0, 0.1, [1e-4, 1e-4, 1e-4])
    scans = [BearingScan([0.3], odometry=ahead if k else None) for k in range(3)]
    graph = DriveGraph(MODEL)
    for scan in scans:
        graph.update(scan, np.array([MISSED]))
    estimate = graph.optimised()
    assert len(estimate.landmarks) == 0
    second = moved(np.zeros(3), ahead)
    np.testing.assert_allclose(estimate.poses[1:], [second, moved(second, ahead)], atol=1e-6)


def test_dlr_with_a_revisit_stays_together() -> None:
    try:
        data_folder()
    except RecordingNotFoundError as reason:
        pytest.skip(str(reason))
    drive = dlr_drive().part(0, 799)
    model = replace(MODEL, sigma=math.radians(0.25))
    estimate = known_association(drive.scans, drive.truth(), model)
    errors = trajectory_errors(estimate.poses, drive.reference_poses, with_scale=True)
    assert errors.position < 0.2
