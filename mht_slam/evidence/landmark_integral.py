"""The two-dimensional integral of one landmark, given the poses that see it.

Given the poses X the landmarks of an association are independent, so its evidence is
Int p(X) prod_j E_j(X) dX with, for landmark j,

    E_j(X) = Int p0(x) prod_seen N(z_k; h_k(x, X), sigma_k) dx

(docs/method.md, section 4). This module computes E_j for many X at once.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import logsumexp

from mht_slam.arrays import FloatArray
from mht_slam.measurements import wrap_angle

REACH = 7.0
"""Half-width of the bearing grids, standard deviations."""
BEARING_STEP = 1.2
"""Grid step in a bearing, in standard deviations, divided by the root of the sightings.

A trapezoidal sum over a Gaussian of unit width is off by exp(-2 pi^2 / step^2): a millionth.
"""
LOG_RANGE_STEP = 1.1
"""Grid step in the log range, divided by the parallax in sigmas and the root of other sightings.

The parallax of a point changes by itself per unit of log range, and counts as `PARALLAX_MARGIN`
sigmas larger than seen, for the bearings' errors.
"""
PARALLAX_MARGIN = 4.0
MIN_PARALLAX = 8.0
"""Parallax, in its standard deviations, from which two bearings are good coordinates."""
SAME_WAY = 0.9
"""Cosine of the angle to their mean within which rays look the same way."""
SHARE_POWER = 4.0
"""Power of the inverse range in an anchor's share of a point."""
MIN_RANGE = 1e-4
"""Nearest landmark considered, as a share of the landmark prior's standard deviation."""


def log_landmark_integral(
    poses: FloatArray,
    bearings: FloatArray,
    sigmas: FloatArray,
    prior_centre: tuple[float, float],
    prior_sigma: float,
) -> FloatArray:
    """Integrate one landmark out, for Q sets of poses.

    Parameters
    ----------
    poses : (Q, K, 3) the K >= 1 poses that see the landmark.
    bearings, sigmas : (K,) radians, robot frame.
    prior_centre, prior_sigma : isotropic Gaussian prior, in the unit of the poses.

    Returns
    -------
    (Q,) log E_j; -inf where no point in front of the poses explains the bearings.

    With enough parallax two bearings are the coordinates: both factors are then exactly Gaussian,
    and the Jacobian is d1 d2 / |sin(theta2 - theta1)| with the ranges d. With less, the
    coordinates are the bearing and the log range from a pose, in which a landmark known by its
    direction only is a smooth function.
    """
    rays = poses[:, :, 2] + bearings
    pair = _best_pair(poses, rays, sigmas)
    if pair is not None:
        points, log_weights = _bearing_grid(poses, rays, sigmas, pair)
        grids: list[tuple[FloatArray, FloatArray, tuple[int, ...]]] = [(points, log_weights, pair)]
    else:
        anchors = _anchors(poses, rays)
        grids = [
            (
                *_range_grid(poses, rays, sigmas, anchors, anchor, prior_centre, prior_sigma),
                (anchor,),
            )
            for anchor in anchors
        ]
    parts = []
    for points, log_terms, spanning in grids:
        log_terms = log_terms + _log_prior(points, prior_centre, prior_sigma)
        for k in range(len(bearings)):
            if k not in spanning:
                log_terms = log_terms + _log_bearing(points, poses[:, k], rays[:, k], sigmas[k])
        parts.append(logsumexp(log_terms, axis=(1, 2)))
    return np.asarray(np.logaddexp.reduce(parts, axis=0), dtype=np.float64)


