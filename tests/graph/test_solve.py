"""Covariances and log determinants agree with numerical ones; `to_gtsam` hands over the optimum."""

from __future__ import annotations

import math
from typing import Any

import gtsam
import numpy as np
import pytest

from mht_slam import Association, Hypothesis, ObservationModel, factors, refine
from mht_slam.arrays import FloatArray
from mht_slam.graph.build import FactorPool, graph_keys, make_values
from mht_slam.graph.laplace import SingularGraphError, _sound_inverse, laplace
from mht_slam.graph.motion import motion_factors
from mht_slam.graph.problem import make_problem
from mht_slam.simulation import simulate_pair, simulate_scene

SIGMA = math.radians(1.0)


@pytest.fixture(scope="module", params=["straight", "wandering", "pair"])
def solved(request: Any) -> Hypothesis:
    rng = np.random.default_rng(5)
    if request.param == "pair":
        scene = simulate_pair("annulus", 4, rng, sigma=SIGMA)
        return refine(scene.pair, [scene.truth], sigma=SIGMA, evidence="laplace")[0]
    jitter = {"straight": 0.0, "wandering": 0.03}[request.param]
    scene = simulate_scene(
        "annulus", 4, rng, sigma=SIGMA, heading_sigma=jitter, lateral_sigma=jitter
    )
    return refine(
        scene.run,
        [scene.truth],
        sigma=SIGMA,
        heading_sigma=jitter,
        lateral_sigma=jitter,
        evidence="laplace",
    )[0]


def numerical_hessian(h: Hypothesis) -> FloatArray:
    """Gauss-Newton Hessian in (landmarks, then x, y, theta in run axes), by differences."""
    graph, _, keys = h.to_gtsam()
    assert h.landmarks is not None and h.poses is not None
    start = np.concatenate([h.landmarks.ravel(), h.poses.ravel()])

    def residuals(state: FloatArray) -> FloatArray:
        values = gtsam.Values()
        split = 2 * len(keys.landmarks)
        for key, point in zip(keys.landmarks, state[:split].reshape(-1, 2), strict=True):
            values.insert(key, point)
        for key, pose in zip(keys.scans, state[split:].reshape(-1, 3), strict=True):
            values.insert(key, gtsam.Pose2(*pose))
        return np.concatenate([graph.at(i).whitenedError(values) for i in range(graph.size())])

    columns = [
        (residuals(start + shift) - residuals(start - shift)) / 2e-6
        for shift in 1e-6 * np.eye(len(start))
    ]
    jacobian = np.stack(columns, axis=1)
    return np.asarray(jacobian.T @ jacobian)


def test_covariances_are_blocks_of_the_inverse_numerical_hessian(solved: Hypothesis) -> None:
    assert solved.landmarks is not None and solved.poses is not None
    assert solved.landmark_covariances is not None and solved.pose_covariances is not None
    inverse = np.linalg.inv(numerical_hessian(solved))
    split = solved.landmarks.size
    for i, covariance in enumerate(solved.landmark_covariances):
        block = slice(2 * i, 2 * i + 2)
        assert covariance == pytest.approx(inverse[block, block], rel=1e-3, abs=1e-9)
    for k, covariance in enumerate(solved.pose_covariances):
        block = slice(split + 3 * k, split + 3 * k + 3)
        assert covariance == pytest.approx(inverse[block, block], rel=1e-3, abs=1e-9)


def test_the_log_determinant_agrees_with_the_numerical_one(solved: Hypothesis) -> None:
    graph, values, _ = solved.to_gtsam()
    numerical = np.linalg.slogdet(numerical_hessian(solved))[1]
    assert laplace(graph, values).log_determinant == pytest.approx(numerical, abs=1e-3)


def test_the_handed_over_values_are_a_stationary_point(solved: Hypothesis) -> None:
    graph, values, _ = solved.to_gtsam()
    linear = graph.linearize(values)
    gradient = linear.jacobian()[0].T @ linear.jacobian()[1]
    step = np.linalg.solve(linear.hessian()[0], gradient)
    assert 0.5 * gradient @ step < 1e-5  # what is left to gain, nats


def test_laplace_evidence_follows_from_the_handed_over_graph(solved: Hypothesis) -> None:
    graph, values, keys = solved.to_gtsam()
    hessian = graph.linearize(values).hessian()[0]
    dimension = 2 * len(keys.landmarks) + 3 * len(keys.scans)
    assert len(hessian) == dimension
    expected = factors.log_density(graph, values) + 0.5 * dimension * math.log(2.0 * math.pi)
    expected -= 0.5 * np.linalg.slogdet(hessian)[1]
    if len(keys.scans) == 4:  # direction of the second run: uniform, outside the graph
        assert solved.poses is not None
        step = np.linalg.norm(solved.poses[3, :2] - solved.poses[2, :2])
        expected -= math.log(2.0 * math.pi * step)
    # The steps about which the priors are linearised are those before the last iteration.
    assert solved.log_evidence == pytest.approx(expected, abs=1e-4)


