"""What a pose sees of a landmark: a bearing, a range, or both."""

from __future__ import annotations

import gtsam


def bearing(pose: int, landmark: int, angle: float, sigma: float) -> gtsam.BearingFactor2D:
    """Landmark seen from a pose at `angle` (radians, counter-clockwise from forward).

    `sigma` is the standard deviation in radians. The residual is wrapped, so that angles on
    either side of pi are close.
    """
    noise = gtsam.noiseModel.Isotropic.Sigma(1, sigma)
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
