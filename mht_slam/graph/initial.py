"""Where the optimiser starts: steps from a grid or an alignment, landmarks by triangulation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.graph.problem import Problem, Sightings
from mht_slam.graph.triangulation import triangulate
from mht_slam.measurements import Odometry

Start: TypeAlias = tuple[FloatArray, FloatArray]
"""Poses (m, 3) and landmarks (n, 2) from which an optimiser starts."""

STEP_GRID = np.linspace(-3.0, 3.0, 49)
"""Starting steps tried, in standard deviations of the log-step prior."""
N_STARTS = 2
"""Most local minima of the gridded cost that the optimiser starts from."""
START_MARGIN = 50.0
"""A further start may cost this much more than the best: 25 nats, more than refining moves it."""


def starting_points(problem: Problem, sightings: Sightings) -> list[Start]:
    """Return up to `N_STARTS` pairs of poses (m, 3) and landmarks (n, 2), the best first.

    For known poses the landmarks separate, so each start triangulates them one by one; only the
    unknown steps (or, for a `RunPair`, the way the runs lie to each other) have to be searched.
    """
    candidates, costs = _candidate_poses(problem, sightings)
    landmarks, landmark_costs = triangulate(problem, sightings, candidates)
    costs = costs + landmark_costs
    return [(candidates[g], landmarks[g]) for g in _local_minima(costs)[:N_STARTS]]


def _candidate_poses(problem: Problem, sightings: Sightings) -> tuple[FloatArray, FloatArray]:
    """(G, m, 3) poses to start from, and (G,) costs of their steps, up to a constant."""
    if problem.second_run is not None:
        poses = _poses_of_two_runs(problem, sightings)
        return poses, _cost_of_last_step(problem, poses)
    match problem.model.motion:
        case "odometry":
            return dead_reckoning(problem.odometry)[None], np.zeros(1)
        case "smooth":
            return _equal_steps(problem), np.zeros(1)
        case _:
            return _poses_on_line(problem, sightings), STEP_GRID**2


def dead_reckoning(odometry: Sequence[Odometry]) -> FloatArray:
    """(m, 3) poses from m - 1 motions, the first at the origin."""
    poses = np.zeros((len(odometry) + 1, 3))
    for k, motion in enumerate(odometry):
        x, y, theta = poses[k]
        c, s = np.cos(theta), np.sin(theta)
        poses[k + 1] = (
            x + c * motion.dx - s * motion.dy,
            y + s * motion.dx + c * motion.dy,
            theta + motion.dtheta,
        )
    return poses


def _equal_steps(problem: Problem) -> FloatArray:
    """(1, m, 3) poses on the x axis, all steps as long as the first, but for standstills."""
    poses = np.zeros((1, len(problem.scans), 3))
    for k in problem.moves:
        poses[0, k + 1 :, 0] += problem.baseline
    return poses


def _poses_on_line(problem: Problem, sightings: Sightings) -> FloatArray:
    """(G, m, 3) poses on the x axis: the last step gridded, those before it the best so far."""
    m = len(problem.scans)
    model = problem.model
    steps = np.exp(model.log_step_mean + model.log_step_sigma * STEP_GRID)
    known = np.zeros((2, 3))
    known[1, 0] = problem.baseline
    while True:
        count = len(known) + 1
        grid = np.zeros((len(steps), count, 3))
        grid[:, :-1] = known
        grid[:, -1, 0] = known[-1, 0] + steps
        if count == m:
            return grid
        costs = triangulate(problem, sightings, grid)[1] + STEP_GRID**2
        known = grid[costs.argmin()]


def _poses_of_two_runs(problem: Problem, sightings: Sightings) -> FloatArray:
    """(G, 4, 3) poses, one set for each two landmarks that align the second run with the first.

    Each run triangulates its landmarks in its own frame; two landmarks in both frames give the
    similarity z -> a + b z between them, and with it O3 = a and O4 = a + b.
    """
    own = np.zeros((1, 2, 3))
    own[0, 1, 0] = problem.baseline
    halves = sightings.of_scans(slice(0, 2)), sightings.of_scans(slice(2, 4))
    first, second = (
        (points := triangulate(problem, half, own)[0][0])[:, 0] + 1j * points[:, 1]
        for half in halves
    )
    i, j = np.triu_indices(len(first), 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        b = (first[j] - first[i]) / (second[j] - second[i])
    a = first[i] - b * second[i]
    usable = np.isfinite(a) & (np.abs(b) > 1e-6)
    a, b = (a[usable], b[usable]) if usable.any() else (np.zeros(1, complex), np.ones(1, complex))
    poses = np.zeros((len(a), 4, 3))
    poses[:, 1, 0] = problem.baseline
    for k, place in ((2, a), (3, a + b * problem.baseline)):
        poses[:, k, 0], poses[:, k, 1], poses[:, k, 2] = place.real, place.imag, np.angle(b)
    return poses


def _cost_of_last_step(problem: Problem, poses: FloatArray) -> FloatArray:
    """(G,) squared residuals of the log-step prior."""
    steps = np.linalg.norm(poses[:, -1, :2] - poses[:, -2, :2], axis=-1)
    residuals = (np.log(steps) - problem.model.log_step_mean) / problem.model.log_step_sigma
    return np.asarray(residuals**2)


def _local_minima(costs: FloatArray) -> list[int]:
    """Indices of entries no higher than both neighbours, the lowest first."""
    fenced = [math.inf, *costs.tolist(), math.inf]
    low = [g for g, cost in enumerate(fenced[1:-1]) if fenced[g] >= cost <= fenced[g + 2]]
    low.sort(key=costs.item)
    return [g for g in low if costs[g] <= costs[low[0]] + START_MARGIN]
