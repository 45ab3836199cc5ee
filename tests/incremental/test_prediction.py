"""Gains of matches over poses, against sums written out, sampling and dense integration."""

from __future__ import annotations

import math
from itertools import islice

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from mht_slam.arrays import FloatArray
from mht_slam.incremental.past import points_of
from mht_slam.incremental.prediction import (
    best_choices,
    bounds_of,
    match_gains,
    pair_gains,
    relative_landmarks,
)
from mht_slam.incremental.smoother import inverse_root
from mht_slam.matchings import best_matching, ranked_matchings
from mht_slam.measurements import wrap_angle

SEEDS = st.integers(0, 2**32 - 1)
DOFS = st.sampled_from([math.inf, 3.0])


def in_last_frame(pose: FloatArray, places: FloatArray, centres: FloatArray) -> FloatArray:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    away = points_of(places, centres) - pose[:2]
    return away @ np.array([[c, -s], [s, c]])


def log_noise(z: float, sigma: float, dof: float) -> float:
    law = stats.norm() if math.isinf(dof) else stats.t(dof)
    return float(law.logpdf(z / sigma)) - math.log(sigma)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS, n=st.integers(0, 5))
def test_landmarks_and_their_covariances_are_carried_to_the_last_pose(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    pose = rng.normal(size=3)
    places = np.column_stack([rng.uniform(-3, 3, n), rng.normal(1.0, 0.5, n)])
    centres = rng.normal(size=(n, 2))
    size = 2 * n + 3
    root = np.triu(rng.normal(size=(size, size))) + 5.0 * np.eye(size)
    relative, covariances = relative_landmarks(pose, places, centres, root)
    np.testing.assert_allclose(relative, in_last_frame(pose, places, centres), atol=1e-9)
    spread = inverse_root(root)
    covariance = spread @ spread.T
    x = np.concatenate([places.ravel(), pose])
    columns = []
    for i in range(size):
        ends = []
        for h in (1e-6, -1e-6):
            moved = x.copy()
            moved[i] += h
            ends.append(in_last_frame(moved[-3:], moved[:-3].reshape(-1, 2), centres))
        columns.append((ends[0] - ends[1]) / 2e-6)
    jacobian = np.stack(columns, axis=-1)  # (n, 2, size)
    expected = jacobian @ covariance @ jacobian.transpose(0, 2, 1)
    np.testing.assert_allclose(covariances, expected, rtol=1e-5, atol=1e-8)


@settings(max_examples=30, deadline=None)
@given(
    seed=SEEDS,
    n=st.integers(0, 4),
    d=st.integers(0, 4),
    dof=DOFS,
    view=st.sampled_from([math.pi, 1.0]),
    farthest=st.sampled_from([math.inf, 4.0]),
)
def test_gains_of_matches_are_those_written_out(
    seed: int, n: int, d: int, dof: float, view: float, farthest: float
) -> None:
    rng = np.random.default_rng(seed)
    count = 3
    motions = np.column_stack([rng.normal(1, 0.3, count), 0.2 * rng.normal(size=(count, 2))])
    turn_spread, side_spreads = 0.05, rng.uniform(0, 0.5, count)
    relative = 3.0 * rng.normal(size=(n, 2))
    half = rng.normal(size=(n, 2, 2))
    covariances = half @ half.transpose(0, 2, 1)
    chances = rng.uniform(0.05, 0.95, n)
    bearings, sigmas = rng.uniform(-math.pi, math.pi, d), rng.uniform(0.01, 0.1, d)
    table, missed = np.full((count, n + 1, d), 7.0), np.empty(count)
    match_gains(
        motions, turn_spread, side_spreads, relative, covariances, chances, view, farthest,
        bearings, sigmas, -2.0, dof, table, missed,
    )  # fmt: skip
    assert (table[:, n:] == 7.0).all()
    for g in range(count):
        silent = 0.0
        for j in range(n):
            x, y = relative[j] - motions[g, :2]
            reach = math.hypot(x, y)
            bearing = wrap_angle(math.atan2(y, x) - motions[g, 2])
            inside = abs(bearing) <= view and reach <= farthest
            log_missed = math.log(1.0 - chances[j]) if inside else 0.0
            silent += log_missed
            slope = np.array([-y, x]) / reach**2
            variance = slope @ covariances[j] @ slope + turn_spread**2 / 3.0
            variance += min(1.0, (side_spreads[g] / reach) ** 2)
            for k in range(d):
                sigma = math.sqrt(variance + sigmas[k] ** 2)
                seen = math.log(chances[j]) + log_noise(
                    wrap_angle(bearings[k] - bearing), sigma, dof
                )
                assert table[g, j, k] == pytest.approx(seen - log_missed + 2.0, abs=1e-9)
        assert missed[g] == pytest.approx(silent, abs=1e-12)


def pair_table(
    motion: FloatArray, ray: FloatArray, ray_sigma: float, bearing: float, sigma: float,
    *, landmark_sigma: float, nearest: float, dof: float = math.inf, turn: float = 0.0,
    side: float = 0.0,
) -> float:  # fmt: skip
    """Log gain of one pair, where its pattern weighs nothing."""
    table = np.full((1, 2, 1), 7.0)
    pair_gains(
        motion[None], turn, np.array([side]), ray[None], np.array([ray_sigma]), np.zeros(1),
        landmark_sigma, nearest, np.array([bearing]), np.array([sigma]), dof, table, 1,
    )  # fmt: skip
    assert table[0, 0, 0] == 7.0
    return float(table[0, 1, 0])


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, dof=DOFS)
def test_gains_of_pairs_are_those_written_out(seed: int, dof: float) -> None:
    rng = np.random.default_rng(seed)
    motion = np.array([1.0, 0.0, 0.0]) + 0.2 * rng.normal(size=3)
    ray = np.array([-1.0, 0.0, 0.0]) + rng.normal(size=3)
    landmark_sigma, nearest, ray_sigma, sigma = 10.0, 0.3, 0.03, 0.02
    turn, side = 0.04, 0.2
    reaches = np.geomspace(nearest, 3.0 * landmark_sigma, 14)
    weights = reaches * np.exp(-0.5 * (reaches / landmark_sigma) ** 2)
    ratio = math.log(reaches[1] / reaches[0])

    def seen(r: float, direction: float) -> float:
        x = ray[0] + r * math.cos(direction) - motion[0]
        y = ray[1] + r * math.sin(direction) - motion[1]
        return math.atan2(y, x) - motion[2]

    bearing = float(wrap_angle(seen(float(rng.choice(reaches)), ray[2]) + 0.03 * rng.normal()))
    total = 0.0
    for r, weight in zip(reaches.tolist(), (weights / weights.sum()).tolist(), strict=True):
        h = 1e-6
        across = wrap_angle(seen(r, ray[2] + h) - seen(r, ray[2] - h)) / (2 * h)
        along = wrap_angle(seen(r * math.exp(h), ray[2]) - seen(r * math.exp(-h), ray[2])) / (2 * h)
        reach = math.hypot(
            ray[0] + r * math.cos(ray[2]) - motion[0], ray[1] + r * math.sin(ray[2]) - motion[1]
        )
        variance = (across * ray_sigma) ** 2 + (0.5 * ratio * along) ** 2 + sigma**2
        variance += turn**2 / 3.0 + min(1.0, (side / reach) ** 2)
        z = wrap_angle(bearing - seen(r, ray[2]))
        if z**2 / variance <= 200.0:
            total += weight * math.exp(log_noise(z, math.sqrt(variance), dof))
    gain = pair_table(
        motion, ray, ray_sigma, bearing, sigma, landmark_sigma=landmark_sigma, nearest=nearest,
        dof=dof, turn=turn, side=side,
    )  # fmt: skip
    assert gain == pytest.approx(math.log(max(total, 1e-300)), abs=1e-5)


