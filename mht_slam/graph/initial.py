"""Where the optimiser starts: steps from a grid or an alignment, landmarks by triangulation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.graph.problem import Problem, Sightings
from mht_slam.measurements import Odometry, wrap_angle

Start: TypeAlias = tuple[FloatArray, FloatArray]
"""Poses (m, 3) and landmarks (n, 2) from which an optimiser starts."""

STEP_GRID = np.linspace(-3.0, 3.0, 49)
"""Starting steps tried, in standard deviations of the log-step prior."""
FAR_RANGES = np.array([2.0, 8.0, 30.0])
"""Ranges tried, in baselines, for rays that do not meet in front of the robot."""
N_STARTS = 2
"""Most local minima of the gridded cost that the optimiser starts from."""
START_MARGIN = 50.0
"""A further start may cost this much more than the best: 25 nats, more than refining moves it."""


def starting_points(problem: Problem, table: IntArray) -> list[Start]:
    """Return up to `N_STARTS` pairs of poses (m, 3) and landmarks (n, 2), the best first.

    For known poses the landmarks separate, so each start triangulates them one by one; only the
    unknown steps (or, for a `RunPair`, the way the runs lie to each other) have to be searched.
    """
    sightings = problem.sightings(table)
    candidates = _candidate_poses(problem, sightings)
    landmarks, costs = triangulate(problem, sightings, candidates)
    costs = costs + _step_cost(problem, candidates)
    return [(candidates[g], landmarks[g]) for g in _local_minima(costs)[:N_STARTS]]


def triangulate(
    problem: Problem, sightings: Sightings, poses: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Triangulate every landmark from every one of G sets of poses.

    Parameters
    ----------
    problem : gives the landmark prior.
    sightings : (n, m) bearings.
    poses : (G, m, 3).

    Returns
    -------
    landmarks : (G, n, 2). Weighted least squares over the distances to the rays, reweighted once
        with the ranges found; where rays diverge, the best of a few points far out instead.
    costs : (G,) sum of squared bearing and landmark prior residuals, in standard deviations.
    """
    rays = poses[:, None, :, 2] + sightings.bearings  # (G, n, m)
    origins = poses[:, None, :, :2]  # (G, 1, m, 2)
    ranges = np.full(rays.shape, problem.baseline)
    for _ in range(2):
        points = _nearest_points(problem, sightings, rays, origins, ranges)
        ranges = np.linalg.norm(points[:, :, None, :] - origins, axis=-1)
        ranges = np.clip(ranges, 0.05 * problem.baseline, 3.0 * problem.model.landmark_sigma)
    options = np.concatenate([points[None], _far_points(problem, sightings, rays, origins)])
    costs = _costs(problem, sightings, rays, origins, options)  # (options, G, n)
    costs = np.where(np.isfinite(costs), costs, np.inf)
    best = costs.argmin(axis=0)
    chosen = np.take_along_axis(options, best[None, ..., None], axis=0)[0]
    return chosen, costs.min(axis=0).sum(axis=1)


def _candidate_poses(problem: Problem, sightings: Sightings) -> FloatArray:
    """(G, m, 3) poses to start from."""
    if problem.second_run is not None:
        return _poses_of_two_runs(problem, sightings)
    match problem.model.motion:
        case "odometry":
            return dead_reckoning(problem.odometry)[None]
        case "smooth":
            return _equal_steps(problem)
        case _:
            return _poses_on_line(problem, sightings)


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
    """(1, m, 3) poses on the x axis, all steps as long as the first."""
    poses = np.zeros((1, len(problem.scans), 3))
    poses[0, :, 0] = problem.baseline * np.arange(len(problem.scans))
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
        so_far = Sightings(
            sightings.bearings[:, :count], sightings.sigmas[:, :count], sightings.seen[:, :count]
        )
        costs = triangulate(problem, so_far, grid)[1] + STEP_GRID**2
        known = grid[costs.argmin()]


