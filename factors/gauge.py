"""What fixes the frame, the scale, and directions that bearings leave free."""

from __future__ import annotations

import gtsam
import numpy as np

GAUGE_SIGMA = 1e-3
"""Standard deviation of a soft gauge along the line of motion.

A hard constraint would make GTSAM drop dimensions from log-determinants.
"""


def first_baseline(
    first: int, second: int, *, length: float = 1.0, line_sigma: float = 1e-4
) -> tuple[gtsam.PoseTranslationPrior2D, gtsam.PoseTranslationPrior2D]:
    """Hold the first pose at the origin and the second at (`length`, 0).

    Along the line the two are held to `GAUGE_SIGMA` baselines, which fixes origin and scale; away
    from it, which fixes the orientation, to `line_sigma` baselines.
    """
    noise = gtsam.noiseModel.Diagonal.Sigmas(length * np.array([GAUGE_SIGMA, line_sigma]))
    return (
        gtsam.PoseTranslationPrior2D(first, np.array([0.0, 0.0]), noise),
        gtsam.PoseTranslationPrior2D(second, np.array([length, 0.0]), noise),
    )


def position_prior(
    pose: int, centre: tuple[float, float], sigma: float
) -> gtsam.PoseTranslationPrior2D:
    """Isotropic Gaussian on the position of a pose; its heading stays free."""
    noise = gtsam.noiseModel.Isotropic.Sigma(2, sigma)
    return gtsam.PoseTranslationPrior2D(pose, np.array(centre), noise)


def landmark_prior(
    landmark: int, centre: tuple[float, float], sigma: float
) -> gtsam.PriorFactorPoint2:
    """Isotropic Gaussian on a landmark.

    Weak, but proper: without it the landmark of two nearly parallel bearings runs away, the
    optimiser reports success, and the evidence depends on where it stopped.
    """
    noise = gtsam.noiseModel.Isotropic.Sigma(2, sigma)
    return gtsam.PriorFactorPoint2(landmark, np.array(centre), noise)


def known_distance(
    first: int, second: int, distance: float, sigma: float, *, poses: bool = False
) -> gtsam.RangeFactor2 | gtsam.RangeFactorPose2:
    """Measured distance between two landmarks, or between two poses: a source of scale."""
    noise = gtsam.noiseModel.Isotropic.Sigma(1, sigma)
    factor = gtsam.RangeFactorPose2 if poses else gtsam.RangeFactor2
    return factor(first, second, distance, noise)
