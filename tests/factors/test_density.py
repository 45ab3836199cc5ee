"""Normalisers are those of scipy's Gaussians, and a direction that is free costs nothing."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm, t

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


@pytest.mark.parametrize("dof", [0.7, 3.0, 25.0])
@pytest.mark.parametrize("error", [0.0, 0.05, -0.4])
def test_a_heavy_tailed_bearing_has_the_density_of_student_t(dof: float, error: float) -> None:
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(factors.bearing(POSE, LANDMARK, 0.3 + error, 0.04, dof))
    values = gtsam.Values()
    values.insert(POSE, gtsam.Pose2(1.0, 2.0, -0.3))
    values.insert(LANDMARK, np.array([5.0, 2.0]))
    expected = t.logpdf(error, dof, scale=0.04)
    assert factors.log_density(graph, values) == pytest.approx(expected, abs=1e-9)


def test_a_loss_that_is_no_density_is_refused_a_normaliser() -> None:
    noise = gtsam.noiseModel.Robust.Create(
        gtsam.noiseModel.mEstimator.Huber.Create(1.0), gtsam.noiseModel.Isotropic.Sigma(1, 0.1)
    )
    with pytest.raises(TypeError, match="belongs to no density"):
        factors.log_normaliser(gtsam.BearingFactor2D(POSE, LANDMARK, gtsam.Rot2(0.1), noise))


def test_a_linear_factor_in_a_container_counts_as_one_of_unit_noise() -> None:
    unit = gtsam.noiseModel.Unit.Create(2)
    linear = gtsam.JacobianFactor(LANDMARK, np.eye(2), np.zeros(2), unit)
    contained = gtsam.LinearContainerFactor(linear, gtsam.Values())
    assert factors.log_normaliser(contained) == pytest.approx(2 * norm.logpdf(0.0))
