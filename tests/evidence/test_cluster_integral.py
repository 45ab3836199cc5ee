"""Clusters of every kind are integrated as by a dense sum, whatever coordinates they are given."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam import ObservationModel
from mht_slam.arrays import BoolArray, FloatArray
from mht_slam.evidence.cells import Cells
from mht_slam.evidence.cluster_integral import log_cluster_integrals

MODEL = ObservationModel(sigma=math.radians(1.0))
PLACES = {
    "beside": (0.8, 1.5),
    "beside, to the right": (1.6, -0.9),
    "near the path": (1.02, 0.05),
    "close to the first point": (0.02, 0.03),
    "far": (25.0, 40.0),
    "very far": (-70.0, 10.0),
    "ahead, near the axis": (9.0, 0.15),
    "behind, near the axis": (-4.0, -0.1),
    "between, near the axis": (0.4, 0.02),
}
SIGMAS_DEG = (0.1, 1.0, 3.0, 7.0)


def cells_of(
    along: FloatArray, rays: FloatArray, sigma: float, seen: BoolArray | None = None
) -> Cells:
    if seen is None:
        seen = np.ones(rays.shape, dtype=bool)
    spread = np.where(seen, sigma, 1.0)
    return Cells(along, np.where(seen, rays, 0.0), spread, seen)


def integrals(cells: Cells) -> FloatArray:
    return log_cluster_integrals(cells, MODEL.landmark_centre, MODEL.landmark_sigma)


def points(log_ratios: FloatArray) -> FloatArray:
    ones = np.ones_like(log_ratios)
    return np.stack([0.0 * ones, ones, 1.0 + np.exp(log_ratios)], axis=-1)


def seen_from(along: FloatArray, landmark: FloatArray) -> FloatArray:
    return np.arctan2(landmark[1], landmark[0] - along)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("sigma_deg", SIGMAS_DEG)
def test_a_landmark_anywhere_is_integrated(
    place: str, sigma_deg: float, landmark_by_dense_sum: Callable[..., float]
) -> None:
    rng = np.random.default_rng([len(place), int(10 * sigma_deg)])
    sigma = math.radians(sigma_deg)
    along = points(rng.normal(0.0, 0.7, 1))
    rays = seen_from(along[0], np.array(PLACES[place])) + sigma * rng.standard_normal(3)
    expected = landmark_by_dense_sum(along[0], rays, np.full(3, sigma), MODEL)
    assert integrals(cells_of(along, rays[None], sigma))[0] == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("sigma_deg", SIGMAS_DEG)
def test_a_wrong_triple_is_integrated_too(
    sigma_deg: float, landmark_by_dense_sum: Callable[..., float]
) -> None:
    rng = np.random.default_rng(int(10 * sigma_deg))
    sigma = math.radians(sigma_deg)
    along = points(rng.normal(0.0, 0.7, 8))
    rays = np.stack([seen_from(a, rng.normal(0.0, 3.0, 2)) for a in along])
    rays[:, 2] += sigma * rng.uniform(-5.0, 5.0, len(rays))
    found = integrals(cells_of(along, rays, sigma))
    expected = [
        landmark_by_dense_sum(a, r, np.full(3, sigma), MODEL)
        for a, r in zip(along, rays, strict=True)
    ]
    assert found == pytest.approx(np.array(expected), abs=2e-3)


def test_parallel_and_parting_rays_leave_a_landmark_far_away(
    landmark_by_dense_sum: Callable[..., float],
) -> None:
    sigma = math.radians(2.0)
    along = points(np.zeros(3))
    rays = np.radians([[60.0, 60.0, 60.0], [60.0, 57.0, 61.0], [-120.0, -117.0, -116.0]])
    found = integrals(cells_of(along, rays, sigma))
    expected = [
        landmark_by_dense_sum(a, r, np.full(3, sigma), MODEL)
        for a, r in zip(along, rays, strict=True)
    ]
    assert found == pytest.approx(np.array(expected), abs=2e-3)


@pytest.mark.parametrize("sigma_deg", [0.1, 1.0, 7.0])
def test_pairs_and_single_detections_are_integrated(
    sigma_deg: float, landmark_by_dense_sum: Callable[..., float]
) -> None:
    rng = np.random.default_rng(5)
    sigma = math.radians(sigma_deg)
    patterns = np.array(
        [[1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=bool
    )
    along = points(rng.normal(0.0, 0.7, len(patterns)))
    rays = np.stack([seen_from(a, np.array([1.4, 0.8])) for a in along])
    found = integrals(cells_of(along, rays, sigma, patterns))
    for value, a, r, seen in zip(found, along, rays, patterns, strict=True):
        sigmas = np.full(int(seen.sum()), sigma)
        expected = landmark_by_dense_sum(a[seen], r[seen], sigmas, MODEL)
        assert value == pytest.approx(expected, abs=2e-3), seen


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), sigma_deg=st.sampled_from(SIGMAS_DEG))
def test_left_and_right_may_be_exchanged(seed: int, sigma_deg: float) -> None:
    rng = np.random.default_rng(seed)
    sigma = math.radians(sigma_deg)
    along = points(rng.normal(0.0, 1.0, 20))
    rays = rng.uniform(-math.pi, math.pi, (20, 3))
    here, there = (integrals(cells_of(along, side * rays, sigma)) for side in (1.0, -1.0))
    assert here == pytest.approx(there, rel=1e-9, abs=1e-7)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_cells_do_not_influence_each_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    along = points(rng.normal(0.0, 1.0, 30))
    rays = rng.uniform(-math.pi, math.pi, (30, 3))
    sigma = math.radians(rng.choice(SIGMAS_DEG))
    together = integrals(cells_of(along, rays, sigma))
    alone = [integrals(cells_of(along[i : i + 1], rays[i : i + 1], sigma))[0] for i in range(30)]
    assert together == pytest.approx(np.array(alone), rel=1e-8)
