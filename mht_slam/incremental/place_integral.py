"""The place of one landmark integrated out, given the poses from which it was seen."""

from __future__ import annotations

import math

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.evidence.bearing_noise import log_bearing_noise
from mht_slam.measurements import wrap_angle

RANGES = 1000
"""Log-spaced ranges over which the place is integrated."""
ROUNDS = 4
"""Newton steps to the best direction at each of them."""


def log_sightings(
    poses: FloatArray,
    bearings: FloatArray,
    sigmas: FloatArray,
    dof: float | None,
    landmark_sigma: float,
    nearest: float,
) -> float:
    """Log density of the bearings of one landmark from known poses, its place integrated out.

        int p0(phi, rho) prod_i t(z_i; h(phi, rho), sigma_i) dphi drho

    with the half-normal prior of `smooth_window` about the first pose. The direction is integrated
    by Laplace's method at each of a row of log ranges, which are summed.

    Parameters
    ----------
    poses, bearings, sigmas : (k, 3), (k,), (k,).
    nearest : the shortest range; `landmark_sigma` where that is shorter.
    """
    shortest = min(nearest, landmark_sigma)
    rho = np.linspace(math.log(shortest), math.log(4.0 * landmark_sigma), RANGES)
    reach = np.exp(rho)
    phi = np.full(RANGES, poses[0, 2] + bearings[0])
    heavy = math.inf if dof is None else dof
    for _ in range(ROUNDS + 1):
        off, slope = _offsets(phi, reach, poses, bearings)
        ratio = off / sigmas
        weight = 1.0 if dof is None else (heavy + 1.0) / (heavy + ratio**2)
        information = (weight * (slope / sigmas) ** 2).sum(axis=1)
        phi = phi - (weight * ratio * slope / sigmas).sum(axis=1) / np.maximum(information, 1e-12)
    off, _ = _offsets(phi, reach, poses, bearings)
    log_density = (log_bearing_noise((off / sigmas) ** 2, dof) - np.log(sigmas)).sum(axis=1)
    spread = 0.5 * np.log(2.0 * math.pi / np.maximum(information, 1.0 / (2.0 * math.pi)))
    scaled = reach / landmark_sigma
    log_prior = np.log(scaled) - 0.5 * scaled**2 - math.log(2.0 * math.pi)
    log_prior -= 0.5 * math.log(0.5 * math.pi)
    return float(np.logaddexp.reduce(log_prior + log_density + spread) + math.log(rho[1] - rho[0]))


def _offsets(
    phi: FloatArray, reach: FloatArray, poses: FloatArray, bearings: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(q, k) bearings to places minus those seen, and their derivatives by direction."""
    arm = reach[:, None] * np.stack([np.cos(phi), np.sin(phi)])[..., None]  # (2, q, 1)
    x = arm[0] + poses[0, 0] - poses[:, 0]
    y = arm[1] + poses[0, 1] - poses[:, 1]
    off = wrap_angle(np.arctan2(y, x) - poses[:, 2] - bearings)
    slope = (x * arm[0] + y * arm[1]) / np.maximum(x**2 + y**2, 1e-12)
    return off, slope
