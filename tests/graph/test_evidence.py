"""Evidence agrees with a dense integration of the same model, for every hypothesis that counts."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_t, norm

from mht_slam import (
    Association,
    ObservationModel,
    Posterior,
    StraightRun,
    evidence_by_quadrature,
    refine,
)
from mht_slam.arrays import FloatArray, IntArray
from mht_slam.evidence.landmark_integral import log_landmark_integral
from mht_slam.measurements import BearingScan
from mht_slam.simulation import Scene, simulate_scene
from mht_slam.simulation.sensors import bearings_and_ranges

WITHIN = 8.0
MOST_CHECKED = 3


def scene_of(kind: Any, n: int, model: ObservationModel, seed: int) -> Scene:
    rng = np.random.default_rng(seed)
    if kind == "model":
        return simulate_scene(kind, n, rng, model=model)
    return simulate_scene(kind, n, rng, sigma=model.sigma)


def likely(posterior: Posterior) -> list[Any]:
    best = posterior[0].log_evidence
    close = [h for h in posterior if h.log_evidence > best - WITHIN]
    return close[:MOST_CHECKED]


@pytest.mark.parametrize(
    ("kind", "n", "sigma_deg", "seed"),
    [
        ("annulus", 3, 1.0, 1),
        ("one_sided", 3, 1.0, 2),
        ("corridor", 3, 1.0, 2),
        ("model", 3, 1.0, 3),
        ("annulus", 3, 3.0, 0),
        ("one_sided", 4, 1.0, 1),
        ("corridor", 3, 0.3, 0),
    ],
)
def test_marginal_evidence_agrees_with_a_dense_integration(
    kind: str,
    n: int,
    sigma_deg: float,
    seed: int,
    dense_log_evidence: Callable[..., float],
    full_tables: Callable[[int], list[IntArray]],
) -> None:
    model = ObservationModel(sigma=math.radians(sigma_deg))
    scene = scene_of(kind, n, model, seed)
    candidates = [Association(table, (n, n, n)) for table in full_tables(n)]
    for h in likely(refine(scene.run, candidates, model=model)):
        dense = dense_log_evidence(scene.scans, h.association.table, model)
        assert h.log_evidence == pytest.approx(dense, abs=2e-3)


def test_landmarks_beside_the_path_and_near_the_axis_are_integrated_too(
    dense_log_evidence: Callable[..., float],
) -> None:
    model = ObservationModel(sigma=math.radians(1.0))
    landmarks = np.array([[1.02, 0.05], [6.0, 0.3], [-0.5, 1.0]])
    scans = noiseless_scans(landmarks, [0.0, 1.0, 2.5])
    table = np.repeat(np.arange(3), 3).reshape(3, 3)
    posterior = refine(StraightRun(scans), [Association(table, (3, 3, 3))], model=model)
    dense = dense_log_evidence(scans, table, model)
    assert posterior[0].log_evidence == pytest.approx(dense, abs=0.01)


def test_a_landmark_seen_twice_and_one_seen_once_are_integrated_too(
    dense_log_evidence: Callable[..., float],
) -> None:
    model = ObservationModel(sigma=math.radians(1.0))
    landmarks = np.array([[0.3, 1.2], [1.8, -1.0], [-0.5, 2.0]])
    scans = noiseless_scans(landmarks, [0.0, 1.0, 2.2])
    table = np.array([[0, 0, 0], [1, 1, 1], [2, -1, 2], [-1, 2, -1]])
    posterior = refine(StraightRun(scans), [Association(table, (3, 3, 3))], model=model)
    dense = dense_log_evidence(scans, table, model)
    assert posterior[0].log_evidence == pytest.approx(dense, abs=2e-3)


def test_laplace_is_close_where_every_landmark_has_parallax() -> None:
    model = ObservationModel(sigma=math.radians(0.3))
    landmarks = np.array([[0.3, 1.2], [1.8, -1.0], [0.5, 2.0]])
    scans = noiseless_scans(landmarks, [0.0, 1.0, 2.2])
    table = np.repeat(np.arange(3), 3).reshape(3, 3)
    marginal, laplace = (
        refine(StraightRun(scans), [Association(table, (3, 3, 3))], model=model, evidence=method)
        for method in ("marginal", "laplace")
    )
    assert laplace[0].log_evidence == pytest.approx(marginal[0].log_evidence, abs=5e-3)


@pytest.mark.parametrize("seed", [0, 1])
def test_evidence_with_wandering_headings_agrees_with_importance_sampling(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = ObservationModel(sigma=math.radians(1.0), heading_sigma=math.radians(1.0))
    scene = simulate_scene("corridor", 3, rng, sigma=model.sigma, heading_sigma=model.heading_sigma)
    h = refine(scene.run, [scene.truth], model=model)[0]
    assert h.log_evidence == pytest.approx(sampled_evidence(scene, h, model), abs=0.05)


def sampled_evidence(scene: Scene, hypothesis: Any, model: ObservationModel) -> float:
    """Importance sampling over ln step and three headings, landmarks integrated out."""

    table = hypothesis.association.table

    def log_joint(parameters: FloatArray) -> FloatArray:
        poses = np.zeros((len(parameters), 3, 3))
        poses[:, 1, 0] = 1.0
        poses[:, 2, 0] = 1.0 + np.exp(parameters[:, 0])
        poses[:, :, 2] = parameters[:, 1:]
        total = norm.logpdf(parameters[:, 0], model.log_step_mean, model.log_step_sigma)
        total = total + norm.logpdf(parameters[:, 1:], 0.0, model.heading_sigma).sum(axis=1)
        for row in table:
            bearings = np.array([scene.scans[k].bearings[row[k]] for k in range(3)])
            total = total + log_landmark_integral(
                poses, bearings, np.full(3, model.sigma), model.landmark_centre, 30.0
            )
        return np.asarray(total)

    step = hypothesis.poses[2, 0] - 1.0
    mean = np.concatenate([[math.log(step)], hypothesis.poses[:, 2]])
    covariance = np.diag(
        [
            hypothesis.pose_covariances[2, 0, 0] / step**2,
            *hypothesis.pose_covariances[:, 2, 2],
        ]
    )
    rng = np.random.default_rng(7)
    for count in (1024, 1024, 4096):
        proposal = multivariate_t(mean, covariance, df=7, seed=rng)
        sample = proposal.rvs(count)
        chunks = np.array_split(sample, count // 256)
        log_weights = np.concatenate([log_joint(chunk) for chunk in chunks])
        log_weights -= proposal.logpdf(sample)
        total = float(logsumexp(log_weights))
        weights = np.exp(log_weights - total)
        mean = weights @ sample
        covariance = 1.2 * (weights[:, None] * (sample - mean)).T @ (sample - mean)
    return total - math.log(count)


def noiseless_scans(landmarks: FloatArray, along: list[float]) -> tuple[BearingScan, ...]:
    return tuple(
        BearingScan(bearings_and_ranges(np.array([x, 0.0, 0.0]), landmarks)[0]) for x in along
    )


TRAPS = {
    "a landmark on the path": (
        [[0.33502, -0.01019, 2.1347], [2.44851, -0.00715, 0.38036], [3.11689, 2.47955, 0.57685]],
        [[0, 2, 2], [1, 1, 0], [2, 0, 1]],
    ),
    "an optimum behind the second scan": (
        [[-2.63398, 0.14203, -0.03122], [0.0668, 0.15662, -2.55439], [0.16688, 0.10807, -2.52006]],
        [[0, 2, 2], [1, 0, 0], [2, 1, 1]],
    ),
}


@pytest.mark.parametrize("case", TRAPS)
def test_what_traps_the_optimiser_over_positions_still_gets_its_evidence(case: str) -> None:
    bearings, table = TRAPS[case]
    run = StraightRun([BearingScan(b) for b in bearings])
    model = ObservationModel(sigma=math.radians(5.0) / math.sqrt(3.0))
    association = Association(table, (3, 3, 3))
    exact = evidence_by_quadrature(run, [association], model=model)[0]
    solved = refine(run, [association], model=model)[0]
    assert solved.failure is None
    assert solved.log_evidence == pytest.approx(exact.log_evidence, abs=0.01)
