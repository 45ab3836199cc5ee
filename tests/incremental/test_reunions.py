"""Two landmarks that are one, by the covariance of the whole run's graph."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L

from mht_slam.incremental.reunions import _made_one, find_reunions, landmark_covariance, reunited

from .rows import CONFIG, STRAY, Row, renamed


def joint_marginal(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, n: int) -> np.ndarray:
    marginals = gtsam.Marginals(graph, values)
    joint = marginals.jointMarginalCovariance(gtsam.KeyVector([L(i) for i in range(n)]))
    return np.block([[joint.at(L(i), L(j)) for j in range(n)] for i in range(n)])


def test_the_covariance_of_all_landmarks_is_the_marginal_of_gtsam() -> None:
    whole = Row(None, range(0)).smoothed()
    wanted = joint_marginal(whole.graph, whole.values, len(whole.points))
    np.testing.assert_allclose(landmark_covariance(whole), wanted, rtol=1e-5, atol=1e-12)


def test_making_two_landmarks_one_is_a_stiff_factor_between_them() -> None:
    """Minimum and covariance of the linearised graph with the factor are the conditioned ones."""
    whole = renamed(Row(None, range(0)), 2, range(6, 12)).smoothed()
    n = len(whole.points)
    i, j = whole.numbers.tolist().index(2), whole.numbers.tolist().index(STRAY)
    stiff = 1e-5
    mean, covariance = _made_one(
        whole.points.ravel(), landmark_covariance(whole), i, j, stiff**2 * np.eye(2)
    )
    linear = gtsam.NonlinearFactorGraph(whole.graph)
    noise = gtsam.noiseModel.Isotropic.Sigma(2, stiff)
    linear.push_back(gtsam.BetweenFactorPoint2(L(i), L(j), np.zeros(2), noise))
    np.testing.assert_allclose(
        covariance, joint_marginal(linear, whole.values, n), rtol=1e-3, atol=1e-9
    )
    step = linear.linearize(whole.values).optimize()
    moved = whole.points + np.array([step.at(L(k)) for k in range(n)])
    np.testing.assert_allclose(mean.reshape(n, 2), moved, atol=1e-4)  # the optimiser has stopped
    assert np.hypot(*(mean.reshape(n, 2)[i] - mean.reshape(n, 2)[j])) < 1e-6


@pytest.mark.parametrize("landmark", [0, 1, 2, 3, 4])
@pytest.mark.parametrize("cut", [4, 6, 8])
def test_one_landmark_under_two_names_is_one(landmark: int, cut: int) -> None:
    row = renamed(Row(None, range(0)), landmark, range(cut, 12))
    found = find_reunions(row.smoothed(), CONFIG)
    assert [(pair.kept, pair.given_up) for pair in found] == [(landmark, STRAY)]
    assert found[0].log_odds > 0.0
    assert all(owner.tolist() == [0, 1, 2, 3, 4] for owner in reunited(row.owners, found))


@pytest.mark.parametrize("place", [(4.0, 9.0), (7.0, -8.0), (3.0, 1.5)])
def test_landmarks_apart_stay_two(place: tuple[float, float]) -> None:
    assert find_reunions(Row(np.array(place), range(4)).smoothed(), CONFIG) == []


def test_landmarks_that_one_scan_sees_together_stay_two() -> None:
    row = Row(np.array([9.0, 4.0]), range(3, 6))  # where the third one stands
    assert find_reunions(row.smoothed(), CONFIG) == []


def test_the_later_one_is_given_up_whatever_the_numbers() -> None:
    row = renamed(Row(None, range(0)), 4, range(6))
    (pair,) = find_reunions(row.smoothed(), CONFIG)
    assert (pair.kept, pair.given_up) == (STRAY, 4)


def test_a_run_without_landmarks_has_no_reunions() -> None:
    row = Row(None, range(0))
    row.owners = [np.full(len(owner), -1) for owner in row.owners]
    assert find_reunions(row.smoothed(), CONFIG) == []
