"""Solve one association's graph and check what came out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import gtsam
import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.compiled import compiled
from mht_slam.evidence.bearing_noise import log_bearing_noise
from mht_slam.evidence.importance import Integral
from mht_slam.evidence.landmark_integral import log_landmark_integral
from mht_slam.graph.build import FactorPool, NormalisedGraph
from mht_slam.graph.initial import Start, starting_points
from mht_slam.graph.laplace import SingularGraphError, laplace
from mht_slam.graph.log_range import optimise_in_log_range
from mht_slam.graph.marginal import marginal_log_evidence
from mht_slam.graph.motion import log_density_outside
from mht_slam.graph.problem import Problem, Sightings
from mht_slam.graph.residuals import ranges_and_residuals

EvidenceMethod: TypeAlias = Literal["marginal", "laplace"]

HOPELESS_RESIDUAL = 6.0
"""Residual, in sigmas, beyond which plain Laplace is good enough for an evidence of nothing."""
NEAREST_RANGE = 0.01
"""Range, in baselines, below which a landmark counts as lying on the observation point."""
HOPELESS_ERROR = 50.0
"""Nats of error beyond which the linearised factors may move more, in proportion."""
MAX_RELINEARISATIONS = 10
RELINEARISED = 1e-4
"""Relative change of steps below which linearised factors are taken as exact.

The value of such a factor changes by the square of it.
"""
PARAMETERS = gtsam.LevenbergMarquardtParams.CeresDefaults()
"""Diagonal damping: with GTSAM's own defaults wrong hypotheses stop short of their optimum."""


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
    """Where the optimiser over positions leads, and the density over log ranges may not.

    A landmark on an observation point, or a robot that goes backwards along its line.
    """


def solve_association(
    problem: Problem,
    table: IntArray,
    evidence: EvidenceMethod = "marginal",
    start: Start | None = None,
    pool: FactorPool | None = None,
    *,
    rescue: bool = True,
) -> Estimate:
    """Estimate poses and landmarks of one association from its best start.

    `evidence` says how the evidence is computed, see `mht_slam.graph.refine.refine`. `start`, poses
    (m, 3) and landmarks (n, 2) in any unit, saves looking for one. `pool`, the factors of this
    problem, saves making them for every association. `rescue` says whether an optimum over
    positions on an observation point, or behind the robot, is followed by that look over log
    ranges; without it `TrappedError` is raised.

    The optimum over positions may lie on an observation point, where a landmark explains any
    bearing, or where the robot goes backwards. The optimum over bearings and log ranges is taken
    then; Laplace at that point is Laplace in those coordinates, because the Jacobians cancel. With
    motion other than ``straight`` it is always taken: far landmarks are less skewed there, too.

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
        length = float(np.linalg.norm(poses[problem.second_place, :2] - poses[0, :2]))
        in_baselines = problem.model.motion != "odometry" and bool(problem.moves)
        unit = problem.baseline / length if in_baselines else 1.0
        start = poses * np.array([unit, unit, 1.0]), unit * landmarks[ranged]
    estimate = _solve_ranged(
        pool or FactorPool(problem), table[ranged], evidence, start, rescue=rescue
    )
    return estimate if ranged.all() else _with_single_sightings(problem, table, ranged, estimate)


def _solve_ranged(
    pool: FactorPool,
    table: IntArray,
    evidence: EvidenceMethod,
    start: Start | None,
    *,
    rescue: bool,
) -> Estimate:
    problem = pool.problem
    sightings = problem.sightings(table)
    subject = _Subject(pool, sightings, pool.unlinearised(table))
    on_line = problem.model.motion == "straight"
    given = start if not on_line else None
    starts = starting_points(problem, sightings) if given is None else [given]
    optima, failures = _optima(subject, starts, in_log_range=not on_line)
    traps = [failure for failure in failures if isinstance(failure, TrappedError)]
    if traps and not optima and on_line:
        if not rescue:
            raise traps[0]
        rescued, _ = _optima(subject, starts, in_log_range=True)
        inside, _ = _optima(subject, [(o.poses, o.landmarks) for o in rescued], in_log_range=False)
        optima = inside or rescued
    if not optima:
        raise UnsolvedError(str(failures[0]).strip().splitlines()[0]) from failures[0]
    best = max(optima, key=lambda optimum: optimum.log_density)
    return _estimate(subject, table, best, evidence)


@dataclass(frozen=True)
class _Subject:
    """What is solved: an association's bearings and factors."""

    pool: FactorPool
    sightings: Sightings
    unlinearised: NormalisedGraph

    @property
    def problem(self) -> Problem:
        return self.pool.problem


