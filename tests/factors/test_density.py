"""Normalisers are those of scipy's Gaussians, and a direction that is free costs nothing."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from mht_slam import factors

POSE, OTHER, LANDMARK = 0, 1, 2
COVARIANCE = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.003], [0.002, -0.003, 0.01]])


def test_an_isotropic_and_a_diagonal_factor_have_the_density_of_independent_normals() -> None:
    prior = factors.landmark_prior(LANDMARK, (1.0, 2.0), 3.0)
    assert factors.log_normaliser(prior) == pytest.approx(2 * norm.logpdf(0.0, scale=3.0))
    both = factors.bearing_and_range(POSE, LANDMARK, 0.3, 4.0, 0.02, 0.5)
    expected = norm.logpdf(0.0, scale=0.02) + norm.logpdf(0.0, scale=0.5)
    assert factors.log_normaliser(both) == pytest.approx(expected)


def test_a_full_covariance_has_the_density_of_a_multivariate_normal() -> None:
    factor = factors.odometry(POSE, OTHER, (1.0, 0.2, 0.7), COVARIANCE)
    expected = multivariate_normal(np.zeros(3), COVARIANCE).logpdf(np.zeros(3))
    assert factors.log_normaliser(factor) == pytest.approx(expected)


def test_directions_that_are_not_measured_count_for_nothing() -> None:
    heading = factors.heading_prior(POSE, 0.1, 0.05)
    assert factors.log_normaliser(heading) == pytest.approx(norm.logpdf(0.0, scale=0.05))
    line = factors.on_line(POSE, 0.0, 0.01)
    assert factors.log_normaliser(line) == pytest.approx(norm.logpdf(0.0, scale=0.01))


def test_the_log_density_of_a_graph_is_the_sum_over_its_factors() -> None:
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(factors.landmark_prior(LANDMARK, (0.0, 0.0), 2.0))
    graph.push_back(factors.position_prior(POSE, (1.0, -1.0), 0.5))
    values = gtsam.Values()
    values.insert(LANDMARK, np.array([1.0, 3.0]))
    values.insert(POSE, gtsam.Pose2(1.5, -1.0, 2.0))
    expected = norm.logpdf([1.0, 3.0], scale=2.0).sum() + norm.logpdf([0.5, 0.0], scale=0.5).sum()
    assert factors.log_density(graph, values) == pytest.approx(expected)


def test_a_robust_factor_is_refused_a_gaussian_normaliser() -> None:
    noise = gtsam.noiseModel.Robust.Create(
        gtsam.noiseModel.mEstimator.Cauchy.Create(1.0), gtsam.noiseModel.Isotropic.Sigma(1, 0.1)
    )
    with pytest.raises(TypeError, match="no Gaussian normaliser"):
        factors.log_normaliser(gtsam.BearingFactor2D(POSE, LANDMARK, gtsam.Rot2(0.1), noise))


def test_a_factor_without_noise_is_refused() -> None:
    unit = gtsam.noiseModel.Unit.Create(2)
    linear = gtsam.JacobianFactor(LANDMARK, np.eye(2), np.zeros(2), unit)
    with pytest.raises(TypeError, match="no noise model"):
        factors.log_normaliser(gtsam.LinearContainerFactor(linear, gtsam.Values()))
