"""What a pose sees of a landmark: a bearing, a range, or both."""

from __future__ import annotations

import math

import gtsam


def bearing(
    pose: int, landmark: int, angle: float, sigma: float, dof: float | None = None
) -> gtsam.BearingFactor2D:
    """Landmark seen from a pose at `angle` (radians, counter-clockwise from forward).

    `sigma` is the standard deviation in radians. The residual is wrapped, so that angles on
    either side of pi are close.

    With `dof` the noise is Student's t of that many degrees of freedom and scale `sigma`. GTSAM's
    Cauchy loss k^2 / 2 ln(1 + e^2 / k^2) is exactly that, up to its normaliser, with
    k^2 = `dof` + 1 and e = r / (`sigma` sqrt(`dof` / (`dof` + 1))).
    """
    if dof is None:
        noise: gtsam.noiseModel.Base = gtsam.noiseModel.Isotropic.Sigma(1, sigma)
    else:
        inner = gtsam.noiseModel.Isotropic.Sigma(1, sigma * math.sqrt(dof / (dof + 1.0)))
        loss = gtsam.noiseModel.mEstimator.Cauchy.Create(math.sqrt(dof + 1.0))
        noise = gtsam.noiseModel.Robust.Create(loss, inner)
    return gtsam.BearingFactor2D(pose, landmark, gtsam.Rot2(angle), noise)


def landmark_range(pose: int, landmark: int, distance: float, sigma: float) -> gtsam.RangeFactor2D:
    """Landmark seen from a pose at `distance`, with standard deviation `sigma`."""
    noise = gtsam.noiseModel.Isotropic.Sigma(1, sigma)
    return gtsam.RangeFactor2D(pose, landmark, distance, noise)


def bearing_and_range(
    pose: int,
    landmark: int,
    angle: float,
    distance: float,
    bearing_sigma: float,
    range_sigma: float,
) -> gtsam.BearingRangeFactor2D:
    """Landmark seen from a pose at `angle` and `distance`."""
    noise = gtsam.noiseModel.Diagonal.Sigmas([bearing_sigma, range_sigma])
    return gtsam.BearingRangeFactor2D(pose, landmark, gtsam.Rot2(angle), distance, noise)


def log_range_volume(pose: int, landmark: int, around: float) -> gtsam.RangeFactor2D:
    """Area per bearing and log range, d^2, linearised at the range d = `around`.

    A density over a landmark's position becomes one over its bearing and log range when
    multiplied by d^2. In those coordinates a pose is infinitely far away, so an optimum never
    lies on it. As a factor, -2 ln d has at d0 the gradient and curvature of a Gaussian on d with
    mean 2 d0 and standard deviation d0 / sqrt(2). It measures nothing: leave it out of densities.
    """
    return landmark_range(pose, landmark, 2.0 * around, around / math.sqrt(2.0))
