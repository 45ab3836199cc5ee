"""Solve one association's graph and check what came out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import gtsam
import numpy as np
from scipy import stats

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.evidence.importance import Integral
from mht_slam.evidence.landmark_integral import log_landmark_integral
from mht_slam.graph.build import (
    GraphKeys,
    build_graph,
    graph_keys,
    make_values,
)
from mht_slam.graph.initial import Start, starting_points
from mht_slam.graph.laplace import SingularGraphError, laplace
from mht_slam.graph.log_range import optimise_in_log_range
from mht_slam.graph.marginal import marginal_log_evidence
from mht_slam.graph.motion import log_density_outside
from mht_slam.graph.problem import Problem, Sightings
from mht_slam.measurements import wrap_angle

EvidenceMethod: TypeAlias = Literal["marginal", "laplace"]

HOPELESS_RESIDUAL = 6.0
"""Residual, in sigmas, beyond which plain Laplace is good enough for an evidence of nothing."""
NEAREST_RANGE = 0.01
"""Range, in baselines, below which a landmark counts as lying on the observation point."""
MAX_RELINEARISATIONS = 10
RELINEARISED = 1e-4
"""Relative change of steps below which linearised factors are taken as exact.

The value of such a factor changes by the square of it.
"""


@dataclass(frozen=True)
class Estimate:
    """What a solved graph says; all arrays finite.

    Attributes
    ----------
    poses : (m, 3); landmarks : (n, 2).
    log_likelihood : normalised bearing terms at the estimate.
    log_evidence : evidence of the graph, without the weights of misses and false alarms.
    log_evidence_error : its standard error; None for plain Laplace, which knows none.
    pose_covariances : (m, 3, 3) in run axes; landmark_covariances : (n, 2, 2).
    """

    poses: FloatArray
    landmarks: FloatArray
    log_likelihood: float
    log_evidence: float
    log_evidence_error: float | None
    pose_covariances: FloatArray
    landmark_covariances: FloatArray


class UnsolvedError(ArithmeticError):
    """An association whose graph gave no usable estimate; the message says why."""


class TrappedError(UnsolvedError):
    """A landmark that the optimiser put on an observation point."""


def solve_association(
    problem: Problem,
    table: IntArray,
    evidence: EvidenceMethod = "marginal",
    start: Start | None = None,
) -> Estimate:
    """Estimate poses and landmarks of one association from its best start.

    `evidence` says how the evidence is computed, see `mht_slam.graph.refine.refine`. `start`, poses
    (m, 3) and landmarks (n, 2) in any unit, saves looking for one.

    With wandering headings the optimum over positions may lie on an observation point, where a
    landmark explains any bearing. The optimum over bearings and log ranges is taken then; Laplace
    at that point is Laplace in those coordinates, because the Jacobians cancel. With motion other
    than ``straight`` it is always taken: far landmarks are less skewed there, too.

    Raises `UnsolvedError` where the optimiser fails from every start, a number is not finite, a
    landmark lies behind a bearing that sees it, the robot goes backwards, or the Hessian is
    singular.

    A landmark seen once says nothing of the poses, and its position is its prior's: it stays out
    of the graph, counts with its integral at the estimated poses, and is put on its ray at one
    standard deviation of the prior, with the prior's covariance.
    """
    ranged = (table != MISSED).sum(axis=1) >= 2
    if start is not None:
        poses, landmarks = start
        length = float(np.linalg.norm(poses[1, :2] - poses[0, :2]))
        unit = 1.0 if problem.model.motion == "odometry" else problem.baseline / length
        start = poses * np.array([unit, unit, 1.0]), unit * landmarks[ranged]
    estimate = _solve_ranged(problem, table[ranged], evidence, start)
    return estimate if ranged.all() else _with_single_sightings(problem, table, ranged, estimate)


def _solve_ranged(
    problem: Problem, table: IntArray, evidence: EvidenceMethod, start: Start | None
) -> Estimate:
    if problem.model.motion != "straight":
        starts = starting_points(problem, table) if start is None else [start]
        optima, failures = _optima(problem, table, starts, in_log_range=True)
        if not optima:
            raise UnsolvedError(str(failures[0]).strip().splitlines()[0]) from failures[0]
        return _estimate(problem, table, min(optima, key=lambda o: o.error), evidence)
    starts = starting_points(problem, table)
    optima, failures = _optima(problem, table, starts)
    trapped = any(isinstance(failure, TrappedError) for failure in failures)
    if not optima and trapped:
        rescued, _ = _optima(problem, table, starts, in_log_range=True)
        inside, _ = _optima(problem, table, [(o.poses, o.landmarks) for o in rescued])
        optima = inside or rescued
    if not optima:
        raise UnsolvedError(str(failures[0]).strip().splitlines()[0]) from failures[0]
    best = min(optima, key=lambda optimum: optimum.error)
    return _estimate(problem, table, best, evidence)


@dataclass(frozen=True)
class _Optimum:
    """Where the optimiser stopped, after the checks.

    `with_volumes` is the graph of an optimum over log ranges, None for one over positions.
    """

    error: float
    values: gtsam.Values
    with_volumes: gtsam.NonlinearFactorGraph | None
    poses: FloatArray
    landmarks: FloatArray
    residuals: FloatArray


def _optima(
    problem: Problem,
    table: IntArray,
    starts: Sequence[tuple[FloatArray, FloatArray]],
    *,
    in_log_range: bool = False,
) -> tuple[list[_Optimum], list[Exception]]:
    """Sound optima reached from the starts, and why the others are none."""
    optima: list[_Optimum] = []
    failures: list[Exception] = []
    for poses, landmarks in starts:
        try:
            optima.append(_optimise(problem, table, poses, landmarks, in_log_range))
        except (RuntimeError, UnsolvedError) as cause:  # GTSAM's own errors are RuntimeErrors
            failures.append(cause)
    return optima, failures


def _optimise(
    problem: Problem,
    table: IntArray,
    poses: FloatArray,
    landmarks: FloatArray,
    in_log_range: bool,
) -> _Optimum:
    """Levenberg-Marquardt, repeated until the linearised factors stand still.

    Those are the step priors and, with `in_log_range`, the volumes of `optimise_in_log_range`.
    """
    keys = graph_keys(len(problem.scans), len(table))
    sightings = problem.sightings(table)
    values = make_values(poses, landmarks)
    parameters = gtsam.LevenbergMarquardtParams.CeresDefaults()
    with_volumes: gtsam.NonlinearFactorGraph | None = None
    nearest = _ranges(sightings, poses, landmarks).argmin(axis=1).tolist()
    anchors = [(keys.scans[k], key) for k, key in zip(nearest, keys.landmarks, strict=True)]
    for _ in range(MAX_RELINEARISATIONS):
        steps = _steps(problem, poses)
        graph = build_graph(problem, table, poses)
        if in_log_range:
            values, with_volumes = optimise_in_log_range(graph, values, anchors, parameters)
        else:
            values = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
        poses = _poses(values, keys)
        landmarks = np.array([values.atPoint2(key) for key in keys.landmarks]).reshape(-1, 2)
        if not in_log_range:
            _check_ranges(problem, sightings, poses, landmarks)
        moved = np.abs(_steps(problem, poses) / steps - 1.0).max(initial=0.0)
        if moved <= RELINEARISED:
            break
    error = build_graph(problem, table, poses).error(values)
    if not (math.isfinite(error) and np.isfinite(poses).all() and np.isfinite(landmarks).all()):
        raise UnsolvedError("the optimiser ended at numbers that are not finite")
    residuals = _residuals(sightings, poses, landmarks)
    _check_sides(problem, sightings, residuals, poses)
    _check_ranges(problem, sightings, poses, landmarks)
    return _Optimum(error, values, with_volumes, poses, landmarks, residuals)


def _estimate(
    problem: Problem, table: IntArray, optimum: _Optimum, evidence: EvidenceMethod
) -> Estimate:
    sightings = problem.sightings(table)
    poses, residuals = optimum.poses, optimum.residuals
    try:
        approximation = laplace(
            build_graph(problem, table, poses), optimum.values, optimum.with_volumes
        )
    except SingularGraphError as cause:
        raise UnsolvedError(str(cause)) from cause
    landmark_covariances, joint = _split_covariance(approximation.covariance, poses)
    integral: Integral | None = None
    worst = float(np.abs(residuals / sightings.sigmas)[sightings.seen].max(initial=0.0))
    if evidence == "marginal" and worst <= HOPELESS_RESIDUAL:
        integral = marginal_log_evidence(problem, table, poses, joint)
    plain = approximation.log_evidence + log_density_outside(problem, poses)
    return Estimate(
        poses=poses,
        landmarks=optimum.landmarks,
        log_likelihood=_log_likelihood(sightings, residuals, problem.model.bearing_dof),
        log_evidence=plain if integral is None else integral.log_value,
        log_evidence_error=None if integral is None else integral.error,
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
    steps = problem.free_lengths(poses)
    if not (np.isfinite(steps).all() and (steps > 1e-9 * problem.baseline).all()):
        raise UnsolvedError("two observation points coincide at the estimate")
    return steps


def _ranges(sightings: Sightings, poses: FloatArray, landmarks: FloatArray) -> FloatArray:
    """(n, m) distances of landmarks from the poses that see them, infinite from others."""
    distances = np.linalg.norm(landmarks[:, None] - poses[None, :, :2], axis=-1)
    return np.where(sightings.seen, np.maximum(distances, 1e-9), np.inf)


def _poses(values: gtsam.Values, keys: GraphKeys) -> FloatArray:
    return np.array([[p.x(), p.y(), p.theta()] for p in map(values.atPose2, keys.scans)])


def _residuals(sightings: Sightings, poses: FloatArray, landmarks: FloatArray) -> FloatArray:
    """(n, m) predicted minus measured bearing, wrapped; meaningless where not seen."""
    offset = landmarks[:, None, :] - poses[None, :, :2]
    predicted = np.arctan2(offset[..., 1], offset[..., 0]) - poses[:, 2]
    return wrap_angle(predicted - sightings.bearings)


def _log_likelihood(sightings: Sightings, residuals: FloatArray, dof: float | None) -> float:
    z = residuals / sightings.sigmas
    density = stats.norm if dof is None else stats.t(dof)
    terms = density.logpdf(z) - np.log(sightings.sigmas)
    return float(terms[sightings.seen].sum())


def _check_sides(
    problem: Problem, sightings: Sightings, residuals: FloatArray, poses: FloatArray
) -> None:
    """A bearing factor is content with a landmark behind the robot; this is not."""
    behind = np.argwhere(sightings.seen & (np.abs(residuals) > 0.5 * math.pi))
    if len(behind):
        row, scan = behind[0].tolist()
        raise UnsolvedError(f"landmark {row} ends up on the far side of its bearing in scan {scan}")
    if problem.model.motion in ("odometry", "free"):
        return
    for a, b in problem.free_steps:
        on_one_line = problem.second_run is None and problem.model.motion == "straight"
        heading = 0.0 if on_one_line else poses[a, 2]
        forward = np.array([math.cos(heading), math.sin(heading)])
        if float(forward @ (poses[b, :2] - poses[a, :2])) <= 0.0:
            raise UnsolvedError(f"the robot goes backwards from scan {a} to scan {b}")


def _check_ranges(
    problem: Problem, sightings: Sightings, poses: FloatArray, landmarks: FloatArray
) -> None:
    """A landmark on an observation point explains any bearing from there: a trap, not a place.

    The density is bounded there and its volume is nothing, but optimisers slide into it as soon
    as headings may deviate.
    """
    ranges = _ranges(sightings, poses, landmarks)
    trapped = np.argwhere(ranges < NEAREST_RANGE * problem.baseline)
    if len(trapped):
        row, scan = trapped[0].tolist()
        raise TrappedError(f"landmark {row} ends up on the observation point of scan {scan}")


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
