"""How the poses of a run follow each other, as factors: one function for each motion model."""

from __future__ import annotations

import math
from itertools import pairwise

import gtsam
import numpy as np

from mht_slam import factors
from mht_slam.arrays import FloatArray
from mht_slam.graph.problem import Problem

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
    if problem.second_run is not None:
        return _two_straight_runs(problem, keys, poses)
    match problem.model.motion:
        case "straight":
            return _straight(problem, keys, poses)
        case "smooth":
            return _smooth(problem, keys, poses)
        case "odometry":
            return _odometry(problem, keys)
        case "free":
            return [*_gauge(problem, keys), *_log_steps(problem, keys, poses)]


def log_density_outside(problem: Problem, poses: FloatArray) -> float:
    """Log prior density of the poses that no factor holds, evaluated at (m, 3) `poses`.

    Priors over the length s and the direction phi of a step become densities over the next
    position by dx dy = s ds dphi, hence -ln s; a prior over ln s, where the factor does not hold
    it, gives another -ln s. The second run of a `RunPair` and the steps of ``free`` motion point
    anywhere: -ln 2 pi; so do the headings of ``free`` motion.
    """
    log_two_pi = math.log(2.0 * math.pi)
    log_lengths = np.log(problem.free_lengths(poses))
    if problem.second_run is not None:
        return -log_two_pi - float(log_lengths[-1])
    match problem.model.motion:
        case "smooth":
            walk = len(log_lengths) * math.log(problem.model.step_change_sigma)
            return -2.0 * float(log_lengths.sum()) - walk
        case "free":
            directions = len(log_lengths) + len(poses)
            return -float(log_lengths.sum()) - directions * log_two_pi
        case _:
            return 0.0


def _gauge(problem: Problem, keys: tuple[int, ...]) -> tuple[gtsam.NonlinearFactor, ...]:
    return factors.first_baseline(keys[0], keys[1], length=problem.baseline)


def _straight(
    problem: Problem, keys: tuple[int, ...], poses: FloatArray
) -> list[gtsam.NonlinearFactor]:
    return [
        *_gauge(problem, keys),
        *(factors.heading_prior(key, 0.0, problem.heading_sigma) for key in keys),
        *(factors.on_line(key, 0.0, problem.lateral_sigma) for key in keys[2:]),
        *_log_steps(problem, keys, poses),
    ]


def _two_straight_runs(
    problem: Problem, keys: tuple[int, ...], poses: FloatArray
) -> list[gtsam.NonlinearFactor]:
    """The second run lies anywhere: a position prior like a landmark's, and any direction."""
    model = problem.model
    third, fourth = keys[2:]
    return [
        *_gauge(problem, keys),
        *(factors.heading_prior(key, 0.0, problem.heading_sigma) for key in keys[:2]),
        factors.position_prior(third, model.landmark_centre, model.landmark_sigma),
        *factors.straight_segment(third, fourth, problem.heading_sigma),
        *_log_steps(problem, keys, poses),
    ]


def _smooth(
    problem: Problem, keys: tuple[int, ...], poses: FloatArray
) -> list[gtsam.NonlinearFactor]:
    model = problem.model
    result: list[gtsam.NonlinearFactor] = [*_gauge(problem, keys)]
    for key, next_key in pairwise(keys):
        result.append(factors.turn(key, next_key, model.turn_sigma))
        result.append(factors.drift(key, next_key, model.drift_sigma))
    result.extend(
        factors.step_change(three, poses[k : k + 3], model.step_change_sigma)
        for k, three in enumerate(zip(keys, keys[1:], keys[2:], strict=False))
    )
    return result


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


def _log_steps(
    problem: Problem, keys: tuple[int, ...], poses: FloatArray
) -> list[gtsam.NonlinearFactor]:
    """Log-normal step priors, linearised about the lengths in `poses`."""
    mean, sigma = problem.model.log_step_mean, problem.model.log_step_sigma
    lengths = problem.free_lengths(poses).tolist()
    return [
        factors.log_step(keys[a], keys[b], mean, sigma, around)
        for (a, b), around in zip(problem.free_steps, lengths, strict=True)
    ]
