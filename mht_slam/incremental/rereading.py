"""Every scan of a run read again, given the smoothed map and where each landmark is seen else."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.sightings import Sightings, log_as_seen, sightings_of
from mht_slam.incremental.strays import SURE
from mht_slam.incremental.whole_run import WholeRun

NEAR = 10.0
"""Nats by which one more sighting may make up for its bearing, at most: a miss less, or two."""
NEVER = -1e9
"""Log odds of what cannot be, finite for the assignment."""


def scans_reread(
    whole: WholeRun,
    bearings: Sequence[FloatArray],
    sigmas: Sequence[FloatArray],
    config: SlamConfig,
) -> list[IntArray] | None:
    """Return the owners with every scan assigned anew, None where nothing changes.

    Given the smoothed pose and landmarks, and the scans that see each landmark besides this one,
    the detections of a scan are independent of all others: the best assignment maximises the sum of

        ln t(z; x, sqrt(2) sigma) + log odds of one more sighting

    over detections that are given to a landmark, and of the weight of a detection on its own over
    the others. Exchanges with a neighbour, sightings that were missed and false alarms that were
    taken for landmarks are mended where the map, which all scans make together, knows better.
    Landmarks of fewer than `SURE` detections take no part (see `strays_reread`), nor do their
    detections. Scans are read side by side, not one after the other: what the changes do together
    is for the evidence of the run to judge (`mht_slam.incremental.hindsight`).

    Parameters
    ----------
    whole : the run smoothed.
    bearings, sigmas : of each scan.

    Source: docs/method.md, section 5, and docs/incremental.md.
    """
    seen = sightings_of(whole.owners)
    scans = {number: [scan for scan, _ in seen[number]] for number in whole.numbers.tolist()}
    sure = np.array([len(scans[number]) >= SURE for number in whole.numbers.tolist()], np.bool_)
    numbers, points = whole.numbers[sure], whole.points[sure]
    sightings = Sightings(whole, config)
    dof = config.observation_model.bearing_dof
    found = []
    changed = False
    for k, owner in enumerate(whole.owners):
        free = np.flatnonzero((owner == MISSED) | np.isin(owner, numbers))
        new = owner.copy()
        if len(free) and len(numbers):
            z, sigma = bearings[k][free], sigmas[k][free]
            gains = log_as_seen(whole.poses[k], points, z, sigma, dof) - sightings.alone(k)
            near = np.flatnonzero((gains > -NEAR).any(axis=0))
            odds = []
            for number in numbers[near].tolist():
                others = [scan for scan in scans[number] if scan != k]
                odds.append(sightings.log_odds(number, others, k))
            gains = np.maximum(gains[:, near] + odds, NEVER)
            new[free] = _assigned(gains, numbers[near])
        changed |= not np.array_equal(new, owner)
        found.append(new)
    return found if changed else None


def _assigned(gains: FloatArray, numbers: IntArray) -> IntArray:
    """(d,) the landmark of each detection, -1 for none, that gain most together."""
    alone = np.zeros((len(gains), len(gains)))
    rows, columns = linear_sum_assignment(np.hstack([gains, alone]), maximize=True)
    return np.append(numbers, np.full(len(gains), MISSED))[columns[np.argsort(rows)]]
