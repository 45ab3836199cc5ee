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
LOG_RANGE_STEP = 0.09
"""Grid step in the logarithm of the range, divided by the root of the other sightings."""
MIN_PARALLAX = 8.0
"""Parallax, in its standard deviations, from which two bearings are good coordinates."""
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

    With enough parallax the two bearings that make it are the coordinates: both factors are then
    exactly Gaussian, and the Jacobian is d1 d2 / |sin(theta2 - theta1)| with the ranges d.
    With less, the coordinates are the bearing and the log range from the foremost pose, in which
    a landmark known by its direction only is a smooth function.
    """
    rays = poses[:, :, 2] + bearings
    first, second, parallax = _best_parallax(rays, sigmas)
    if parallax >= MIN_PARALLAX:
        points, log_weights = _bearing_grid(poses, rays, sigmas, (first, second))
        spanning = [first, second]
    else:
        anchor = _foremost(poses, rays)
        points, log_weights = _range_grid(poses, rays, sigmas, anchor, prior_centre, prior_sigma)
        spanning = [anchor]
    log_terms = log_weights + _log_prior(points, prior_centre, prior_sigma)
    for k in range(len(bearings)):
        if k not in spanning:
            log_terms = log_terms + _log_bearing(points, poses[:, k], rays[:, k], sigmas[k])
    return np.asarray(logsumexp(log_terms, axis=(1, 2)), dtype=np.float64)


def _best_parallax(rays: FloatArray, sigmas: FloatArray) -> tuple[int, int, float]:
    """Two sightings with the most parallax, and that in its standard deviations."""
    if len(sigmas) < 2:
        return 0, 0, 0.0
    i, j = np.triu_indices(len(sigmas), 1)
    difference = wrap_angle(rays[:, i] - rays[:, j])
    parallax = np.minimum(np.abs(difference), math.pi - np.abs(difference)).min(axis=0)
    parallax /= np.hypot(sigmas[i], sigmas[j])
    best = int(parallax.argmax())
    return int(i[best]), int(j[best]), float(parallax[best])


def _foremost(poses: FloatArray, rays: FloatArray) -> int:
    """The pose farthest along the mean ray, hence nearest to a landmark far out on it."""
    mean = np.arctan2(np.sin(rays).sum(), np.cos(rays).sum())
    along = poses[..., 0] * np.cos(mean) + poses[..., 1] * np.sin(mean)
    return int(along.mean(axis=0).argmax())


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
    anchor: int,
    prior_centre: tuple[float, float],
    prior_sigma: float,
) -> tuple[FloatArray, FloatArray]:
    """Points (Q, T, D, 2) by bearing and log range from one pose, and their log weights.

    The ranges run from where the parallax would be far too large up to six prior sigmas.
    """
    t, step = _standard_grid(len(sigmas))
    origins = poses[:, :, :2]
    lever = origins - origins[:, anchor : anchor + 1]
    ray = rays[:, anchor, None]
    across = np.abs(lever[..., 0] * np.sin(ray) - lever[..., 1] * np.cos(ray)).max(axis=1)
    along = np.abs(lever[..., 0] * np.cos(ray) + lever[..., 1] * np.sin(ray)).max(axis=1)
    error = 2.0 * REACH * sigmas.max()
    spread = np.abs(np.sin(rays - ray)).max() + error
    swing = float((across + along * error).min())  # how far off the ray the others may pass
    nearest = max(swing / float(spread) / 4.0, MIN_RANGE * prior_sigma)
    to_centre = np.linalg.norm(origins[:, anchor] - np.array(prior_centre), axis=-1).max()
    farthest = 6.0 * prior_sigma + float(to_centre)
    log_step = LOG_RANGE_STEP / math.sqrt(max(len(sigmas) - 1, 1))
    count = max(2, math.ceil(math.log(farthest / min(nearest, 0.5 * farthest)) / log_step))
    log_range = math.log(farthest) - log_step * np.arange(count)[::-1]
    alpha = ray[..., None] + sigmas[anchor] * t[:, None]
    distance = np.exp(log_range)
    x = poses[:, anchor, 0, None, None] + distance * np.cos(alpha)
    y = poses[:, anchor, 1, None, None] + distance * np.sin(alpha)
    normal = _log_standard_normal(t) + math.log(step)
    log_weights = normal[:, None] + 2.0 * log_range + math.log(log_step)
    return np.stack([x, y], axis=-1), np.broadcast_to(log_weights, x.shape)


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
    seen = np.arctan2(points[..., 1] - origin[..., 1], points[..., 0] - origin[..., 0])
    z = wrap_angle(seen - ray[:, None, None]) / sigma
    return np.asarray(-0.5 * z**2 - math.log(sigma * math.sqrt(2.0 * math.pi)))