def _best_pair(poses: FloatArray, rays: FloatArray, sigmas: FloatArray) -> tuple[int, int] | None:
    """Two sightings that are good coordinates for all sets of poses, or None.

    Of those with parallax enough, the pair that fixes the point most tightly: a pose close to the
    landmark has to be in it, because seen from elsewhere its bearing turns faster than the grid.
    """
    i, j = np.triu_indices(len(sigmas), 1)
    sine = np.sin(rays[:, j] - rays[:, i])
    parallax = np.arcsin(np.abs(sine)) / np.hypot(sigmas[i], sigmas[j])
    enough = np.flatnonzero(parallax.min(axis=0, initial=math.inf) >= MIN_PARALLAX)
    if len(enough) == 0:
        return None
    i, j, sine = i[enough], j[enough], sine[:, enough]
    baseline = poses[:, j, :2] - poses[:, i, :2]
    bx, by = baseline[..., 0], baseline[..., 1]
    from_i = np.abs(bx * np.sin(rays[:, j]) - by * np.cos(rays[:, j])) / np.abs(sine)
    from_j = np.abs(bx * np.sin(rays[:, i]) - by * np.cos(rays[:, i])) / np.abs(sine)
    area = sigmas[i] * from_i * sigmas[j] * from_j / np.abs(sine)
    best = int(area.mean(axis=0).argmin())
    return int(i[best]), int(j[best])


def _anchors(poses: FloatArray, rays: FloatArray) -> list[int]:
    """Poses about which polar grids are laid.

    Where all look the same way, the one farthest ahead, hence nearest to the landmark; else the
    landmark may be close to any of them.
    """
    mean = np.arctan2(np.sin(rays).sum(), np.cos(rays).sum())
    if float(np.cos(rays - mean).min()) < SAME_WAY:
        return list(range(rays.shape[1]))
    along = poses[..., 0] * np.cos(mean) + poses[..., 1] * np.sin(mean)
    return [int(along.mean(axis=0).argmax())]


