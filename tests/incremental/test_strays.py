"""Strays: an exact integral behind them, and which landmarks are given up for others."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mht_slam as ms
from mht_slam.arrays import FloatArray, IntArray
from mht_slam.evidence.bearing_noise import log_bearing_noise
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.history import association_of
from mht_slam.incremental.steps import frame_step, next_step
from mht_slam.incremental.strays import log_sightings, strays_reread
from mht_slam.incremental.whole_run import WholeRun, smooth_whole_run
from mht_slam.measurements import wrap_angle
from mht_slam.simulation import OdometryNoise, simulate_drive

SIGMA = math.radians(0.5)
CONFIG = SlamConfig(motion="odometry")
STRAY = 99
"""Number of the landmark that may be another."""


def dense_log_sightings(
    poses: FloatArray, bearings: FloatArray, dof: float | None, landmark_sigma: float
) -> float:
    """The integral as a sum over direction and log range, about where the bearings are likely."""
    rho = np.linspace(math.log(0.03), math.log(4.0 * landmark_sigma), 1500)[:, None]
    phi = poses[0, 2] + bearings[0] + np.linspace(-12.0, 12.0, 1201)[None] * SIGMA
    x = poses[0, 0] + np.exp(rho) * np.cos(phi)
    y = poses[0, 1] + np.exp(rho) * np.sin(phi)
    log_density = rho - math.log(landmark_sigma) - 0.5 * (np.exp(rho) / landmark_sigma) ** 2
    log_density = log_density - math.log(2.0 * math.pi * math.sqrt(0.5 * math.pi))
    for pose, bearing in zip(poses, bearings, strict=True):
        off = wrap_angle(np.arctan2(y - pose[1], x - pose[0]) - pose[2] - bearing)
        log_density = log_density + log_bearing_noise((off / SIGMA) ** 2, dof) - math.log(SIGMA)
    area = (rho[1, 0] - rho[0, 0]) * (phi[0, 1] - phi[0, 0])
    return float(np.logaddexp.reduce(log_density, axis=None) + math.log(area))


@settings(deadline=None, max_examples=25)
@given(
    seed=st.integers(0, 10_000),
    count=st.integers(1, 6),
    dof=st.sampled_from([None, 4.0]),
)
def test_the_weight_of_sightings_is_the_integral_over_places(
    seed: int, count: int, dof: float | None
) -> None:
    rng = np.random.default_rng(seed)
    poses = np.column_stack([np.arange(count) * 0.8, rng.normal(size=(count, 2)) * 0.1])
    place = np.array([rng.uniform(-2.0, 6.0), rng.choice([-1.0, 1.0]) * rng.uniform(1.5, 8.0)])
    away = place - poses[:, :2]
    bearings = np.arctan2(away[:, 1], away[:, 0]) - poses[:, 2] + SIGMA * rng.normal(size=count)
    found = log_sightings(poses, bearings, np.full(count, SIGMA), dof, 15.0, 0.03)
    wanted = dense_log_sightings(poses, bearings, dof, 15.0)
    assert found == pytest.approx(wanted, abs=0.05 if dof is None else 0.4)


class Row:
    """Twelve scans along a row of landmarks, all of which every scan sees; the stray is added."""

    def __init__(self, stray_at: FloatArray | None, scans: range, seed: int = 3) -> None:
        rng = np.random.default_rng(seed)
        self.landmarks = np.array([[2.0, 3.0], [5.0, -3.0], [9.0, 4.0], [12.0, -4.0], [6.0, 6.0]])
        self.poses = np.column_stack([np.arange(12.0), np.zeros((12, 2))])
        self.owners: list[IntArray] = []
        self.bearings: list[FloatArray] = []
        for k, pose in enumerate(self.poses):
            places, numbers = self.landmarks, np.arange(len(self.landmarks))
            if stray_at is not None and k in scans:
                places, numbers = np.vstack([places, stray_at]), np.append(numbers, STRAY)
            away = places - pose[:2]
            self.bearings.append(
                np.arctan2(away[:, 1], away[:, 0]) + SIGMA * rng.normal(size=len(places))
            )
            self.owners.append(numbers)

    def smoothed(self) -> WholeRun:
        model = CONFIG.observation_model
        step = ms.Odometry(1.0, 0.0, 0.0, [1e-4, 1e-4, 1e-5])
        moved = [ms.BearingScan(b, odometry=step) for b in self.bearings]
        steps = [frame_step()]
        steps += [next_step(model, moved[k], k, False, None) for k in range(1, len(moved))]
        return smooth_whole_run(
            steps, self.owners, self.bearings, self.sigmas, self.poses, {},
            dof=model.bearing_dof, landmark_sigma=model.landmark_sigma,
        )  # fmt: skip

    @property
    def sigmas(self) -> list[FloatArray]:
        return [np.full(len(b), SIGMA) for b in self.bearings]

    def reread(self, config: SlamConfig = CONFIG) -> list[IntArray] | None:
        return strays_reread(self.smoothed(), self.owners, self.bearings, self.sigmas, config)


def test_landmarks_nearer_than_the_shortest_range_have_a_weight() -> None:
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    weight = log_sightings(poses, np.zeros(2), np.full(2, SIGMA), None, 1e-6, 0.03)
    assert math.isfinite(weight)


def renamed(row: Row, landmark: int, scans: range) -> Row:
    for k in scans:
        row.owners[k] = np.where(row.owners[k] == landmark, STRAY, row.owners[k])
    return row


@pytest.mark.parametrize("landmark", [0, 2, 4])
def test_the_first_sightings_of_a_landmark_under_another_name_are_its_own(landmark: int) -> None:
    row = renamed(Row(None, range(0)), landmark, range(4))
    found = row.reread()
    assert found is not None
    assert all(owner.tolist() == [0, 1, 2, 3, 4] for owner in found)
    assert (row.owners[0] == STRAY).any(), "the owners that were given have changed"


def test_a_stray_may_be_two_landmarks_in_turn() -> None:
    row = renamed(renamed(Row(None, range(0)), 0, range(2)), 3, range(2, 4))
    found = row.reread()
    assert found is not None
    assert all(owner.tolist() == [0, 1, 2, 3, 4] for owner in found)


@pytest.mark.parametrize("place", [(4.0, 9.0), (7.0, -8.0), (3.0, 1.5)])
def test_a_landmark_of_its_own_stays(place: tuple[float, float]) -> None:
    assert Row(np.array(place), range(4)).reread() is None


def test_two_landmarks_that_one_scan_sees_are_two() -> None:
    row = Row(np.array([2.0, 3.0]), range(4))  # where the first one stands
    found = row.reread()
    assert found is None or all(0 in owner[:5] for owner in found)
    assert found is None or not any((owner[5:] == 0).any() for owner in found)


def test_a_stray_is_explained_only_by_a_landmark_seen_far_more_often() -> None:
    assert renamed(Row(None, range(0)), 0, range(5)).reread() is None


def test_more_odds_can_be_asked_for() -> None:
    row = renamed(Row(None, range(0)), 0, range(4))
    assert row.reread(replace(CONFIG, twin_odds=1e3)) is None


def test_a_loop_that_begins_with_mistakes_ends_with_its_landmarks_whole() -> None:
    """Association, map and trajectory are those of the run read again; the past stays as it is."""
    drive = simulate_drive(
        "loop", 20, 100, np.random.default_rng([0, 20, 100]), sigma=SIGMA, odometry=OdometryNoise()
    )
    slam = ms.MultiHypothesisSlam(SlamConfig(motion="odometry", hypotheses=2, start_hypotheses=10))
    for scan in drive.scans:
        slam.update(scan)
    online, _ = association_of(slam._owners())
    found, truth = slam.association, drive.truth()
    assert found.n_landmarks < online.n_landmarks
    assert found.f1(truth) > online.f1(truth)
    assert len(slam.map) == found.n_landmarks
    assert slam.map.sightings.tolist() == (found.table >= 0).sum(axis=1).tolist()
