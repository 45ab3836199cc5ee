"""What a pattern of detections weighs: landmarks seen and missed, and detections left single."""

from __future__ import annotations

import math

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.evidence.visibility import (
    detection_chances,
    log_bearing_density,
    log_visibility,
    sightlines,
)
from mht_slam.tree.setting import Setting


def log_pattern(
    setting: Setting,
    poses: FloatArray,
    table: IntArray,
    singles: IntArray,
    bearings: FloatArray,
) -> float:
    """Log weight of what was detected, missed, and left single."""
    model = setting.problem.model
    seen = np.asarray(table != MISSED)
    chance = detection_chances(model, seen, bearings)
    total = float(log_visibility(seen, chance, model.stay_probability).sum())
    total += len(table) * setting.log_landmarks
    return total + float(single_weights(setting, poses, singles).sum())


def single_weights(setting: Setting, poses: FloatArray, singles: IntArray) -> FloatArray:
    """(s,) log weights of detections on their own: a landmark seen once, or a false alarm."""
    return np.logaddexp(seen_once_weights(setting, poses, singles), setting.log_false_alarm)


def seen_once_weights(setting: Setting, poses: FloatArray, singles: IntArray) -> FloatArray:
    """(s,) log weights of landmarks that only these detections see."""
    model = setting.problem.model
    scans = singles[:, 0]
    if model.field_of_view >= 2.0 * math.pi:
        pattern = setting.lonely(len(poses))[scans]
    else:
        seen = scans[:, None] == np.arange(len(poses))
        chances = chances_along_rays(setting, poses, singles, seen)
        pattern = log_visibility(seen, chances, model.stay_probability)
    density = log_bearing_density(model, poses[scans], single_bearings(setting, singles))
    return np.asarray(setting.log_landmarks + pattern + density)


def single_bearings(setting: Setting, singles: IntArray) -> FloatArray:
    """(s,) bearings of detections given by scan and number."""
    return np.array([setting.problem.scans[k].bearings[d] for k, d in singles.tolist()])


def chances_along_rays(
    setting: Setting, poses: FloatArray, singles: IntArray, seen: BoolArray
) -> FloatArray | float:
    """Detection probabilities of landmarks at one prior sigma on the rays of detections.

    That is where `refine` puts a landmark seen once; the field of view there stands for the ray's.
    """
    model = setting.problem.model
    own = poses[singles[:, 0]]
    angle = own[:, 2] + single_bearings(setting, singles)
    places = own[:, :2] + model.landmark_sigma * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return detection_chances(model, seen, sightlines(poses, places))