def _poses_of_two_runs(problem: Problem, sightings: Sightings) -> FloatArray:
    """(G, 4, 3) poses, one set for each two landmarks that align the second run with the first.

    Each run triangulates its landmarks in its own frame; two landmarks in both frames give the
    similarity z -> a + b z between them, and with it O3 = a and O4 = a + b.
    """
    own = np.zeros((1, 2, 3))
    own[0, 1, 0] = problem.baseline
    halves = [
        Sightings(sightings.bearings[:, part], sightings.sigmas[:, part], sightings.seen[:, part])
        for part in (slice(0, 2), slice(2, 4))
    ]
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


def _nearest_points(
    problem: Problem,
    sightings: Sightings,
    rays: FloatArray,
    origins: FloatArray,
    ranges: FloatArray,
) -> FloatArray:
    """(G, n, 2) minimisers of the weighted squared distances to the rays plus the prior."""
    weights = sightings.seen / (sightings.sigmas * ranges) ** 2
    nx, ny = -np.sin(rays), np.cos(rays)
    offset = nx * origins[..., 0] + ny * origins[..., 1]
    prior = problem.model.landmark_sigma**-2
    cx, cy = problem.model.landmark_centre
    axx = (weights * nx * nx).sum(-1) + prior
    axy = (weights * nx * ny).sum(-1)
    ayy = (weights * ny * ny).sum(-1) + prior
    bx = (weights * nx * offset).sum(-1) + prior * cx
    by = (weights * ny * offset).sum(-1) + prior * cy
    determinant = axx * ayy - axy * axy
    points = np.stack([ayy * bx - axy * by, axx * by - axy * bx], axis=-1)
    # Parallel rays under a prior too weak for the arithmetic meet nowhere; `triangulate` takes
    # points far out then.
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(points / determinant[..., None])


def _far_points(
    problem: Problem, sightings: Sightings, rays: FloatArray, origins: FloatArray
) -> FloatArray:
    """(len(FAR_RANGES), G, n, 2) points along each landmark's mean ray."""
    seen = sightings.seen
    mean = np.arctan2((seen * np.sin(rays)).sum(-1), (seen * np.cos(rays)).sum(-1))
    count = seen.sum(-1)[:, None]
    middle = (origins * seen[..., None]).sum(2) / count
    direction = np.stack([np.cos(mean), np.sin(mean)], axis=-1)
    reach = problem.baseline * FAR_RANGES
    return np.asarray(middle + reach[:, None, None, None] * direction)


def _costs(
    problem: Problem,
    sightings: Sightings,
    rays: FloatArray,
    origins: FloatArray,
    points: FloatArray,
) -> FloatArray:
    """(options, G, n) squared residuals of points (options, G, n, 2), in standard deviations."""
    offset = points[:, :, :, None, :] - origins
    residual = wrap_angle(np.arctan2(offset[..., 1], offset[..., 0]) - rays)
    bearing_cost = (sightings.seen * (residual / sightings.sigmas) ** 2).sum(-1)
    from_centre = (points - np.array(problem.model.landmark_centre)) / problem.model.landmark_sigma
    return np.asarray(bearing_cost + (from_centre**2).sum(-1), dtype=np.float64)


def _step_cost(problem: Problem, poses: FloatArray) -> FloatArray:
    """(G,) squared residuals of the log-step prior."""
    cost = np.zeros(len(poses))
    if problem.model.motion in ("smooth", "odometry"):
        return cost  # one candidate, nothing to compare
    for a, b in problem.free_steps:
        step = np.linalg.norm(poses[:, b, :2] - poses[:, a, :2], axis=-1)
        residual = (np.log(step) - problem.model.log_step_mean) / problem.model.log_step_sigma
        cost += residual**2
    return cost


def _local_minima(costs: FloatArray) -> list[int]:
    """Indices of entries no higher than both neighbours, the lowest first."""
    padded = np.concatenate([[np.inf], costs, [np.inf]])
    low = np.flatnonzero((costs <= padded[:-2]) & (costs <= padded[2:]))
    order = low[np.argsort(costs[low], kind="stable")]
    return [int(g) for g in order if costs[g] <= costs[order[0]] + START_MARGIN]
