"""Landmarks from known poses, one by one: where their rays come closest."""

from __future__ import annotations

import math

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray
from mht_slam.compiled import compiled
from mht_slam.graph.problem import Problem, Sightings

FAR_RANGES = np.array([2.0, 8.0, 30.0])
"""Ranges tried, in baselines, for rays that do not meet in front of the robot."""
NEAREST_RANGE = 0.05
"""Ranges are not taken for less in weights, in baselines."""
FARTHEST_RANGE = 3.0
"""Nor for more, in standard deviations of the landmark prior."""


def triangulate(
    problem: Problem, sightings: Sightings, poses: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Triangulate every landmark from every one of G sets of poses.

    Parameters
    ----------
    problem : gives the landmark prior.
    sightings : (n, m) bearings.
    poses : (G, k, 3) of the first k <= m scans, which alone are used.

    Returns
    -------
    landmarks : (G, n, 2). Weighted least squares over the distances to the rays, reweighted once
        with the ranges found; where rays diverge, the best of a few points far out instead.
    costs : (G,) sum of squared bearing and landmark prior residuals, in standard deviations. A
        bearing's residual is the chord of its error on the unit circle.
    """
    model = problem.model
    return _triangulated(
        sightings.bearings,
        sightings.sigmas,
        sightings.seen,
        poses,
        (*model.landmark_centre, model.landmark_sigma),
        (
            problem.baseline,
            NEAREST_RANGE * problem.baseline,
            FARTHEST_RANGE * model.landmark_sigma,
        ),
        problem.baseline * FAR_RANGES,
    )


@compiled
def _triangulated(
    bearings: FloatArray,
    sigmas: FloatArray,
    seen: BoolArray,
    poses: FloatArray,
    prior: tuple[float, float, float],
    ranges: tuple[float, float, float],
    far_ranges: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """`prior` is its centre and sigma; `ranges` the first one taken, the least and the largest."""
    n_sets, k = poses.shape[:2]
    n = len(bearings)
    cosine, sine = np.cos(bearings), np.sin(bearings)
    landmarks, costs = np.empty((n_sets, n, 2)), np.zeros(n_sets)
    rays, weights = np.empty((k, 2)), np.empty(k)
    forward = np.empty((k, 2))
    for g in range(n_sets):
        for i in range(k):
            forward[i, 0], forward[i, 1] = math.cos(poses[g, i, 2]), math.sin(poses[g, i, 2])
        for row in range(n):
            mean_x = mean_y = middle_x = middle_y = 0.0
            count = 0
            for i in range(k):
                c, s = forward[i, 0], forward[i, 1]
                rays[i, 0] = c * cosine[row, i] - s * sine[row, i]
                rays[i, 1] = s * cosine[row, i] + c * sine[row, i]
                weights[i] = 0.0
                if seen[row, i]:
                    weights[i] = 1.0 / sigmas[row, i] ** 2
                    mean_x, mean_y = mean_x + rays[i, 0], mean_y + rays[i, 1]
                    middle_x, middle_y = middle_x + poses[g, i, 0], middle_y + poses[g, i, 1]
                    count += 1
            x, y = _closest_point(poses[g], rays, weights, prior, ranges)
            least = _cost(x, y, poses[g], rays, weights, prior, math.inf)
            length = math.hypot(mean_x, mean_y)
            if length > 0.0:
                for far in far_ranges:
                    far_x = middle_x / count + far * mean_x / length
                    far_y = middle_y / count + far * mean_y / length
                    cost = _cost(far_x, far_y, poses[g], rays, weights, prior, least)
                    if cost < least:
                        x, y, least = far_x, far_y, cost
            landmarks[g, row, 0], landmarks[g, row, 1] = x, y
            costs[g] += least
    return landmarks, costs


@compiled
def _closest_point(
    poses: FloatArray,
    rays: FloatArray,
    weights: FloatArray,
    prior: tuple[float, float, float],
    ranges: tuple[float, float, float],
) -> tuple[float, float]:
    """Minimiser of the squared distances to the rays, over sigma times range, and of the prior."""
    information = 1.0 / prior[2] ** 2
    x = y = 0.0
    for attempt in range(2):
        axx = ayy = information
        axy, bx, by = 0.0, information * prior[0], information * prior[1]
        for i in range(len(rays)):
            if weights[i] == 0.0:
                continue
            squared = ranges[0] * ranges[0]
            if attempt > 0:
                squared = (x - poses[i, 0]) ** 2 + (y - poses[i, 1]) ** 2
                squared = min(max(squared, ranges[1] * ranges[1]), ranges[2] * ranges[2])
            w = weights[i] / squared
            nx, ny = -rays[i, 1], rays[i, 0]
            offset = nx * poses[i, 0] + ny * poses[i, 1]
            axx += w * nx * nx
            axy += w * nx * ny
            ayy += w * ny * ny
            bx += w * nx * offset
            by += w * ny * offset
        # Parallel rays under a prior too weak for the arithmetic meet nowhere; their cost is
        # infinite, and points far out are taken.
        determinant = axx * ayy - axy * axy
        x = (ayy * bx - axy * by) / determinant
        y = (axx * by - axy * bx) / determinant
    return x, y


@compiled
def _cost(
    x: float,
    y: float,
    poses: FloatArray,
    rays: FloatArray,
    weights: FloatArray,
    prior: tuple[float, float, float],
    limit: float,
) -> float:
    """Squared residuals of a point, in standard deviations; infinite where it is none.

    Beyond `limit`, which is all that interests, the sum is broken off.
    """
    total = ((x - prior[0]) ** 2 + (y - prior[1]) ** 2) / prior[2] ** 2
    for i in range(len(rays)):
        if weights[i] == 0.0:
            continue
        dx, dy = x - poses[i, 0], y - poses[i, 1]
        nearness = 1.0 / math.sqrt(dx * dx + dy * dy)
        beside = (rays[i, 0] * dy - rays[i, 1] * dx) * nearness
        short = 1.0 - (rays[i, 0] * dx + rays[i, 1] * dy) * nearness
        total += weights[i] * (beside * beside + short * short)
        if total > limit:
            break
    return total if total < math.inf else math.inf
