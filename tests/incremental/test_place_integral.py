"""The place of a landmark integrated out is a sum over direction and range."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.arrays import FloatArray
from mht_slam.evidence.bearing_noise import log_bearing_noise
from mht_slam.incremental.place_integral import log_sightings
from mht_slam.measurements import wrap_angle

from .rows import SIGMA


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


def test_landmarks_nearer_than_the_shortest_range_have_a_weight() -> None:
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    weight = log_sightings(poses, np.zeros(2), np.full(2, SIGMA), None, 1e-6, 0.03)
    assert math.isfinite(weight)
