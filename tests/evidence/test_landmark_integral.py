"""One landmark integrated out agrees with a dense sum, and knows no frame and no order."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import logsumexp
from scipy.stats import norm

from mht_slam.arrays import FloatArray
from mht_slam.evidence.landmark_integral import log_landmark_integral
from mht_slam.measurements import wrap_angle

CENTRE = (0.5, 0.0)
PRIOR_SIGMA = 30.0


def dense(
    poses: FloatArray, bearings: FloatArray, sigmas: FloatArray, about: int | None = None
) -> float:
    """Sum one landmark over polar grids about the (K, 3) poses, zoomed four times.

    The best grid is the one about the pose nearest to the mass; `about` forces another.
    """
    anchors = range(len(poses)) if about is None else [about]
    return min((_about(a, poses, bearings, sigmas) for a in anchors), key=lambda r: r[1])[0]


def _about(
    anchor: int, poses: FloatArray, bearings: FloatArray, sigmas: FloatArray
) -> tuple[float, float]:
    rays = poses[:, 2] + bearings
    theta = rays[anchor] + sigmas[anchor] * np.linspace(-9.0, 9.0, 73)[:, None]
    low, high = math.log(1e-5), math.log(12.0 * PRIOR_SIGMA)
    for _ in range(5):
        log_range = np.linspace(low, high, 600)
        step = log_range[1] - log_range[0]
        x = poses[anchor, 0] + np.exp(log_range) * np.cos(theta)
        y = poses[anchor, 1] + np.exp(log_range) * np.sin(theta)
        value = 2.0 * log_range + math.log(step * float(theta[1, 0] - theta[0, 0]))
        value = value - ((x - CENTRE[0]) ** 2 + (y - CENTRE[1]) ** 2) / (2.0 * PRIOR_SIGMA**2)
        value -= math.log(2.0 * math.pi * PRIOR_SIGMA**2)
        for pose, ray, sigma in zip(poses, rays, sigmas, strict=True):
            off = np.arctan2(y - pose[1], x - pose[0]) - ray
            off = np.arctan2(np.sin(off), np.cos(off))
            value -= 0.5 * (off / sigma) ** 2 + math.log(sigma * math.sqrt(2.0 * math.pi))
        by_range = value.max(axis=0)
        kept = log_range[by_range > by_range.max() - 50.0]
        low, high = kept[0] - step, kept[-1] + step
    total = float(logsumexp(value))
    return total, float((np.exp(value - total) * log_range).sum())


def sightings(
    landmark: FloatArray, poses: FloatArray, sigma: float, rng: np.random.Generator
) -> FloatArray:
    away = landmark - poses[:, :2]
    noise = sigma * rng.standard_normal(len(poses))
    return wrap_angle(np.arctan2(away[:, 1], away[:, 0]) - poses[:, 2] + noise)


def some_run(n_scans: int, rng: np.random.Generator) -> FloatArray:
    poses = np.zeros((n_scans, 3))
    poses[1:, 0] = np.cumsum(np.exp(rng.normal(0.0, 0.5, n_scans - 1)))
    poses[:, 1] = 0.02 * rng.standard_normal(n_scans)
    poses[:, 2] = 0.05 * rng.standard_normal(n_scans)
    return poses


PLACES = {
    "beside": (0.8, 1.5),
    "near the path": (1.02, 0.05),
    "far": (25.0, 40.0),
    "ahead, near the axis": (9.0, 0.15),
    "behind, near the axis": (-4.0, -0.1),
    "very far": (-70.0, 10.0),
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("sigma_deg", [0.05, 0.3, 1.0, 3.0, 7.0])
def test_the_integral_agrees_with_a_dense_sum(place: str, sigma_deg: float) -> None:
    rng = np.random.default_rng([len(place), int(100 * sigma_deg)])
    sigma = math.radians(sigma_deg)
    tolerance = 0.01 if place == "near the path" else 1e-3
    for n_scans in (1, 2, 3, 4, 5):
        poses = some_run(n_scans, rng)
        bearings = sightings(np.array(PLACES[place]), poses, sigma, rng)
        sigmas = np.full(n_scans, sigma)
        fast = log_landmark_integral(poses[None], bearings, sigmas, CENTRE, PRIOR_SIGMA)[0]
        assert fast == pytest.approx(dense(poses, bearings, sigmas), abs=tolerance), n_scans


def test_the_dense_sum_does_not_depend_on_the_pose_it_is_taken_about() -> None:
    rng = np.random.default_rng(3)
    poses = some_run(3, rng)
    sigmas = np.array([0.01, 0.02, 0.03])
    bearings = sightings(np.array([0.8, 1.5]), poses, 0.02, rng)
    about = [dense(poses, bearings, sigmas, about=k) for k in range(3)]
    assert about == pytest.approx([about[0]] * 3, abs=1e-6)


def test_a_single_sighting_from_the_priors_centre_says_one_turn() -> None:
    pose = np.array([[[CENTRE[0], CENTRE[1], 0.7]]])
    value = log_landmark_integral(pose, np.array([1.1]), np.array([0.01]), CENTRE, PRIOR_SIGMA)
    assert value[0] == pytest.approx(-math.log(2.0 * math.pi), abs=1e-4)


def test_a_single_wide_sighting_agrees_with_the_priors_density_of_directions() -> None:
    # Density of the direction of an isotropic Gaussian seen from a distance d along the ray's axis.
    distance = 20.0
    a = distance / PRIOR_SIGMA
    angles = np.linspace(-math.pi, math.pi, 20_001)
    c = a * np.cos(angles)
    density = math.exp(-0.5 * a * a) / (2 * math.pi) + c * norm.cdf(c) * norm.pdf(
        a * np.sin(angles)
    )
    bearing, sigma = 0.4, math.radians(7.0)
    weight = norm.pdf(angles, bearing, sigma)
    expected = math.log(float((density * weight).sum() * (angles[1] - angles[0])))
    pose = np.array([[[CENTRE[0] - distance, CENTRE[1], 0.0]]])
    value = log_landmark_integral(pose, np.array([bearing]), np.array([sigma]), CENTRE, PRIOR_SIGMA)
    assert value[0] == pytest.approx(expected, abs=1e-4)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), n_scans=st.integers(2, 5))
def test_the_order_of_the_sightings_means_nothing(seed: int, n_scans: int) -> None:
    rng = np.random.default_rng(seed)
    poses = some_run(n_scans, rng)
    bearings = sightings(rng.normal(0.0, 5.0, 2), poses, 0.02, rng)
    sigmas = rng.uniform(0.01, 0.04, n_scans)
    order = rng.permutation(n_scans)
    values = [
        log_landmark_integral(p[None], b, s, CENTRE, PRIOR_SIGMA)[0]
        for p, b, s in ((poses, bearings, sigmas), (poses[order], bearings[order], sigmas[order]))
    ]
    assert values[0] == pytest.approx(values[1], abs=1e-5)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), turn=st.floats(-3.1, 3.1))
def test_a_rigid_motion_of_everything_means_nothing(seed: int, turn: float) -> None:
    rng = np.random.default_rng(seed)
    poses = some_run(3, rng)
    bearings = sightings(rng.normal(0.0, 5.0, 2), poses, 0.02, rng)
    sigmas = np.full(3, 0.02)
    shift = rng.normal(0.0, 10.0, 2)
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    moved = np.column_stack([poses[:, :2] @ rotation.T + shift, poses[:, 2] + turn])
    centre = rotation @ np.array(CENTRE) + shift
    here = log_landmark_integral(poses[None], bearings, sigmas, CENTRE, PRIOR_SIGMA)
    there = log_landmark_integral(
        moved[None], bearings, sigmas, (float(centre[0]), float(centre[1])), PRIOR_SIGMA
    )
    assert here == pytest.approx(there, abs=1e-6)


def test_sets_of_poses_do_not_influence_each_other() -> None:
    rng = np.random.default_rng(8)
    poses = np.stack([some_run(3, rng) for _ in range(30)])
    for landmark in ((0.8, 1.5), (20.0, 30.0), (6.0, 0.2)):
        bearings = sightings(np.array(landmark), poses[0], 0.02, rng)
        together = log_landmark_integral(poses, bearings, np.full(3, 0.02), CENTRE, PRIOR_SIGMA)
        alone = [
            log_landmark_integral(p[None], bearings, np.full(3, 0.02), CENTRE, PRIOR_SIGMA)[0]
            for p in poses
        ]
        plausible = together > together.max() - 15.0
        assert together[plausible] == pytest.approx(np.array(alone)[plausible], abs=2e-3)


def test_rays_that_part_leave_nothing() -> None:
    poses = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]])
    bearings = np.array([2.0, 1.0])  # the later bearing of a passing landmark is the larger one
    value = log_landmark_integral(poses, bearings, np.full(2, 0.01), CENTRE, PRIOR_SIGMA)
    assert not np.isnan(value[0]) and value[0] < -500.0