def test_an_unobserved_direction_is_named_and_not_inverted() -> None:
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(factors.bearing(0, 1, 0.3, 0.01))
    values = gtsam.Values()
    values.insert(0, gtsam.Pose2())
    values.insert(1, np.array([2.0, 0.6]))
    with pytest.raises(SingularGraphError, match="not observed"):
        laplace(graph, values)


def test_evidence_and_covariance_of_a_cholesky_factor_are_those_of_the_eigenvalues(
    solved: Hypothesis,
) -> None:
    graph, values, _ = solved.to_gtsam()
    approximation = laplace(graph, values)
    hessian = graph.linearize(values).hessian()[0]
    scale = 1.0 / np.sqrt(np.diag(hessian))
    eigenvalues, vectors = np.linalg.eigh(hessian * scale * scale[:, None])
    log_determinant = np.log(eigenvalues).sum() - 2.0 * np.log(scale).sum()
    assert approximation.log_determinant == pytest.approx(log_determinant, abs=1e-8)
    inverse = (vectors / eigenvalues) @ vectors.T
    assert approximation.covariance / scale / scale[:, None] == pytest.approx(
        inverse, rel=1e-6, abs=1e-6
    )


@pytest.mark.parametrize(("smallest", "is_sound"), [(1e-10, True), (1e-13, False), (-1e-6, False)])
def test_a_hessian_is_refused_by_its_condition(smallest: float, is_sound: bool) -> None:
    rng = np.random.default_rng(0)
    basis = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    matrix = (basis * [smallest, 0.5, 1.0, 1.0, 1.0, 1.0]) @ basis.T
    if is_sound:
        log_determinant, inverse = _sound_inverse(matrix)
        assert log_determinant == pytest.approx(math.log(smallest / 2.0), abs=1e-3)
        assert inverse @ matrix == pytest.approx(np.eye(6), abs=1e-3)
    else:
        with pytest.raises(SingularGraphError, match="eigenvalues from"):
            _sound_inverse(matrix)


@pytest.mark.parametrize("motion", ["straight", "smooth", "free"])
def test_a_graph_of_pooled_factors_is_the_graph_built_anew(motion: Any) -> None:
    scene = simulate_scene("annulus", 4, np.random.default_rng(5), sigma=SIGMA, n_scans=4)
    model = ObservationModel(sigma=SIGMA, motion=motion)
    problem = make_problem(scene.run, (0, 1, 2, 3), model)
    pool = FactorPool(problem)
    rng = np.random.default_rng(6)
    for _ in range(5):
        table = np.column_stack([rng.permutation(4) for _ in range(4)])
        table[rng.integers(4), rng.integers(4)] = -1
        pooled = pool.linearised(
            pool.unlinearised(table), scene.poses, problem.free_lengths(scene.poses)
        )
        fresh = gtsam.NonlinearFactorGraph()
        keys = graph_keys(4, 4)
        for row, scan in np.argwhere(table >= 0).tolist():
            angle = scene.scans[scan].bearings[table[row, scan]]
            fresh.add(factors.bearing(keys.scans[scan], keys.landmarks[row], angle, SIGMA))
        for key in keys.landmarks:
            fresh.add(factors.landmark_prior(key, (0.5, 0.0), 30.0))
        for factor in motion_factors(problem, keys.scans, scene.poses):
            fresh.add(factor)
        values = make_values(keys, scene.poses, scene.landmarks[:4])
        assert pooled.graph.size() == fresh.size()
        assert pooled.graph.error(values) == pytest.approx(fresh.error(values), rel=1e-12)
        assert pooled.log_density(values) == pytest.approx(
            factors.log_density(fresh, values), rel=1e-12
        )


def test_shared_factors_change_no_bit_of_a_hypothesis() -> None:
    scene = simulate_scene("annulus", 4, np.random.default_rng(5), sigma=SIGMA)
    swapped = scene.truth.table.copy()
    swapped[[0, 1], 2] = swapped[[1, 0], 2]
    candidates = [scene.truth, Association(swapped, scene.truth.n_detections)]
    together = refine(scene.run, candidates, sigma=SIGMA, evidence="laplace")
    for h in together:
        alone = refine(scene.run, [h.association], sigma=SIGMA, evidence="laplace")[0]
        if h.failure is None:
            assert alone.log_evidence == h.log_evidence
            assert alone.landmarks is not None and h.landmarks is not None
            assert alone.landmarks.tobytes() == h.landmarks.tobytes()
