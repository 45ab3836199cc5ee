"""Solve one association's graph and check what came out."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import gtsam
import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.evidence.landmark_integral import log_landmark_integral
from mht_slam.graph.build import (
    GraphKeys,
    build_graph,
    graph_keys,
    make_values,
    prior_outside_graph,
    step_factors,
)
from mht_slam.graph.initial import starting_points
from mht_slam.graph.laplace import SingularGraphError, laplace
from mht_slam.graph.marginal import marginal_log_evidence
from mht_slam.graph.problem import Problem, Sightings
from mht_slam.measurements import wrap_angle

EvidenceMethod: TypeAlias = Literal["marginal", "laplace"]

HOPELESS_RESIDUAL = 6.0
"""Residual, in sigmas, beyond which plain Laplace is good enough for an evidence of nothing."""
MAX_STEP_UPDATES = 10
STEP_TOLERANCE = 1e-4
"""Relative change of a step below which its linearised prior is taken as exact.

The prior's value changes by the square of it.
"""


@dataclass(frozen=True)
class Estimate:
    """What a solved graph says; all arrays finite.

    Attributes
    ----------
    poses : (m, 3); landmarks : (n, 2); steps : about which the step priors are linearised.
    log_likelihood : normalised bearing terms at the estimate.
    log_evidence : evidence of the graph, without the weights of misses and false alarms.
    pose_covariances : (m, 3, 3) in run axes; landmark_covariances : (n, 2, 2).
    """

    poses: FloatArray
    landmarks: FloatArray
    steps: FloatArray
    log_likelihood: float
    log_evidence: float
    pose_covariances: FloatArray
    landmark_covariances: FloatArray


class UnsolvedError(ArithmeticError):
    """An association whose graph gave no usable estimate; the message says why."""


def solve_association(
    problem: Problem, table: IntArray, evidence: EvidenceMethod = "marginal"
) -> Estimate:
    """Estimate poses and landmarks of one association from its best start.

    `evidence` says how the evidence is computed, see `mht_slam.graph.refine.refine`.

    Raises `UnsolvedError` where the optimiser fails from every start, a number is not finite, a
    landmark lies behind a bearing that sees it, the robot goes backwards, or the Hessian is
    singular.

    A landmark seen once says nothing of the poses, and its position is its prior's: it stays out
    of the graph, counts with its integral at the estimated poses, and is put on its ray at one
    standard deviation of the prior, with the prior's covariance.
    """
    ranged = (table != MISSED).sum(axis=1) >= 2
    estimate = _solve_ranged(problem, table[ranged], evidence)
    return estimate if ranged.all() else _with_single_sightings(problem, table, ranged, estimate)


def _solve_ranged(problem: Problem, table: IntArray, evidence: EvidenceMethod) -> Estimate:
    failures = []
    best: tuple[float, gtsam.Values, FloatArray] | None = None
    for poses, landmarks in starting_points(problem, table):
        try:
            error, values, steps = _optimise(problem, table, poses, landmarks)
        except (RuntimeError, UnsolvedError) as cause:  # GTSAM's own errors are RuntimeErrors
            failures.append(str(cause).strip().splitlines()[0])
            continue
        if best is None or error < best[0]:
            best = error, values, steps
    if best is None:
        raise UnsolvedError(f"the optimiser failed: {failures[0]}")
    return _estimate(problem, table, best[1], best[2], evidence)


def _optimise(
    problem: Problem, table: IntArray, poses: FloatArray, landmarks: FloatArray
) -> tuple[float, gtsam.Values, FloatArray]:
    """Levenberg-Marquardt, repeated until the linearised step priors stand still."""
    keys = graph_keys(len(problem.scans), len(table))
    steps = _steps(problem, poses)
    graph = build_graph(problem, table, steps)
    first_step_factor = graph.size() - len(steps)
    values = make_values(poses, landmarks)
    parameters = gtsam.LevenbergMarquardtParams.CeresDefaults()
    for _ in range(MAX_STEP_UPDATES):
        optimiser = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
        values = optimiser.optimize()
        before, steps = steps, _steps(problem, _poses(values, keys))
        if np.all(np.abs(steps - before) <= STEP_TOLERANCE * before):
            break
        for i, factor in enumerate(step_factors(problem, keys, steps)):
            graph.replace(first_step_factor + i, factor)
    error = graph.error(values)
    if not math.isfinite(error):
        raise UnsolvedError("the optimiser ended at an error that is not finite")
    return error, values, steps


def _estimate(
    problem: Problem,
    table: IntArray,
    values: gtsam.Values,
    steps: FloatArray,
    evidence: EvidenceMethod,
) -> Estimate:
    keys = graph_keys(len(problem.scans), len(table))
    poses = _poses(values, keys)
    landmarks = np.array([values.atPoint2(key) for key in keys.landmarks]).reshape(-1, 2)
    if not (np.isfinite(poses).all() and np.isfinite(landmarks).all()):
        raise UnsolvedError("the estimate is not finite")
    sightings = problem.sightings(table)
    residuals = _residuals(sightings, poses, landmarks)
    _check_sides(problem, sightings, residuals, poses)
    try:
        approximation = laplace(build_graph(problem, table, steps), values)
    except SingularGraphError as cause:
        raise UnsolvedError(str(cause)) from cause
    landmark_covariances, joint = _split_covariance(approximation.covariance, poses)
    log_evidence: float | None = None
    worst = float(np.abs(residuals / sightings.sigmas)[sightings.seen].max(initial=0.0))
    if evidence == "marginal" and worst <= HOPELESS_RESIDUAL:
        log_evidence = marginal_log_evidence(problem, table, poses, joint)
    if log_evidence is None:
        log_evidence = approximation.log_evidence + prior_outside_graph(problem, steps)
    return Estimate(
        poses=poses,
        landmarks=landmarks,
        steps=steps,
        log_likelihood=_log_likelihood(sightings, residuals),
        log_evidence=log_evidence,
        pose_covariances=_diagonal_blocks(joint, 3),
        landmark_covariances=landmark_covariances,
    )


def _with_single_sightings(
    problem: Problem, table: IntArray, ranged: BoolArray, estimate: Estimate
) -> Estimate:
    model, sightings = problem.model, problem.sightings(table)
    landmarks = np.empty((len(table), 2))
    covariances = np.empty((len(table), 2, 2))
    landmarks[ranged], covariances[ranged] = estimate.landmarks, estimate.landmark_covariances
    log_likelihood, log_evidence = estimate.log_likelihood, estimate.log_evidence
    for row in np.flatnonzero(~ranged).tolist():
        scan = int(np.flatnonzero(sightings.seen[row])[0])
        pose, bearing = estimate.poses[scan], sightings.bearings[row, scan]
        ray = np.array([math.cos(pose[2] + bearing), math.sin(pose[2] + bearing)])
        landmarks[row] = pose[:2] + model.landmark_sigma * ray
        covariances[row] = model.landmark_sigma**2 * np.eye(2)
        sigma = sightings.sigmas[row, scan : scan + 1]
        log_likelihood -= math.log(float(sigma[0]) * math.sqrt(2.0 * math.pi))
        log_evidence += float(
            log_landmark_integral(
                pose[None, None],
                np.array([bearing]),
                sigma,
                model.landmark_centre,
                model.landmark_sigma,
            )[0]
        )
    return replace(
        estimate,
        landmarks=landmarks,
        landmark_covariances=covariances,
        log_likelihood=log_likelihood,
        log_evidence=log_evidence,
    )


def _steps(problem: Problem, poses: FloatArray) -> FloatArray:
    """Distances of the problem's free steps; raises where two poses coincide."""
    steps = np.array([np.linalg.norm(poses[b, :2] - poses[a, :2]) for a, b in problem.free_steps])
    if not (np.isfinite(steps).all() and (steps > 1e-9 * problem.baseline).all()):
        raise UnsolvedError("two observation points coincide at the estimate")
    return steps