@dataclass(frozen=True)
class _Optimum:
    """Where the optimiser stopped, after the checks.

    `graph` is linearised there. `with_volumes` is the graph of an optimum over log ranges, None for
    one over positions.
    """

    graph: gtsam.NonlinearFactorGraph
    log_density: float
    values: gtsam.Values
    with_volumes: gtsam.NonlinearFactorGraph | None
    poses: FloatArray
    landmarks: FloatArray
    residuals: FloatArray


def _optima(
    subject: _Subject, starts: Sequence[Start], *, in_log_range: bool
) -> tuple[list[_Optimum], list[Exception]]:
    """Sound optima reached from the starts, and why the others are none."""
    optima: list[_Optimum] = []
    failures: list[Exception] = []
    for poses, landmarks in starts:
        try:
            optima.append(_optimise(subject, poses, landmarks, in_log_range))
        except (RuntimeError, UnsolvedError) as cause:  # GTSAM's own errors are RuntimeErrors
            failures.append(cause)
    return optima, failures


def _optimise(
    subject: _Subject, poses: FloatArray, landmarks: FloatArray, in_log_range: bool
) -> _Optimum:
    """Levenberg-Marquardt, repeated until the linearised factors stand still.

    Those are the step priors and, with `in_log_range`, the volumes of `optimise_in_log_range`.
    """
    pool, problem, sightings = subject.pool, subject.problem, subject.sightings
    values = pool.values(poses, landmarks)
    with_volumes: gtsam.NonlinearFactorGraph | None = None
    anchors = _anchors(subject, poses, landmarks) if in_log_range else []
    steps = _steps(problem, poses)
    linearised = pool.linearised(subject.unlinearised, poses, steps)
    for _ in range(MAX_RELINEARISATIONS):
        if in_log_range:
            values, with_volumes = optimise_in_log_range(
                linearised.graph, values, anchors, PARAMETERS
            )
        else:
            optimiser = gtsam.LevenbergMarquardtOptimizer(linearised.graph, values, PARAMETERS)
            values = optimiser.optimize()
        poses = np.ascontiguousarray(gtsam.utilities.extractPose2(values))
        landmarks = np.ascontiguousarray(gtsam.utilities.extractPoint2(values))
        ranges, residuals = ranges_and_residuals(
            poses, landmarks, sightings.bearings, sightings.seen
        )
        if not in_log_range:
            _check_ranges(problem, ranges)
        before, steps = steps, _steps(problem, poses)
        linearised = pool.linearised(subject.unlinearised, poses, steps)
        error = linearised.graph.error(values)
        still = RELINEARISED * max(1.0, error / HOPELESS_ERROR)
        if all(
            abs(a / b - 1.0) <= still for a, b in zip(steps.tolist(), before.tolist(), strict=True)
        ):
            break
    log_density = linearised.log_normaliser - error
    if not math.isfinite(log_density + poses.sum() + landmarks.sum()):
        raise UnsolvedError("the optimiser ended at numbers that are not finite")
    _check_sides(problem, residuals, poses)
    if in_log_range:
        _check_ranges(problem, ranges)
    return _Optimum(
        linearised.graph, log_density, values, with_volumes, poses, landmarks, residuals
    )


