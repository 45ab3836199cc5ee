"""Where poses and landmarks stand to each other: ranges, and what bearings are off by."""

from __future__ import annotations

import math

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray
from mht_slam.compiled import compiled


@compiled
def ranges_and_residuals(
    poses: FloatArray, landmarks: FloatArray, bearings: FloatArray, seen: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Distances of landmarks from poses, and predicted minus measured bearings.

    Parameters
    ----------
    poses : (m, 3); landmarks : (n, 2).
    bearings, seen : (n, m).

    Returns
    -------
    ranges : (n, m), infinite where not seen.
    residuals : (n, m), wrapped, radians; 0 where not seen.
    """
    ranges, residuals = np.full(bearings.shape, math.inf), np.zeros(bearings.shape)
    for row in range(len(landmarks)):
        for k in range(len(poses)):
            if seen[row, k]:
                dx, dy = landmarks[row, 0] - poses[k, 0], landmarks[row, 1] - poses[k, 1]
                ranges[row, k] = math.sqrt(dx * dx + dy * dy)
                error = math.atan2(dy, dx) - poses[k, 2] - bearings[row, k]
                residuals[row, k] = error - 2.0 * math.pi * np.rint(error / (2.0 * math.pi))
    return ranges, residuals
