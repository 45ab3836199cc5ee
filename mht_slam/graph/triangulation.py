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
    """`prior` is its centre and sigma; `ranges` the first one taken, the least and the largest.

    The innermost loops run over the sets of poses, so that several are worked on at a time.
    """
    n_sets, k = poses.shape[:2]
    n = len(bearings)
    landmarks, costs = np.empty((n_sets, n, 2)), np.zeros(n_sets)
    places = np.ascontiguousarray(poses[:, :, :2].transpose(1, 2, 0))
    forward, rays = np.empty((k, 2, n_sets)), np.empty((k, 2, n_sets))
    for i in range(k):
        forward[i, 0], forward[i, 1] = np.cos(poses[:, i, 2]), np.sin(poses[:, i, 2])
    points, far_points = np.empty((2, n_sets)), np.empty((2, n_sets))
    least, far_costs = np.empty(n_sets), np.empty(n_sets)
    for row in range(n):
        weights = np.zeros(k)
        middle, mean = np.zeros((2, n_sets)), np.zeros((2, n_sets))
        count = 0
        for i in range(k):
            if not seen[row, i]:
                continue
            weights[i] = 1.0 / sigmas[row, i] ** 2
            cosine, sine = math.cos(bearings[row, i]), math.sin(bearings[row, i])
            count += 1
            for g in range(n_sets):
                rays[i, 0, g] = forward[i, 0, g] * cosine - forward[i, 1, g] * sine
                rays[i, 1, g] = forward[i, 1, g] * cosine + forward[i, 0, g] * sine
                mean[0, g] += rays[i, 0, g]
                mean[1, g] += rays[i, 1, g]
                middle[0, g] += places[i, 0, g]
                middle[1, g] += places[i, 1, g]
        _closest_points(points, places, rays, weights, prior, ranges)
        _costs(least, points, places, rays, weights, prior)
        for far in far_ranges:
            for g in range(n_sets):
                # Rays without a mean direction give points that are no numbers, at infinite cost.
                length = math.sqrt(mean[0, g] ** 2 + mean[1, g] ** 2)
                far_points[0, g] = middle[0, g] / count + far * mean[0, g] / length
                far_points[1, g] = middle[1, g] / count + far * mean[1, g] / length
            _costs(far_costs, far_points, places, rays, weights, prior)
            for g in range(n_sets):
                if far_costs[g] < least[g]:
                    points[0, g], points[1, g] = far_points[0, g], far_points[1, g]
                    least[g] = far_costs[g]
        for g in range(n_sets):
            landmarks[g, row, 0], landmarks[g, row, 1] = points[0, g], points[1, g]
            costs[g] += least[g]
    return landmarks, costs


@compiled
def _closest_points(
    points: FloatArray,
    places: FloatArray,
    rays: FloatArray,
    weights: FloatArray,
    prior: tuple[float, float, float],
    ranges: tuple[float, float, float],
) -> None:
    """Minimisers of the squared distances to the rays, over sigma times range, and of the prior."""
    information = 1.0 / prior[2] ** 2
    n_sets = points.shape[1]
    squared = np.full(n_sets, ranges[0] * ranges[0])
    for attempt in range(2):
        axx, ayy = np.full(n_sets, information), np.full(n_sets, information)
        axy = np.zeros(n_sets)
        bx, by = np.full(n_sets, information * prior[0]), np.full(n_sets, information * prior[1])
        for i in range(len(weights)):
            if weights[i] == 0.0:
                continue
            for g in range(n_sets):
                if attempt > 0:
                    dx, dy = points[0, g] - places[i, 0, g], points[1, g] - places[i, 1, g]
                    far = min(dx * dx + dy * dy, ranges[2] * ranges[2])
                    squared[g] = max(far, ranges[1] * ranges[1])
                w = weights[i] / squared[g]
                nx, ny = -rays[i, 1, g], rays[i, 0, g]
                offset = nx * places[i, 0, g] + ny * places[i, 1, g]
                axx[g] += w * nx * nx
                axy[g] += w * nx * ny
                ayy[g] += w * ny * ny
                bx[g] += w * nx * offset
                by[g] += w * ny * offset
        # Parallel rays under a prior too weak for the arithmetic meet nowhere; their cost is
        # infinite, and points far out are taken.
        for g in range(n_sets):
            determinant = axx[g] * ayy[g] - axy[g] * axy[g]
            points[0, g] = (ayy[g] * bx[g] - axy[g] * by[g]) / determinant
            points[1, g] = (axx[g] * by[g] - axy[g] * bx[g]) / determinant


@compiled
def _costs(
    costs: FloatArray,
    points: FloatArray,
    places: FloatArray,
    rays: FloatArray,
    weights: FloatArray,
    prior: tuple[float, float, float],
) -> None:
    """Squared residuals of points, in standard deviations; infinite where one is none."""
    n_sets = points.shape[1]
    for g in range(n_sets):
        from_centre = (points[0, g] - prior[0]) ** 2 + (points[1, g] - prior[1]) ** 2
        costs[g] = from_centre / prior[2] ** 2
    for i in range(len(weights)):
        if weights[i] == 0.0:
            continue
        for g in range(n_sets):
            dx, dy = points[0, g] - places[i, 0, g], points[1, g] - places[i, 1, g]
            nearness = 1.0 / math.sqrt(dx * dx + dy * dy)
            beside = (rays[i, 0, g] * dy - rays[i, 1, g] * dx) * nearness
            short = 1.0 - (rays[i, 0, g] * dx + rays[i, 1, g] * dy) * nearness
            costs[g] += weights[i] * (beside * beside + short * short)
    for g in range(n_sets):
        if not costs[g] < math.inf:
            costs[g] = math.inf