def _poses(values: gtsam.Values, keys: GraphKeys) -> FloatArray:
    return np.array([[p.x(), p.y(), p.theta()] for p in map(values.atPose2, keys.scans)])


def _residuals(sightings: Sightings, poses: FloatArray, landmarks: FloatArray) -> FloatArray:
    """(n, m) predicted minus measured bearing, wrapped; meaningless where not seen."""
    offset = landmarks[:, None, :] - poses[None, :, :2]
    predicted = np.arctan2(offset[..., 1], offset[..., 0]) - poses[:, 2]
    return wrap_angle(predicted - sightings.bearings)


def _log_likelihood(sightings: Sightings, residuals: FloatArray) -> float:
    z = residuals / sightings.sigmas
    terms = -0.5 * z**2 - np.log(sightings.sigmas) - 0.5 * math.log(2.0 * math.pi)
    return float(terms[sightings.seen].sum())


def _check_sides(
    problem: Problem, sightings: Sightings, residuals: FloatArray, poses: FloatArray
) -> None:
    """A bearing factor is content with a landmark behind the robot; this is not."""
    behind = np.argwhere(sightings.seen & (np.abs(residuals) > 0.5 * math.pi))
    if len(behind):
        row, scan = behind[0].tolist()
        raise UnsolvedError(f"landmark {row} ends up on the far side of its bearing in scan {scan}")
    for a, b in problem.free_steps:
        heading = poses[a, 2] if problem.second_run is not None else 0.0
        forward = np.array([math.cos(heading), math.sin(heading)])
        if float(forward @ (poses[b, :2] - poses[a, :2])) <= 0.0:
            raise UnsolvedError(f"the robot goes backwards from scan {a} to scan {b}")


def _split_covariance(covariance: FloatArray, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Landmark marginals (n, 2, 2), and the joint (3 m, 3 m) of the poses in run axes.

    GTSAM keeps a pose's uncertainty in its own frame; rotating it gives the run's axes.
    """
    split = len(covariance) - 3 * len(poses)
    turn = np.zeros((3 * len(poses), 3 * len(poses)))
    for k, theta in enumerate(poses[:, 2].tolist()):
        c, s = math.cos(theta), math.sin(theta)
        block = slice(3 * k, 3 * k + 3)
        turn[block, block] = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
    joint = turn @ covariance[split:, split:] @ turn.T
    return _diagonal_blocks(covariance[:split, :split], 2), joint


def _diagonal_blocks(matrix: FloatArray, size: int) -> FloatArray:
    """(k, size, size) blocks on the diagonal of a (k size, k size) matrix."""
    count = len(matrix) // size
    blocks = matrix.reshape(count, size, count, size)
    return np.ascontiguousarray(blocks[np.arange(count), :, np.arange(count), :])
