"""The slow, obvious integration that the evidence of a straight run is held against.

It shares no code with `mht_slam.evidence` or `mht_slam.graph`: every landmark is summed over a
dense polar grid about the observation point nearest to it, zoomed to where the mass is, and the
steps over nested grids of ln step.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import logsumexp

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.measurements import BearingScan
from mht_slam.models import ObservationModel

REACH = 8.0
FINE = (41, 160, 3)
"""Bearings and log ranges of a grid, and how often it is zoomed."""
COARSE = (17, 120, 1)
N_STEPS = 25
NEGLIGIBLE = 45.0

DenseEvidence = Callable[[tuple[BearingScan, ...], IntArray, ObservationModel], float]


@pytest.fixture(scope="session")
def dense_log_evidence() -> DenseEvidence:
    """Log evidence of a full or partial table over three scans, common heading, no lateral."""
    return integrate_run


def integrate_run(
    scans: tuple[BearingScan, ...], table: IntArray, model: ObservationModel
) -> float:
    assert len(scans) == 3
    low, high, n_steps = -6.0, 6.0, N_STEPS
    for _ in range(10):
        grid = np.linspace(low, high, n_steps)
        step = grid[1] - grid[0]
        values = np.array([_log_joint(scans, table, model, log_step) for log_step in grid])
        kept = grid[values > values.max() - 30.0]
        if (values > values.max() - 4.0).sum() >= 7:
            return float(logsumexp(values) + np.log(step))
        width = high - low
        low, high = max(kept[0] - step, -6.0), min(kept[-1] + step, 6.0)
        if high - low > 0.6 * width:  # a sharp peak on a broad foot
            n_steps *= 2
    raise AssertionError("the posterior of the step was not resolved")


def _log_joint(
    scans: tuple[BearingScan, ...], table: IntArray, model: ObservationModel, log_step: float
) -> float:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0 + np.exp(log_step), 0.0]])
    deviation = (log_step - model.log_step_mean) / model.log_step_sigma
    total = -0.5 * deviation**2 - np.log(model.log_step_sigma * np.sqrt(2.0 * np.pi))
    for row in table:
        seen = np.flatnonzero(row >= 0)
        rays = np.array([scans[k].bearings[row[k]] for k in seen])
        sigmas = np.array(
            [model.sigma if (own := scans[k].sigma) is None else own[row[k]] for k in seen]
        )
        total += integrate_landmark(points[seen], rays, sigmas, model)
    return float(total)


def integrate_landmark(
    points: FloatArray, rays: FloatArray, sigmas: FloatArray, model: ObservationModel
) -> float:
    """Log integral of one landmark seen from (K, 2) points along (K,) absolute rays.

    Polar coordinates are good about the nearest point only: seen from farther away, the bearing
    there turns too fast for the grid.
    """
    mean_log_range = [
        _about(anchor, points, rays, sigmas, model, COARSE)[1] for anchor in range(len(points))
    ]
    return _about(int(np.argmin(mean_log_range)), points, rays, sigmas, model, FINE)[0]


def _about(
    anchor: int,
    points: FloatArray,
    rays: FloatArray,
    sigmas: FloatArray,
    model: ObservationModel,
    grid: tuple[int, int, int],
) -> tuple[float, float]:
    """Log integral on a polar grid about one point, and the mean log range under it."""
    n_bearings, n_ranges, zooms = grid
    theta = rays[anchor] + sigmas[anchor] * np.linspace(-REACH, REACH, n_bearings)
    low, high = np.log(1e-4), np.log(10.0 * model.landmark_sigma)
    for zoom in range(zooms + 1):
        log_range = np.linspace(low, high, n_ranges)
        step = log_range[1] - log_range[0]
        distance = np.exp(log_range)
        x = points[anchor, 0] + distance * np.cos(theta)[:, None]
        y = points[anchor, 1] + distance * np.sin(theta)[:, None]
        value = 2.0 * log_range + np.log(step * (theta[1] - theta[0]))
        value = value - np.log(2.0 * np.pi * model.landmark_sigma**2)
        cx, cy = model.landmark_centre
        value = value - 0.5 * ((x - cx) ** 2 + (y - cy) ** 2) / model.landmark_sigma**2
        for point, ray, sigma in zip(points, rays, sigmas, strict=True):
            off = np.arctan2(y - point[1], x - point[0]) - ray
            off = (off + np.pi) % (2.0 * np.pi) - np.pi
            value = value - 0.5 * (off / sigma) ** 2 - np.log(sigma * np.sqrt(2.0 * np.pi))
        if zoom == zooms:
            break
        by_range = value.max(axis=0)
        kept = log_range[by_range > by_range.max() - NEGLIGIBLE]
        low, high = kept[0] - step, kept[-1] + step
    total = float(logsumexp(value))
    return total, float((np.exp(value - total) * log_range).sum())


def all_tables(n: int) -> list[IntArray]:
    """All (n!)^2 full tables of three scans with n detections each."""
    return [
        np.column_stack([np.arange(n), second, third])
        for second in itertools.permutations(range(n))
        for third in itertools.permutations(range(n))
    ]


@pytest.fixture(scope="session")
def full_tables() -> Callable[[int], list[IntArray]]:
    return all_tables
