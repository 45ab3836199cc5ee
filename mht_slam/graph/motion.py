"""How the poses of a run follow each other, as factors: one function for each motion model."""

from __future__ import annotations

import math
from itertools import pairwise

import gtsam
import numpy as np

from mht_slam import factors
from mht_slam.arrays import FloatArray
from mht_slam.factors.density import HALF_LOG_2PI
from mht_slam.graph.problem import Problem

STILL_SIGMA = 1e-3
"""How far a robot that stands still moves, baselines, and turns, radians."""
RESTART_SIGMA = 1.0
"""Standard deviation of ln(step / step before) across a standstill."""
ORIGIN_SIGMA = 1e-3
"""Soft gauge of the first pose where odometry gives the scale, metres and radians."""


def motion_factors(
    problem: Problem, keys: tuple[int, ...], poses: FloatArray
) -> list[gtsam.NonlinearFactor]:
    """Everything that holds the poses but the bearings: gauge and motion prior.

    Parameters
    ----------
    problem : the scans and their model.
    keys : of the m poses.
    poses : (m, 3) about which the log-normal step priors are linearised; at the estimate they are
        the estimated poses.
    """
    fixed = fixed_motion_factors(problem, keys)
    lengths = problem.free_lengths(poses)
    return [*fixed, *linearised_motion_factors(problem, keys, poses, lengths)[0]]


def fixed_motion_factors(problem: Problem, keys: tuple[int, ...]) -> list[gtsam.NonlinearFactor]:
    """Those motion factors that hang on no estimate."""
    if problem.second_run is not None:
        return _two_straight_runs(problem, keys)
    match problem.model.motion:
        case "straight":
            return _straight(problem, keys)
        case "smooth":
            return _smooth(problem, keys)
        case "odometry":
            return _odometry(problem, keys)
        case "free":
            return [*_gauge(problem, keys)]


def linearised_motion_factors(
    problem: Problem, keys: tuple[int, ...], poses: FloatArray, lengths: FloatArray
) -> tuple[list[gtsam.NonlinearFactor], float]:
    """Log-normal priors over steps or their changes, linearised about (m, 3) `poses`.

    `lengths` are those of the problem's free steps there. With the factors comes the sum of their
    log normalisers, which takes less time than asking each.
    """
    if problem.model.motion == "smooth":
        changes = [
            factors.step_change((keys[i], keys[j], keys[j + 1]), poses[[i, j, j + 1]], sigma)
            for i, j, sigma in _step_changes(problem)
        ]
        return [*changes], -len(changes) * HALF_LOG_2PI
    mean, sigma = problem.model.log_step_mean, problem.model.log_step_sigma
    steps, log_sigmas = [], 0.0
    for (a, b), around in zip(problem.free_steps, lengths.tolist(), strict=True):
        steps.append(factors.log_step(keys[a], keys[b], mean, sigma, around))
        log_sigmas += math.log(sigma * around)
    return [*steps], -log_sigmas - len(steps) * HALF_LOG_2PI


def log_density_outside(problem: Problem, poses: FloatArray) -> float:
    """Log prior density of the poses that no factor holds, evaluated at (m, 3) `poses`.

    Priors over the length s and the direction phi of a step become densities over the next
    position by dx dy = s ds dphi, hence -ln s; a prior over ln s, where the factor does not hold
    it, gives another -ln s. The second run of a `RunPair` and the steps of ``free`` motion point
    anywhere: -ln 2 pi; so do the headings of ``free`` motion.
    """
    if problem.model.motion in ("straight", "odometry") and problem.second_run is None:
        return 0.0
    log_two_pi = math.log(2.0 * math.pi)
    log_lengths = np.log(problem.free_lengths(poses))
    if problem.second_run is not None:
        return -log_two_pi - float(log_lengths[-1])
    match problem.model.motion:
        case "smooth":
            walk = sum(math.log(sigma) for _, _, sigma in _step_changes(problem))
            return -2.0 * float(log_lengths.sum()) - walk
        case "free":
            directions = len(log_lengths) + len(poses)
            return -float(log_lengths.sum()) - directions * log_two_pi
        case _:
            return 0.0


def _gauge(problem: Problem, keys: tuple[int, ...]) -> tuple[gtsam.NonlinearFactor, ...]:
    return factors.first_baseline(keys[0], keys[1], length=problem.baseline)


def _straight(problem: Problem, keys: tuple[int, ...]) -> list[gtsam.NonlinearFactor]:
    return [
        *_gauge(problem, keys),
        *(factors.heading_prior(key, 0.0, problem.heading_sigma) for key in keys),
        *(factors.on_line(key, 0.0, problem.lateral_sigma) for key in keys[2:]),
    ]


def _two_straight_runs(problem: Problem, keys: tuple[int, ...]) -> list[gtsam.NonlinearFactor]:
    """The second run lies anywhere: a position prior like a landmark's, and any direction."""
    model = problem.model
    third, fourth = keys[2:]
    return [
        *_gauge(problem, keys),
        *(factors.heading_prior(key, 0.0, problem.heading_sigma) for key in keys[:2]),
        factors.position_prior(third, model.landmark_centre, model.landmark_sigma),
        *factors.straight_segment(third, fourth, problem.heading_sigma),
    ]


def _smooth(problem: Problem, keys: tuple[int, ...]) -> list[gtsam.NonlinearFactor]:
    """The first step points along +x, so its drift is the heading before it."""
    model = problem.model
    origin, second = factors.first_baseline(
        keys[0], keys[problem.second_place], length=problem.baseline
    )
    result: list[gtsam.NonlinearFactor] = [
        origin,
        factors.heading_prior(keys[0], 0.0, model.drift_sigma),
    ]
    for k, (key, next_key) in enumerate(pairwise(keys)):
        if k not in problem.moves:
            result.append(factors.standstill(key, next_key, STILL_SIGMA * problem.baseline))
            continue
        result.append(factors.turn(key, next_key, model.turn_sigma))
        if k == problem.moves[0]:
            result.append(second)
        else:
            result.append(factors.drift(key, next_key, model.drift_sigma))
    return result


def _step_changes(problem: Problem) -> list[tuple[int, int, float]]:
    """Scans from which two consecutive steps set out, and how much the second may differ.

    After a standstill a step may have any length.
    """
    walk = problem.model.step_change_sigma
    return [
        (i, j, walk if j == i + 1 else max(walk, RESTART_SIGMA)) for i, j in pairwise(problem.moves)
    ]


def _odometry(problem: Problem, keys: tuple[int, ...]) -> list[gtsam.NonlinearFactor]:
    noise = gtsam.noiseModel.Isotropic.Sigma(3, ORIGIN_SIGMA)
    result: list[gtsam.NonlinearFactor] = [
        gtsam.PriorFactorPose2(keys[0], gtsam.Pose2(), noise),
    ]
    for (key, next_key), motion in zip(pairwise(keys), problem.odometry, strict=True):
        increments = motion.dx, motion.dy, motion.dtheta
        assert motion.covariance is not None  # noqa: S101 - `make_problem` refuses such scans
        result.append(factors.odometry(key, next_key, increments, motion.covariance))
    return result
