"""The slow, obvious integrals that quadrature is held against; they share no code with it.

A landmark is summed in bearing and log range about every observation point that sees it, each
with a share of the plane that is nearly all of it where that point is the nearest; an association
over a dense grid of ln step.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import logsumexp

from mht_slam import Association, ObservationModel
from mht_slam.arrays import FloatArray
from mht_slam.measurements import BearingScan

REACH = 9.0
SHARE_POWER = 12.0
NEGLIGIBLE = 30.0
ZOOMS = ((41, 400), (41, 400), (41, 400), (111, 900))
"""Bearings and log ranges of the grids; each is laid where the one before found the mass."""


def dense_landmark(
    along: FloatArray, rays: FloatArray, sigmas: FloatArray, model: ObservationModel
) -> float:
    """Log integral of one landmark seen along (K,) rays from points (K,) on the line of travel."""
    total, best = -np.inf, -np.inf
    for anchor in range(len(along)):
        low, high = math.log(1e-5), math.log(8.0 * model.landmark_sigma + 3.0)
        for n_bearings, n_ranges in ZOOMS:
            t = np.linspace(-REACH, REACH, n_bearings)[:, None]
            log_range = np.linspace(low, high, n_ranges)
            step = log_range[1] - log_range[0]
            values = _about(anchor, t, log_range, along, rays, sigmas, model)
            profile = values.max(axis=0)
            best = max(best, profile.max())
            kept = log_range[profile > best - NEGLIGIBLE]
            if len(kept) == 0:
                break
            low, high = kept[0] - step, kept[-1] + step
        else:
            cell = math.log(step * float(t[1, 0] - t[0, 0]) * sigmas[anchor])
            total = np.logaddexp(total, logsumexp(values) + cell)
    return float(total)


def _about(
    anchor: int,
    t: FloatArray,
    log_range: FloatArray,
    along: FloatArray,
    rays: FloatArray,
    sigmas: FloatArray,
    model: ObservationModel,
) -> FloatArray:
    distance = np.exp(log_range)
    x = along[anchor] + distance * np.cos(rays[anchor] + sigmas[anchor] * t)
    y = distance * np.sin(rays[anchor] + sigmas[anchor] * t)
    cx, cy = model.landmark_centre
    value = 2.0 * log_range - 0.5 * ((x - cx) ** 2 + (y - cy) ** 2) / model.landmark_sigma**2
    value = value - math.log(2.0 * math.pi * model.landmark_sigma**2)
    share = np.zeros_like(value)
    for k, (point, ray, sigma) in enumerate(zip(along, rays, sigmas, strict=True)):
        off = np.arctan2(y, x - point) - ray
        off = (off + np.pi) % (2.0 * np.pi) - np.pi
        if k == anchor:
            off = np.broadcast_to(sigma * t, value.shape)
        value = value - 0.5 * (off / sigma) ** 2 - math.log(sigma * math.sqrt(2.0 * math.pi))
        share += np.minimum(distance / np.maximum(np.hypot(x - point, y), 1e-12), 1e6) ** (
            SHARE_POWER
        )
    return np.asarray(value - np.log(share))


def dense_association(
    scans: tuple[BearingScan, ...],
    association: Association,
    model: ObservationModel,
    log_ratios: FloatArray,
) -> float:
    """Log evidence of one association, without size weights, over equidistant ln steps."""
    deviation = (log_ratios - model.log_step_mean) / model.log_step_sigma
    terms = -0.5 * deviation**2 - math.log(model.log_step_sigma * math.sqrt(2.0 * math.pi))
    for q, log_ratio in enumerate(log_ratios):
        along = np.array([0.0, 1.0, 1.0 + math.exp(log_ratio)])
        for row in association.table:
            seen = np.flatnonzero(row >= 0)
            rays = np.array([scans[k].bearings[row[k]] for k in seen])
            terms[q] += dense_landmark(along[seen], rays, np.full(len(seen), model.sigma), model)
    return float(logsumexp(terms) + math.log(log_ratios[1] - log_ratios[0]))


def every_association(
    counts: tuple[int, ...], max_missed: int = 0, max_false: int = 0
) -> list[Association]:
    """All associations within the limits, one detection after the other."""
    detections = [(scan, i) for scan, count in enumerate(counts) for i in range(count)]
    found: list[Association] = []

    def extend(position: int, rows: list[list[int]], n_false: int) -> None:
        if position == len(detections):
            if sum(row.count(-1) for row in rows) <= max_missed:
                found.append(Association(np.array(rows, dtype=int).reshape(-1, 3), counts))
            return
        scan, detection = detections[position]
        for row in rows:
            if row[scan] == -1:
                row[scan] = detection
                extend(position + 1, rows, n_false)
                row[scan] = -1
        fresh = [-1, -1, -1]
        fresh[scan] = detection
        extend(position + 1, [*rows, fresh], n_false)
        if n_false < max_false:
            extend(position + 1, rows, n_false + 1)

    extend(0, [], 0)
    return found


def all_full(n: int) -> list[Association]:
    """All (n!)^2 full associations of three scans with n detections each."""
    orders = list(itertools.permutations(range(n)))
    return [
        Association(np.column_stack([np.arange(n), second, third]), (n, n, n))
        for second, third in itertools.product(orders, orders)
    ]


@pytest.fixture(scope="session")
def landmark_by_dense_sum() -> Callable[..., float]:
    return dense_landmark


@pytest.fixture(scope="session")
def association_by_dense_sum() -> Callable[..., float]:
    return dense_association


@pytest.fixture(scope="session")
def associations_within() -> Callable[..., list[Association]]:
    return every_association


@pytest.fixture(scope="session")
def full_associations() -> Callable[[int], list[Association]]:
    return all_full