def _estimate(
    subject: _Subject, table: IntArray, optimum: _Optimum, evidence: EvidenceMethod
) -> Estimate:
    problem, sightings = subject.problem, subject.sightings
    poses, residuals = optimum.poses, optimum.residuals
    try:
        approximation = laplace(
            optimum.graph, optimum.values, optimum.with_volumes, optimum.log_density
        )
    except SingularGraphError as cause:
        raise UnsolvedError(str(cause)) from cause
    landmark_covariances, pose_covariances, joint = _marginals(approximation.covariance, poses)
    integral: Integral | None = None
    if evidence == "marginal":
        worst = float(np.abs(residuals / sightings.sigmas)[sightings.seen].max(initial=0.0))
        if worst <= HOPELESS_RESIDUAL:
            integral = marginal_log_evidence(problem, table, poses, joint)
    plain = approximation.log_evidence + log_density_outside(problem, poses)
    return Estimate(
        poses=poses,
        landmarks=optimum.landmarks,
        log_likelihood=_log_likelihood(sightings, residuals, problem.model.bearing_dof),
        log_evidence=plain if integral is None else integral.log_value,
        log_evidence_error=None if integral is None else integral.error,
        pose_covariances=pose_covariances,
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


def _anchors(subject: _Subject, poses: FloatArray, landmarks: FloatArray) -> list[tuple[int, int]]:
    """Keys of the pose from which each landmark's log range is taken: the nearest that sees it.

    On one line a landmark between two observation points, nearer to both than they are to each
    other, gets both. From one alone it may be driven onto the other; in bipolar coordinates, whose
    area is the product of the two, both are infinitely far away.
    """
    sightings, keys = subject.sightings, subject.pool.keys(len(landmarks))
    ranges, _ = ranges_and_residuals(poses, landmarks, sightings.bearings, sightings.seen)
    order = ranges.argsort(axis=1, kind="stable")
    on_line = subject.problem.model.motion == "straight"
    anchors = []
    for row, (nearest, second) in enumerate(order[:, :2].tolist()):
        anchors.append((keys.scans[nearest], keys.landmarks[row]))
        apart = math.dist(poses[nearest, :2], poses[second, :2])
        if on_line and ranges[row, second] < apart:
            anchors.append((keys.scans[second], keys.landmarks[row]))
    return anchors


def _steps(problem: Problem, poses: FloatArray) -> FloatArray:
    """Distances of the problem's free steps; raises where two poses coincide."""
    steps = problem.free_lengths(poses)
    shortest = 1e-9 * problem.baseline
    if not all(shortest < step < math.inf for step in steps.tolist()):
        raise UnsolvedError("two observation points coincide at the estimate")
    return steps


def _log_likelihood(sightings: Sightings, residuals: FloatArray, dof: float | None) -> float:
    """Sum of the log densities of the residuals: Gaussian, or Student's t."""
    squares = (residuals / sightings.sigmas) ** 2
    terms = log_bearing_noise(squares, dof) - np.log(sightings.sigmas)
    return float(terms[sightings.seen].sum())


def _check_sides(problem: Problem, residuals: FloatArray, poses: FloatArray) -> None:
    """A bearing factor is content with a landmark behind the robot; this is not."""
    behind = np.abs(residuals) > 0.5 * math.pi
    if behind.any():
        row, scan = np.argwhere(behind)[0].tolist()
        raise UnsolvedError(f"landmark {row} ends up on the far side of its bearing in scan {scan}")
    if problem.model.motion in ("odometry", "free"):
        return
    on_one_line = problem.second_run is None and problem.model.motion == "straight"
    rows = poses.tolist()  # too few for array operations to be worth their calls
    for a, b in problem.free_steps:
        (x, y, heading), (next_x, next_y, _) = rows[a], rows[b]
        heading = 0.0 if on_one_line else heading
        if math.cos(heading) * (next_x - x) + math.sin(heading) * (next_y - y) <= 0.0:
            raise TrappedError(f"the robot goes backwards from scan {a} to scan {b}")


def _check_ranges(problem: Problem, ranges: FloatArray) -> None:
    """A landmark on an observation point explains any bearing from there: a trap, not a place.

    The density is bounded there and its volume is nothing, but optimisers slide into it as soon
    as headings may deviate.
    """
    nearest = NEAREST_RANGE * problem.baseline
    near = ranges < nearest
    if near.any():
        row, scan = np.argwhere(near)[0].tolist()
        raise TrappedError(f"landmark {row} ends up on the observation point of scan {scan}")


@compiled
def _marginals(
    covariance: FloatArray, poses: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Marginals of landmarks (n, 2, 2) and poses (m, 3, 3), and the poses' joint (3 m, 3 m).

    GTSAM keeps a pose's uncertainty in its own frame; rotating it gives the run's axes.
    """
    m = len(poses)
    n = (len(covariance) - 3 * m) // 2
    landmarks, marginals = np.empty((n, 2, 2)), np.empty((m, 3, 3))
    for row in range(n):
        landmarks[row] = covariance[2 * row : 2 * row + 2, 2 * row : 2 * row + 2]
    joint = covariance[2 * n :, 2 * n :].copy()
    for k in range(m):
        cosine, sine = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        x, y = 3 * k, 3 * k + 1
        for i in range(3 * m):
            joint[x, i], joint[y, i] = (
                cosine * joint[x, i] - sine * joint[y, i],
                sine * joint[x, i] + cosine * joint[y, i],
            )
        for i in range(3 * m):
            joint[i, x], joint[i, y] = (
                cosine * joint[i, x] - sine * joint[i, y],
                sine * joint[i, x] + cosine * joint[i, y],
            )
    for k in range(m):
        marginals[k] = joint[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
    return landmarks, marginals, joint
