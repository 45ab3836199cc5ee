"""The committed past against joint Gaussians written out, conditioned and marginalised by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.incremental.motion_terms import ODOMETRY, SHORTEST, SMOOTH
from mht_slam.incremental.past import (
    WIDE_DIRECTION,
    WIDE_LOG_RANGE,
    Committed,
    Sighted,
    commit,
    merged,
    nothing_committed,
    places_of,
    point_jacobians,
    points_of,
    recentred,
)
from mht_slam.measurements import wrap_angle

from .drives import terms

SEEDS = st.integers(0, 2**32 - 1)


def past_of(rng: np.random.Generator, n: int, spread: float = 0.1) -> Committed:
    """Two poses a step apart and n landmarks around, all correlated."""
    points = np.array([4.0, 0.0]) + 5.0 * rng.normal(size=(n, 2))
    centres = points - 6.0 * rng.uniform(0.5, 1.0, (n, 1)) * np.array([1.0, 0.3])
    half = rng.normal(size=(6 + 2 * n, 6 + 2 * n))
    deviations = spread * np.concatenate([np.tile([1.0, 1.0, 0.3], 2), np.tile([0.1, 0.2], n)])
    correlation = half @ half.T / len(half) + 0.3 * np.eye(len(half))
    return Committed(
        mean=np.concatenate([[0, 0, 0.1, 1, 0.1, 0.15], places_of(points, centres).ravel()]),
        covariance=deviations[:, None] * correlation * deviations,
        ids=10 + np.arange(n),
        centres=centres,
        visible=rng.uniform(0.1, 1.0, n),
        first_seen=np.arange(n),
        last_seen=np.arange(n) + 3,
        sightings=np.full(n, 4),
    )


def points_covariance(past: Committed) -> FloatArray:
    """Joint covariance of both poses and all points."""
    n = len(past.ids)
    jacobian = np.eye(6 + 2 * n)
    for i, block in enumerate(point_jacobians(past.places)):
        jacobian[6 + 2 * i : 8 + 2 * i, 6 + 2 * i : 8 + 2 * i] = block
    return jacobian @ past.covariance @ jacobian.T


def predicted(x: FloatArray, rows: IntArray, centres: FloatArray) -> FloatArray:
    """Bearings from the third of three poses to landmarks, of one long vector."""
    points = points_of(x[9:].reshape(-1, 2), centres)[rows]
    away = points - x[6:8]
    return wrap_angle(np.arctan2(away[:, 1], away[:, 0]) - x[8])


def slopes(function, x: FloatArray, h: float = 1e-6) -> FloatArray:  # type: ignore[no-untyped-def]
    columns = []
    for i in range(len(x)):
        e = np.zeros(len(x))
        e[i] = h
        columns.append((function(x + e) - function(x - e)) / (2 * h))
    return np.stack(columns, axis=-1)


@settings(max_examples=40, deadline=None)
@given(
    seed=SEEDS,
    kind=st.sampled_from([ODOMETRY, SMOOTH]),
    known=st.integers(0, 3),
    fresh=st.integers(0, 2),
    dof=st.sampled_from([math.inf, 4.0]),
)
def test_committing_is_the_marginal_of_the_linearised_batch_problem(
    seed: int, kind: int, known: int, fresh: int, dof: float
) -> None:
    rng = np.random.default_rng(seed)
    past = past_of(rng, 3)
    n = 3 + fresh
    parameters = np.zeros(12)
    parameters[:3] = (1.0, 0.05, 0.1) if kind == ODOMETRY else (0.1, 0.1, 0.2)
    if kind == ODOMETRY:
        parameters[3:] = (10.0 * np.eye(3) + rng.normal(size=(3, 3))).ravel()
    poses = np.concatenate([past.mean[:6], [2.0, 0.3, 0.2]]).reshape(3, 3)
    poses = poses + 0.02 * rng.normal(size=(3, 3))
    new_points = np.array([5.0, 2.0]) + rng.normal(size=(fresh, 2))
    new_centres = np.zeros((fresh, 2))
    new_places = places_of(new_points, new_centres)
    rows = np.concatenate([rng.permutation(3)[:known], 3 + np.arange(fresh)]).astype(np.int64)
    centres = np.concatenate([past.centres, new_centres])
    # Linearised where the window smoothed, not where the past has its mean.
    places = np.concatenate([past.places + 0.01 * rng.normal(size=(3, 2)), new_places])
    at = np.concatenate([poses.ravel(), places.ravel()])
    bearings = predicted(at, rows, centres) + 0.02 * rng.normal(size=len(rows))
    sigmas = rng.uniform(0.01, 0.03, len(rows))
    found = commit(
        past, kind, parameters, poses,
        Sighted(np.concatenate([past.ids, 90 + np.arange(fresh)])[rows],
                bearings, sigmas, places[rows], centres[rows]),
        dof, 7,
    )  # fmt: skip
    # The batch: prior, step and bearings about the same place, in information form.
    size = 9 + 2 * n
    precision, shift = np.zeros((size, size)), np.zeros(size)
    old = np.concatenate([np.arange(6), 9 + np.arange(6)])
    information = np.linalg.inv(past.covariance)
    precision[np.ix_(old, old)] += information
    shift[old] += information @ (past.mean - at[old])
    for i in range(9 + 6, size):
        precision[i, i] += 1.0 / (WIDE_DIRECTION, WIDE_LOG_RANGE)[(i - 9) % 2] ** 2

    def step(x: FloatArray) -> FloatArray:
        return terms(kind, parameters, x[:9].reshape(3, 3))[1]

    slope = slopes(step, at)
    precision += slope.T @ slope
    shift -= slope.T @ step(at)
    z = bearings - predicted(at, rows, centres)
    variances = sigmas**2
    if math.isfinite(dof):  # with the weight that Student's t gives
        variances = variances / ((dof + 1.0) / (dof + (z / sigmas) ** 2))
    slope = slopes(lambda x: predicted(x, rows, centres), at)
    precision += (slope / variances[:, None]).T @ slope
    shift += slope.T @ (z / variances)
    covariance = np.linalg.inv(precision)
    mean = at + covariance @ shift
    np.testing.assert_allclose(found.mean, mean[3:], rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(found.covariance, covariance[3:, 3:], rtol=1e-4, atol=1e-8)
    assert found.ids.tolist() == [10, 11, 12, *(90 + np.arange(fresh)).tolist()]
    assert (found.last_seen[rows] == 7).all()
    assert (found.first_seen[3:] == 7).all()
    unseen = np.setdiff1d(np.arange(3), rows)
    assert (found.last_seen[unseen] == past.last_seen[unseen]).all()


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS, n=st.integers(0, 5), certain=st.sampled_from([0.0, 0.02, 10.0]))
def test_moving_centres_moves_no_landmark_and_no_covariance(
    seed: int, n: int, certain: float
) -> None:
    past = past_of(np.random.default_rng(seed), n)
    moved = recentred(past, certain)
    np.testing.assert_allclose(moved.points, past.points, atol=1e-6)
    np.testing.assert_allclose(
        points_covariance(moved), points_covariance(past), rtol=1e-5, atol=1e-9
    )
    chosen = np.sqrt(np.diag(past.covariance)[7::2]) < certain
    assert (np.hypot(*(moved.centres - moved.points).T) > 5e3).tolist() == chosen.tolist()
    again = recentred(moved, certain)
    np.testing.assert_array_equal(again.mean, moved.mean)


def test_about_a_far_centre_corrections_move_landmarks_along_straight_lines() -> None:
    past = recentred(past_of(np.random.default_rng(3), 1), 10.0)
    change = np.linalg.solve(point_jacobians(past.places)[0], [2.0, -1.5])
    moved = points_of(past.places + change, past.centres)
    np.testing.assert_allclose(moved[0] - past.points[0], [2.0, -1.5], atol=1e-3)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS, pairs=st.integers(1, 2))
def test_merging_conditions_on_being_in_one_place(seed: int, pairs: int) -> None:
    rng = np.random.default_rng(seed)
    past = recentred(past_of(rng, 5, spread=0.05), 10.0)
    new, old = np.array([3, 4])[:pairs], np.array([1, 0])[:pairs]
    sigma = 0.1
    found = merged(past, new, old, sigma)
    # In information form: the difference of two points measured as nothing.
    rows = np.zeros((2 * pairs, len(past.mean)))
    jacobians = point_jacobians(past.places)
    for k, (i, j) in enumerate(zip(new.tolist(), old.tolist(), strict=True)):
        rows[2 * k : 2 * k + 2, 6 + 2 * i : 8 + 2 * i] = jacobians[i]
        rows[2 * k : 2 * k + 2, 6 + 2 * j : 8 + 2 * j] = -jacobians[j]
    scale = np.sqrt(np.diag(past.covariance))
    scaled = np.linalg.inv(past.covariance / scale[:, None] / scale)
    precision = scaled + (rows * scale).T @ (rows * scale) / sigma**2
    covariance = np.linalg.inv(precision) * scale[:, None] * scale
    off = (past.points[old] - past.points[new]).ravel()
    mean = past.mean + covariance @ rows.T @ off / sigma**2
    kept = [i for i in range(5) if i not in new.tolist()]
    at = [*range(6), *(6 + 2 * i + k for i in kept for k in (0, 1))]
    np.testing.assert_allclose(found.mean, mean[at], rtol=1e-6, atol=1e-9)
    deviations = np.sqrt(np.diag(found.covariance))
    error = (found.covariance - covariance[np.ix_(at, at)]) / deviations[:, None] / deviations
    np.testing.assert_allclose(error, 0.0, atol=1e-5)
    assert found.ids.tolist() == past.ids[kept].tolist()
    assert (found.last_seen[old] == np.maximum(past.last_seen[old], past.last_seen[new])).all()
    assert (found.first_seen == past.first_seen[kept]).all()


@given(seed=SEEDS)
def test_points_and_places_are_there_and_back(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = np.column_stack([rng.uniform(-math.pi, math.pi, 4), rng.normal(0, 3, 4)])
    centres = rng.normal(size=(4, 2))
    points = points_of(places, centres)
    np.testing.assert_allclose(places_of(points, centres), places, rtol=1e-6, atol=1e-6)
    for i in range(4):
        slope = slopes(lambda x, i=i: points_of(x[None], centres[i : i + 1])[0], places[i])
        np.testing.assert_allclose(point_jacobians(places)[i], slope, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_the_deviation_from_the_robot_is_that_of_samples(seed: int) -> None:
    rng = np.random.default_rng(seed)
    past = past_of(rng, 3)
    drawn = rng.multivariate_normal(past.mean, past.covariance, 200_000)
    for i in range(3):
        points = past.centres[i] + np.exp(drawn[:, 7 + 2 * i, None]) * np.column_stack(
            [np.cos(drawn[:, 6 + 2 * i]), np.sin(drawn[:, 6 + 2 * i])]
        )
        away = points - drawn[:, 3:5]
        c, s = np.cos(drawn[:, 5]), np.sin(drawn[:, 5])
        seen = np.column_stack([c * away[:, 0] + s * away[:, 1], c * away[:, 1] - s * away[:, 0]])
        greatest = math.sqrt(np.linalg.eigvalsh(np.cov(seen.T))[-1])
        assert past.deviations_from_robot()[i] == pytest.approx(greatest, rel=0.03)


def test_a_landmark_at_its_centre_has_the_shortest_range_there_is() -> None:
    places = places_of(np.array([[3.0, 1.0]]), np.array([[3.0, 1.0]]))
    np.testing.assert_allclose(places[:, 1], math.log(SHORTEST))


def test_what_is_surer_than_doubles_hold_has_a_finite_information() -> None:
    past = nothing_committed()
    sure = replace(past, covariance=np.diag([1.0, 1.0, 1.0, 0.0, -1e-40, 1.0]))
    _, information = sure.marginal(np.empty(0, np.int64))
    assert np.isfinite(information).all()
    assert (np.diag(information) > 0.0).all()


def test_the_marginal_of_some_is_the_inverse_of_their_covariance() -> None:
    past = past_of(np.random.default_rng(0), 4)
    mean, information = past.marginal(np.array([1, 3]))
    at = [*range(6), 8, 9, 12, 13]
    np.testing.assert_array_equal(mean, past.mean[at])
    np.testing.assert_allclose(
        information @ past.covariance[np.ix_(at, at)], np.eye(len(at)), atol=1e-8
    )


def test_many_commits_keep_the_covariance_positive_and_symmetric() -> None:
    rng = np.random.default_rng(1)
    past = nothing_committed()
    points = np.array([[20.0, 6.0], [40.0, -5.0], [60.0, 4.0]])
    parameters = np.zeros(12)
    parameters[:3] = 1.0, 0.0, 0.0
    parameters[3:] = np.diag([30.0, 100.0, 60.0]).ravel()
    for scan in range(80):
        poses = np.concatenate(
            [past.mean[:6].reshape(2, 3), past.mean[None, 3:6] + [1.0, 0.0, 0.0]]
        )
        away = points - [scan, 0.0]
        bearings = np.arctan2(away[:, 1], away[:, 0]) + 0.01 * rng.normal(size=3)
        centres = past.centres if len(past.ids) else np.zeros((3, 2))
        sighted = Sighted(
            np.arange(3), bearings, np.full(3, 0.01), places_of(points, centres), centres
        )
        past = recentred(commit(past, ODOMETRY, parameters, poses, sighted, 4.0, scan), 0.1)
        scale = np.sqrt(np.diag(past.covariance))
        correlation = past.covariance / scale[:, None] / scale
        np.testing.assert_allclose(correlation, correlation.T, atol=1e-12)
        assert np.linalg.eigvalsh(correlation)[0] > 0.0
    assert past.ids.tolist() == [0, 1, 2]
    assert np.hypot(*(past.points - points).T).max() < 1.0
