"""Evidence of a whole run under an association: what readings of it are compared by."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.evidence.bearing_noise import log_bearing_noise
from mht_slam.incremental.associate import shortest_range
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.place_integral import log_sightings
from mht_slam.incremental.sightings import Place, Sightings, sightings_of
from mht_slam.incremental.whole_run import WholeRun
from mht_slam.measurements import wrap_angle

UNSURE = 0.1
"""Deviation of the log range above which the place of a landmark is integrated numerically."""


def log_run_evidence(
    whole: WholeRun,
    bearings: Sequence[FloatArray],
    sigmas: Sequence[FloatArray],
    config: SlamConfig,
) -> float:
    """Log evidence of the owners of a smoothed run, poses at their best, places integrated out.

        - 1/2 |steps|^2 - mu
        + sum_alone ln w + sum_landmarks [ ln W(scans) + ln int p0(x) prod t(z; x) dx ]

    W, w and the expected number mu of first sightings and false alarms as in `Sightings`. The
    integral is Laplace's, in direction and log range from the first pose that sees the landmark,
    and numerical (`log_sightings`) where the range is badly known. Poses are not integrated out:
    two readings of one run have as many, and about as sure. So models with one motion and one noise
    of bearings are compared, too.

    Parameters
    ----------
    whole : the run smoothed.
    bearings, sigmas : of each scan.

    Source: docs/method.md, sections 4 and 5.
    """
    sightings = Sightings(whole, config)
    seen = sightings_of(whole.owners)
    points = dict(zip(whole.numbers.tolist(), whole.points, strict=True))
    mapped = {number: places for number, places in seen.items() if number in points}
    n_seen = np.zeros(len(bearings), np.int64)
    total = -whole.motion_error - sightings.expected(len(bearings))
    for number, places in mapped.items():
        scans = [scan for scan, _ in places]
        n_seen[scans] += 1
        total += sightings.log_weight(number, scans)
        total += _log_place(whole, points[number], places, bearings, sigmas, config)
    for scan, z in enumerate(bearings):
        total += (len(z) - n_seen[scan]) * sightings.alone(scan)
    return float(total)


def _log_place(
    whole: WholeRun,
    point: FloatArray,
    places: Sequence[Place],
    bearings: Sequence[FloatArray],
    sigmas: Sequence[FloatArray],
    config: SlamConfig,
) -> float:
    """Log density of one landmark's bearings, its place integrated out."""
    model = config.observation_model
    poses = whole.poses[[scan for scan, _ in places]]
    z = np.array([bearings[scan][detection] for scan, detection in places])
    sigma = np.array([sigmas[scan][detection] for scan, detection in places])
    away = point - poses[:, :2]
    squared = np.maximum((away**2).sum(axis=1), 1e-12)
    arm = away[0]
    along = (away @ arm) / squared  # d bearing / d direction
    across = (away[:, 0] * arm[1] - away[:, 1] * arm[0]) / squared  # d bearing / d log range
    off = wrap_angle(np.arctan2(away[:, 1], away[:, 0]) - poses[:, 2] - z) / sigma
    dof = model.bearing_dof
    weight = np.ones(len(z)) if dof is None else (dof + 1.0) / (dof + off**2)
    jacobian = np.column_stack([along, across]) / sigma[:, None]
    information = (weight[:, None] * jacobian).T @ jacobian
    determinant = float(np.linalg.det(information))
    if not determinant > information[0, 0] / UNSURE**2:
        return log_sightings(
            poses, z, sigma, dof, model.landmark_sigma, shortest_range(model.motion)
        )
    reach = math.sqrt(squared[0]) / model.landmark_sigma
    log_prior = math.log(reach) - 0.5 * reach**2 - 0.5 * math.log(0.5 * math.pi)
    # The prior's ln(1 / 2 pi) and Laplace's ln(2 pi) cancel.
    return (
        log_prior
        - 0.5 * math.log(determinant)
        + float((log_bearing_noise(off**2, dof) - np.log(sigma)).sum())
    )
