"""The whole run as one factor graph with its associations settled: smoothed trajectory and map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from mht_slam import factors
from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.incremental.motion_terms import (
    FREE,
    ODOMETRY,
    RESTART,
    SHORTEST,
    SMOOTH,
    STILL,
    STRAIGHT,
)
from mht_slam.incremental.steps import FRAME_SIGMA, Step

WIDER = 10.0
"""By how much the landmark prior is widened here: as it is, hundreds of landmarks together would
pull the trajectory small, and one that is seen twice needs a prior only against running away."""
MAX_ROUNDS = 4
"""Times that the priors over step lengths are linearised again."""
SETTLED = 1e-3
"""Relative change of a step below which they are not."""


@dataclass(frozen=True, eq=False)
class WholeRun:
    """Estimates of every pose and of every landmark that two scans or more see.

    Attributes
    ----------
    poses : (m, 3) x, y, theta.
    numbers : (n,) landmarks, increasing.
    points : (n, 2).
    counts : (n,) detections of each.
    owners : for each scan the landmark of each detection, -1 for none, as they were given.
    motion_error : half the squared errors of the steps, in deviations.
    graph, values : to go on in GTSAM; keys are x0, x1, ... and l of the landmark's place in
        `numbers`.
    """

    poses: FloatArray
    numbers: IntArray
    points: FloatArray
    counts: IntArray
    owners: tuple[IntArray, ...]
    motion_error: float
    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values


def smooth_whole_run(
    steps: Sequence[Step],
    owners: Sequence[IntArray],
    bearings: Sequence[FloatArray],
    sigmas: Sequence[FloatArray],
    poses: FloatArray,
    points: dict[int, FloatArray],
    *,
    dof: float | None,
    landmark_sigma: float,
) -> WholeRun:
    """Solve the graph of m scans whose associations are known.

    Parameters
    ----------
    steps : before each scan; the first one carries the frame.
    owners, bearings, sigmas : for each scan the landmark of each detection (-1: none), its bearing
        and standard deviation.
    poses, points : where to start, (m, 3) and by landmark.
    dof, landmark_sigma : of the observation model.

    Landmarks have a weak prior about the place from which they were first seen: nothing else bounds
    those without parallax. Raises `RuntimeError` of GTSAM where the
    graph has no solution.
    """
    rows: dict[int, list[tuple[int, int]]] = {}
    for scan, owner in enumerate(owners):
        for detection, number in enumerate(owner.tolist()):
            if number != MISSED:
                rows.setdefault(number, []).append((scan, detection))
    rows = {number: rows[number] for number in sorted(rows) if len(rows[number]) > 1}
    fixed = gtsam.NonlinearFactorGraph()
    values = gtsam.Values()
    for k, pose in enumerate(poses.tolist()):
        values.insert(X(k), gtsam.Pose2(*pose))
    for i, (number, row) in enumerate(rows.items()):
        first = poses[row[0][0]]
        start = points.get(number)
        if start is None:
            angle = first[2] + bearings[row[0][0]][row[0][1]]
            start = first[:2] + landmark_sigma * np.array([math.cos(angle), math.sin(angle)])
        values.insert(L(i), start)
        centre = (float(first[0]), float(first[1]))
        fixed.push_back(factors.landmark_prior(L(i), centre, WIDER * landmark_sigma))
        for scan, detection in row:
            bearing, sigma = float(bearings[scan][detection]), float(sigmas[scan][detection])
            fixed.push_back(factors.bearing(X(scan), L(i), bearing, sigma, dof))
    parameters = gtsam.LevenbergMarquardtParams.CeresDefaults()
    for _ in range(MAX_ROUNDS):
        before = _poses(values, len(poses))
        graph = gtsam.NonlinearFactorGraph(fixed)
        graph.push_back(_motion(steps, before))
        values = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
        after = _poses(values, len(poses))
        if all(step.kind in (ODOMETRY, STILL) for step in steps):
            break
        old, new = (np.hypot(*np.diff(p[:, :2], axis=0).T) for p in (before, after))
        if np.abs(new - old).max(initial=0.0) <= SETTLED * max(float(new.max(initial=0.0)), 1e-12):
            break
    return WholeRun(
        poses=_poses(values, len(poses)),
        numbers=np.array(list(rows), np.int64),
        counts=np.array([len(row) for row in rows.values()], np.int64),
        points=np.array([values.atPoint2(L(i)) for i in range(len(rows))]).reshape(-1, 2),
        owners=tuple(owners),
        motion_error=_motion(steps, _poses(values, len(poses))).error(values),
        graph=graph,
        values=values,
    )


def _poses(values: gtsam.Values, count: int) -> FloatArray:
    found = [values.atPose2(X(k)) for k in range(count)]
    return np.array([[p.x(), p.y(), p.theta()] for p in found]).reshape(-1, 3)


def _motion(steps: Sequence[Step], poses: FloatArray) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    for factor in _step_factors(steps, poses):
        graph.push_back(factor)
    return graph


def _step_factors(steps: Sequence[Step], poses: FloatArray) -> list[gtsam.NonlinearFactor]:
    """Return the motion factors, log-normal step priors linearised about (m, 3) poses."""
    if not steps:
        return []
    heading_sigma = 1.0 / steps[0].parameters[11]
    noise = gtsam.noiseModel.Diagonal.Sigmas([FRAME_SIGMA, FRAME_SIGMA, heading_sigma])
    result: list[gtsam.NonlinearFactor] = [gtsam.PriorFactorPose2(X(0), gtsam.Pose2(), noise)]
    for k in range(1, len(steps)):
        kind, p = steps[k].kind, steps[k].parameters.tolist()
        here, there = X(k - 1), X(k)
        if kind == ODOMETRY:
            root = np.linalg.inv(np.array(p[3:12]).reshape(3, 3))
            result.append(factors.odometry(here, there, (p[0], p[1], p[2]), root @ root.T))
            continue
        if kind == STILL:
            result.append(factors.standstill(here, there, p[0]))
            continue
        around = max(math.dist(poses[k, :2], poses[k - 1, :2]), SHORTEST)
        if kind == STRAIGHT:
            result.append(factors.heading_prior(there, 0.0, p[0]))
            result.append(factors.on_line(there, 0.0, p[1]))
        else:
            result.append(factors.turn(here, there, p[0]))
            result.append(factors.drift(here, there, p[1]))
        if kind == SMOOTH and k > 1:
            around_both = poses[k - 2 : k + 1]
            if np.hypot(*np.diff(around_both[:, :2], axis=0).T).min() > SHORTEST:
                result.append(factors.step_change((X(k - 2), here, there), around_both, p[2]))
            # A step of no length has no direction in which it could change.
        else:
            mean = p[3] if kind in (RESTART, STRAIGHT, FREE) else 0.0
            result.append(factors.log_step(here, there, mean, p[2], around))
    return result
