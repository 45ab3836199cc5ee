"""The posterior over the open scans, and marginals, written out from the branches."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import mht_slam as ms
from mht_slam.incremental.live import OnDemand, live_posterior, marginal_owners
from mht_slam.incremental.past import points_of

from .drives import config_for, fed, ordinary


@pytest.fixture(scope="module")
def slam() -> ms.MultiHypothesisSlam:
    return fed(config_for("loop", lag=6), ordinary("loop", 21).scans)


def test_probabilities_are_those_of_the_branches_kept(slam: ms.MultiHypothesisSlam) -> None:
    scores = np.array([branch.log_score for branch in slam._branches])
    weights = np.exp(scores - scores.max())
    found = [h.probability for h in slam.posterior]
    np.testing.assert_allclose(found, weights / weights.sum(), atol=1e-12)
    assert len(found) > 1


def test_probabilities_sum_to_one_after_billions_of_nats(slam: ms.MultiHypothesisSlam) -> None:
    branches = [replace(slam._branches[0], log_pattern=-1e10 - i) for i in range(5)]
    posterior = live_posterior(branches, slam._window, slam.config.observation_model)
    weights = np.exp(-np.arange(5.0))
    # A score of 1e10 holds six digits behind the point.
    found = [h.probability for h in posterior]
    np.testing.assert_allclose(found, weights / weights.sum(), atol=1e-5)
    assert sum(found) == pytest.approx(1.0, abs=1e-9)
    for marginal in marginal_owners(branches, 0):
        assert sum(marginal.values()) == pytest.approx(1.0, abs=1e-9)


def test_a_hypothesis_tells_the_estimate_of_its_branch(slam: ms.MultiHypothesisSlam) -> None:
    posterior = slam.posterior
    assert posterior.scans == tuple(range(slam._window.first, slam.n_scans))
    for hypothesis, branch in zip(posterior, slam._branches, strict=True):
        np.testing.assert_array_equal(hypothesis.poses, branch.poses[2:])
        covariance = np.linalg.inv(branch.root.T @ branch.root)
        first = 3 * (len(branch.poses) - 1)
        assert hypothesis.pose_covariances is not None
        last = hypothesis.pose_covariances[-1]
        np.testing.assert_allclose(last, covariance[-3:, -3:], rtol=1e-4, atol=1e-12)
        np.testing.assert_allclose(
            hypothesis.pose_covariances[0], covariance[6:9, 6:9], rtol=1e-4, atol=1e-12
        )
        points = points_of(branch.places, branch.centres)
        assert hypothesis.landmarks is not None
        assert hypothesis.landmark_covariances is not None
        for row, point, block in zip(
            hypothesis.association.table,
            hypothesis.landmarks,
            hypothesis.landmark_covariances,
            strict=True,
        ):
            scan = int(np.flatnonzero(row >= 0)[0])
            j = branch.ids.tolist().index(branch.owners[scan][row[scan]])
            np.testing.assert_array_equal(point, points[j])
            reach = math.exp(branch.places[j, 1])
            c, s = math.cos(branch.places[j, 0]), math.sin(branch.places[j, 0])
            jacobian = reach * np.array([[-s, c], [c, s]])
            own = covariance[first + 2 * j : first + 2 * j + 2, first + 2 * j : first + 2 * j + 2]
            np.testing.assert_allclose(block, jacobian @ own @ jacobian.T, rtol=1e-3, atol=1e-9)


def test_marginals_add_up_the_branches_that_agree(slam: ms.MultiHypothesisSlam) -> None:
    probabilities = [h.probability for h in slam.posterior]
    newest = len(slam._window.bearings) - 1
    for d, marginal in enumerate(marginal_owners(slam._branches, newest)):
        for number, probability in marginal.items():
            agreeing = [
                p
                for p, branch in zip(probabilities, slam._branches, strict=True)
                if branch.owners[newest][d] == number
            ]
            assert agreeing
            assert probability == pytest.approx(sum(agreeing), abs=1e-12)
    assert marginal_owners(slam._branches, 0) != []


def test_a_hypothesis_is_made_once_and_only_when_asked_for() -> None:
    slam = fed(config_for("loop", lag=4), ordinary("loop", 8).scans)
    ready = tuple(slam.posterior)
    calls: list[int] = []

    def make(index: int) -> ms.Hypothesis:
        calls.append(index)
        return ready[0]

    lazy = OnDemand(3, make)
    assert len(lazy) == 3
    assert not calls
    assert lazy[-1] is lazy[2] is ready[0]
    assert calls == [2]
    assert lazy[:2] == (ready[0], ready[0])
    assert list(lazy) == [ready[0]] * 3
    assert calls == [2, 0, 1]
    with pytest.raises(IndexError):
        lazy[3]