@pytest.mark.parametrize("seed", range(8))
def test_fourteen_ranges_come_close_to_the_integral_over_all(seed: int) -> None:
    """Where the second bearing is one that the prior allows, within half a nat."""
    rng = np.random.default_rng(seed)
    motion, ray = np.array([1.0, 0.0, 0.05]), np.array([0.0, 0.0, rng.uniform(0.4, 2.5)])
    landmark_sigma, ray_sigma, sigma = 10.0, 0.02, 0.02
    reach = landmark_sigma * rng.uniform(0.3, 2.0)
    x, y = reach * math.cos(ray[2]) - motion[0], reach * math.sin(ray[2]) - motion[1]
    bearing = math.atan2(y, x) - motion[2]
    r = np.exp(np.linspace(math.log(1e-3), math.log(80.0), 4001))
    prior = r * np.exp(-0.5 * (r / landmark_sigma) ** 2)
    directions = ray[2] + ray_sigma * np.linspace(-5, 5, 201)
    weight = np.exp(-0.5 * np.linspace(-5, 5, 201) ** 2)
    px = r * np.cos(directions)[:, None] - motion[0]
    py = r * np.sin(directions)[:, None] - motion[1]
    z = wrap_angle(np.arctan2(py, px) - motion[2] - bearing) / sigma
    density = np.exp(-0.5 * z**2) / (sigma * math.sqrt(2 * math.pi))
    joint = (weight / weight.sum())[:, None] * (prior / prior.sum()) * density
    gain = pair_table(
        motion, ray, ray_sigma, bearing, sigma, landmark_sigma=landmark_sigma, nearest=0.3
    )
    assert gain == pytest.approx(math.log(float(joint.sum())), abs=0.5)


@settings(max_examples=100, deadline=None)
@given(seed=SEEDS, rows=st.integers(0, 5), detections=st.integers(0, 5))
def test_no_matching_exceeds_the_bound(seed: int, rows: int, detections: int) -> None:
    rng = np.random.default_rng(seed)
    table = rng.normal(size=(4, rows, detections))
    offsets = rng.normal(size=4)
    bounds = bounds_of(table, offsets)
    for g in range(4):
        _, gain = best_matching(np.maximum(table[g], 0.0))
        assert bounds[g] >= offsets[g] + gain - 1e-12


@settings(max_examples=200, deadline=None)
@given(
    seed=SEEDS,
    rows=st.integers(0, 4),
    detections=st.integers(0, 4),
    depth=st.integers(1, 8),
    floor=st.sampled_from([-math.inf, 0.0, 1.5]),
)
def test_the_best_choices_are_those_that_murty_ranks_first(
    seed: int, rows: int, detections: int, depth: int, floor: float
) -> None:
    gains = np.random.default_rng(seed).normal(size=(rows, detections))
    ranked = islice(ranked_matchings(np.maximum(gains, 0.0)), depth)
    expected = [(matches, gain) for matches, gain in ranked if gain >= floor]
    count, totals, chosen = best_choices(gains, depth, floor, 10_000)
    found = [
        tuple(sorted((r, d) for d, r in enumerate(row) if r >= 0))
        for row in chosen[:count].tolist()
    ]
    assert found == [matches for matches, _ in expected]
    assert totals[:count] == pytest.approx([gain for _, gain in expected])


def test_a_search_with_too_much_choice_gives_up() -> None:
    assert best_choices(np.ones((8, 8)), 6, -math.inf, 50)[0] == -1
