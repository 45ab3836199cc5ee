"""The chance of being detected in just these scans, for landmarks that come into view and leave."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import erf

from mht_slam.arrays import BoolArray, FloatArray, finite_number
from mht_slam.measurements import wrap_angle
from mht_slam.models import ObservationModel


def log_visibility(
    seen: BoolArray, detection_probability: FloatArray | float, stay_probability: float
) -> FloatArray:
    """Log chance of each landmark's pattern of detections, summed over when it came and left.

    A landmark is in view of a stretch of scans. It stays from one scan to the next with
    `stay_probability` s, and as many come as leave: per landmark in view at any time, a share 1 in
    the first scan and 1 - s in every later one begins its stretch there. In view it is detected
    with `detection_probability`. With v_k the measure of stretches that reach scan k and fit the
    pattern so far, e_k the chance of what scan k did (p detected, 1 - p missed) and g_k that of
    stretches that ended,

        v_k = e_k (s v_{k-1} + b_k),   g_k = g_{k-1} + (1 - s) v_{k-1},

    where b_k = 1 - s before the first detection and 0 after it, b_0 = 1; only stretches that end
    after the last detection count. With s = 1 this is the product of all e_k.

    Parameters
    ----------
    seen : (n, m) which scan detects which landmark, at least one each.
    detection_probability : a number, or (n, m): zero where a landmark is outside the field of view.

    Returns
    -------
    (n,) log of v_{m-1} + g_{m-1}; -inf where the pattern cannot be.

    Source: docs/method.md, section 4.
    """
    n, m = seen.shape
    chance = np.broadcast_to(np.asarray(detection_probability, dtype=np.float64), (n, m))
    outcome = np.where(seen, chance, 1.0 - chance)
    leave = 1.0 - stay_probability
    begun, ended = np.zeros(n), np.zeros(n)
    log_scale = np.zeros(n)
    unseen_yet = np.ones(n, dtype=np.bool_)
    for k in range(m):
        ended = np.where(seen[:, k], 0.0, np.where(unseen_yet, 0.0, ended + leave * begun))
        births = np.where(unseen_yet, 1.0 if k == 0 else leave, 0.0)
        begun = outcome[:, k] * (stay_probability * begun + births)
        unseen_yet = unseen_yet & ~seen[:, k]
        total = np.where(unseen_yet, 1.0, begun + ended)
        shrink = np.where(total > 0.0, total, 1.0)
        begun, ended = begun / shrink, ended / shrink
        log_scale = log_scale + np.log(shrink)
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(begun + ended) + log_scale)


def detection_chances(
    model: ObservationModel, seen: BoolArray, bearings: FloatArray
) -> FloatArray | float:
    """Detection probability of each landmark in each scan: none outside the field of view.

    `bearings` (n, m) are those under which the scans would see the landmarks. A landmark that was
    `seen` was inside, wherever its estimate says it lies. Raises `OptionError` for a model without
    a detection probability.
    """
    chance = finite_number(model.detection_probability, "detection_probability")
    if model.field_of_view >= 2.0 * math.pi:
        return chance
    inside = np.abs(bearings) <= 0.5 * model.field_of_view
    return np.where(seen | inside, chance, 0.0)


def sightlines(poses: FloatArray, points: FloatArray) -> FloatArray:
    """(n, m) bearings under which (m, 3) poses see (n, 2) points."""
    offset = points[:, None, :] - poses[None, :, :2]
    return wrap_angle(np.arctan2(offset[..., 1], offset[..., 0]) - poses[:, 2])


def expected_detected(model: ObservationModel, n_scans: int) -> float:
    """Expected number of landmarks that some scan detects, without a limited field of view.

    The first detection in scan k: in view, detected, and not before; by the symmetry of stretches
    in time that is the chance of one detection followed by k misses.
    """
    if not model.compares_sizes:
        return 0.0
    assert model.detection_probability is not None  # noqa: S101 - narrows the type
    assert model.expected_landmarks is not None  # noqa: S101 - narrows the type
    leave, p = 1.0 - model.stay_probability, model.detection_probability
    never_again, total = 1.0, 0.0
    for _ in range(n_scans):
        total += p * never_again
        never_again = leave + model.stay_probability * (1.0 - p) * never_again
    return model.expected_landmarks * total


def log_bearing_density(
    model: ObservationModel, poses: FloatArray, bearings: FloatArray
) -> FloatArray:
    """Log density of the bearing under which a pose sees a landmark of the prior, noise left out.

    With the prior's centre a along the ray and b beside it, s the prior's sigma,

        Int_0^inf t N(t u; c, s^2 I) dt
            = exp(-b^2 / 2 s^2) / (2 pi s^2)
              (s^2 exp(-a^2 / 2 s^2) + a s sqrt(pi / 2) (1 + erf(a / (s sqrt 2)))).

    `poses` (..., 3) and `bearings` (...) broadcast.
    """
    s = model.landmark_sigma
    angle = poses[..., 2] + bearings
    dx, dy = model.landmark_centre[0] - poses[..., 0], model.landmark_centre[1] - poses[..., 1]
    along = (dx * np.cos(angle) + dy * np.sin(angle)) / s
    beside = (-dx * np.sin(angle) + dy * np.cos(angle)) / s
    near = np.exp(-0.5 * along**2)
    far = along * math.sqrt(0.5 * math.pi) * (1.0 + erf(along / math.sqrt(2.0)))
    with np.errstate(divide="ignore"):
        density = np.log(near + far) - 0.5 * beside**2 - math.log(2.0 * math.pi)
    return np.asarray(density)
