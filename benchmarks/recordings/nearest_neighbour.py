"""Baseline: EKF-SLAM that gives each detection to the nearest landmark inside a gate."""

from __future__ import annotations

import ekf_slam
import numpy as np
from drive_scores import Answer
from scipy.optimize import linear_sum_assignment

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.datasets import Drive
from mht_slam.models import ObservationModel

OPTIONS = tuple(
    f"gate {gate}, parallax {parallax} deg"
    for gate in (2, 3, 4, 6)
    for parallax in ekf_slam.PARALLAXES_DEG
)
"""Standard deviations of the innovation, and parallax of a new landmark."""


def answer(drive: Drive, model: ObservationModel, option: str) -> Answer:
    """Take in each scan the assignment of the least Mahalanobis distances."""
    _, gate_word, _, parallax, _ = option.replace(",", "").split()
    gate = float(gate_word)

    def pair(innovations: FloatArray, joint: FloatArray) -> IntArray:
        squares = innovations**2 / (np.diag(joint) + 1.0)
        gain = np.maximum(gate**2 - squares, 0.0)
        paired = np.full(len(innovations), MISSED, dtype=np.int64)
        for j, landmark in zip(*linear_sum_assignment(gain, maximize=True), strict=True):
            if gain[j, landmark] > 0.0:
                paired[j] = landmark
        return paired

    return ekf_slam.run(drive, model, pair, np.deg2rad(float(parallax)))
