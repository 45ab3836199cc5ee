"""The robot's turn between two scans, which moves all bearings alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.measurements import wrap_angle
from mht_slam.tracking.options import TrackerConfig
from mht_slam.tracking.tracks import Prediction

WIDEST = np.deg2rad(60.0)
"""Turns are looked for this far from the expected one."""
N_ROUNDS = 3


def common_shift(
    predictions: Sequence[Prediction],
    bearings: FloatArray,
    variances: FloatArray,
    expected: float,
    config: TrackerConfig,
) -> float:
    """Estimate the shift, in radians, of all bearings of a scan against the predicted ones.

    Every difference of a bearing and a prediction is tried as the shift. The one that explains most
    is refined as the mean of all differences, weighted by how surely each is a match, and by how
    far it is from the `expected` shift: a Cauchy law of scale `turn_sigma` about it, because robots
    mostly go straight and turn sharply now and then.
    """
    if not predictions or not len(bearings):
        return expected
    means = np.array([p.mean[0] for p in predictions])
    spread = np.array([p.covariance[0, 0] for p in predictions])[:, None] + variances
    chance = config.detection_probability * np.array([p.existence for p in predictions])
    apart = wrap_angle(bearings - means[:, None] - expected)
    density = chance[:, None] / (config.unassigned_rate * np.sqrt(2.0 * np.pi * spread))
    missed = (1.0 - chance)[:, None]
    # Shifts closer than the finest bearing are one shift.
    grain = np.sqrt(spread.min())
    near = apart[np.abs(apart) < WIDEST]
    tried = np.unique(np.append(np.round(near / grain), 0.0)) * grain
    odds = density * np.exp(-0.5 * wrap_angle(apart - tried[:, None, None]) ** 2 / spread)
    explained = np.log(missed[:, 0] + odds.sum(axis=2)).sum(axis=1)
    shift = float(tried[np.argmax(explained - np.log1p((tried / config.turn_sigma) ** 2))])
    for _ in range(N_ROUNDS):
        off = wrap_angle(apart - shift)
        odds = density * np.exp(-0.5 * off**2 / spread)
        weights = odds / (missed + odds.sum(axis=1, keepdims=True)) / spread
        pull = 2.0 / (config.turn_sigma**2 + shift**2)
        shift += float(((weights * off).sum() - shift * pull) / (weights.sum() + pull))
    return expected + shift