def _bearing_grid(
    poses: FloatArray, rays: FloatArray, sigmas: FloatArray, pair: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """Points (Q, T, T, 2) where the rays of two sightings meet, and their log weights."""
    t, step = _standard_grid(len(sigmas))
    a, b = pair
    alpha = rays[:, a, None, None] + sigmas[a] * t[:, None]
    gamma = rays[:, b, None, None] + sigmas[b] * t[None, :]
    baseline = poses[:, b, :2] - poses[:, a, :2]
    bx, by = baseline[:, 0, None, None], baseline[:, 1, None, None]
    sine = np.sin(gamma - alpha)
    with np.errstate(divide="ignore", invalid="ignore"):
        from_a = (bx * np.sin(gamma) - by * np.cos(gamma)) / sine
        from_b = (bx * np.sin(alpha) - by * np.cos(alpha)) / sine
        log_jacobian = np.log(from_a) + np.log(from_b) - np.log(np.abs(sine))
    meets = (from_a > 0.0) & (from_b > 0.0) & np.isfinite(log_jacobian)
    from_a = np.where(meets, from_a, 1.0)
    x = poses[:, a, 0, None, None] + from_a * np.cos(alpha)
    y = poses[:, a, 1, None, None] + from_a * np.sin(alpha)
    normal = _log_standard_normal(t) + math.log(step)
    log_weights = np.where(meets, log_jacobian, -np.inf) + normal[:, None] + normal[None, :]
    return np.stack([x, y], axis=-1), log_weights


def _range_grid(
    poses: FloatArray,
    rays: FloatArray,
    sigmas: FloatArray,
    anchors: list[int],
    anchor: int,
    prior_centre: tuple[float, float],
    prior_sigma: float,
) -> tuple[FloatArray, FloatArray]:
    """Points (Q, T, D, 2) by bearing and log range from one pose, and their log weights.

    Each of several anchors takes a smooth share of every point, large where it is the nearest.
    """
    t, step = _standard_grid(len(sigmas))
    to_centre = np.linalg.norm(poses[:, anchor, :2] - np.array(prior_centre), axis=-1).max()
    farthest = 6.0 * prior_sigma + float(to_centre)
    nearest = MIN_RANGE * prior_sigma
    if len(anchors) == 1:
        nearest = min(max(nearest, _nearest_seen(poses, rays, sigmas, anchor)), 0.5 * farthest)
    log_step = _log_range_step(rays, sigmas)
    count = math.ceil(math.log(farthest / nearest) / log_step)
    log_range = math.log(farthest) - log_step * np.arange(count)[::-1]
    alpha = rays[:, anchor, None, None] + sigmas[anchor] * t[:, None]
    distance = np.exp(log_range)
    x = poses[:, anchor, 0, None, None] + distance * np.cos(alpha)
    y = poses[:, anchor, 1, None, None] + distance * np.sin(alpha)
    normal = _log_standard_normal(t) + math.log(step)
    log_weights = np.broadcast_to(normal[:, None] + 2.0 * log_range + math.log(log_step), x.shape)
    if len(anchors) > 1:
        others = [
            np.hypot(x - poses[:, k, 0, None, None], y - poses[:, k, 1, None, None])
            for k in anchors
        ]
        shares = -SHARE_POWER * np.log(np.maximum(others, 1e-300))
        own = -SHARE_POWER * log_range
        log_weights = log_weights + own - np.logaddexp.reduce(shares, axis=0)
    return np.stack([x, y], axis=-1), log_weights


def _log_range_step(rays: FloatArray, sigmas: FloatArray) -> float:
    """Grid step that resolves the likelihood along a ray."""
    if len(sigmas) == 1:
        return LOG_RANGE_STEP / PARALLAX_MARGIN
    i, j = np.triu_indices(len(sigmas), 1)
    apart = np.abs(np.sin(rays[:, i] - rays[:, j])) / np.hypot(sigmas[i], sigmas[j])
    parallax = min(float(apart.max()), MIN_PARALLAX) + PARALLAX_MARGIN
    return LOG_RANGE_STEP / (parallax * math.sqrt(len(sigmas) - 1))


def _nearest_seen(poses: FloatArray, rays: FloatArray, sigmas: FloatArray, anchor: int) -> float:
    """Range from the anchor below which the parallax would be far larger than the one seen.

    A pose `behind` the anchor and `across` its ray sees a point at range d with a parallax of
    about across / (behind + d).
    """
    lever = poses[:, anchor, None, :2] - poses[:, :, :2]
    ray = rays[:, anchor, None]
    behind = np.abs(lever[..., 0] * np.cos(ray) + lever[..., 1] * np.sin(ray))
    across = np.abs(lever[..., 0] * np.sin(ray) - lever[..., 1] * np.cos(ray))
    error = 2.0 * REACH * float(sigmas.max())
    seen = np.abs(np.sin(rays - ray)) + error
    nearest = (across - behind * error) / seen - behind
    return 0.5 * float(nearest.max(axis=1).min())


def _standard_grid(n_sightings: int) -> tuple[FloatArray, float]:
    """Symmetric grid of standard normal abscissae, and its step."""
    count = math.ceil(REACH * math.sqrt(n_sightings) / BEARING_STEP)
    grid = np.linspace(-REACH, REACH, 2 * count + 1)
    return grid, float(grid[1] - grid[0])


def _log_standard_normal(t: FloatArray) -> FloatArray:
    return np.asarray(-0.5 * t**2 - 0.5 * math.log(2.0 * math.pi))


def _log_prior(points: FloatArray, centre: tuple[float, float], sigma: float) -> FloatArray:
    square = (points[..., 0] - centre[0]) ** 2 + (points[..., 1] - centre[1]) ** 2
    return np.asarray(-0.5 * square / sigma**2 - math.log(2.0 * math.pi * sigma**2))


def _log_bearing(points: FloatArray, pose: FloatArray, ray: FloatArray, sigma: float) -> FloatArray:
    """Log N(z; h(x), sigma) of points (Q, T, U, 2) seen from poses (Q, 3) along rays (Q,)."""
    origin = pose[:, None, None, :]
    residual = np.arctan2(points[..., 1] - origin[..., 1], points[..., 0] - origin[..., 0])
    residual -= wrap_angle(ray)[:, None, None]
    turns = np.rint(residual * (0.5 / math.pi))  # cheaper than wrap_angle on so many points
    residual -= (2.0 * math.pi) * turns
    residual *= residual
    residual *= -0.5 / sigma**2
    residual -= math.log(sigma * math.sqrt(2.0 * math.pi))
    return residual
