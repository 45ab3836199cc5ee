"""Strays: landmarks seen a few times only, read again as others once the whole run is smoothed."""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Sequence

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.incremental.associate import shortest_range
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.place_integral import log_sightings
from mht_slam.incremental.sightings import Place, Sightings, log_as_seen, sightings_of
from mht_slam.incremental.whole_run import WholeRun

MOST = 16
"""Detections of a stray, at most."""
MORE = 2
"""A landmark has to be seen this many times as often as the stray that it explains."""
SURE = 5
"""Detections from which a landmark explains others."""


def strays_reread(
    whole: WholeRun,
    bearings: Sequence[FloatArray],
    sigmas: Sequence[FloatArray],
    config: SlamConfig,
) -> list[IntArray] | None:
    """Return the owners with strays read as sightings of other landmarks, None where none is.

    At its start a run knows no landmarks, and mistakes there are settled before the map tells them.
    Given smoothed poses, a stray of detections z_1, z_2, ... is a landmark of its own with weight

        W(scans) int p0(x) prod t(z_i; x) dx,

    W as in `Sightings`. Or each detection stands alone, or belongs to a landmark of many
    detections that this scan does not see. These are chosen one after the other, each as the best
    there is given those before; and once more for every other landmark, which then has the first
    detection that it can have, for the first sighting after long costs more than those that
    follow. A stray is given up for the best of these readings where it gains anything.

    Parameters
    ----------
    whole : the run smoothed.
    bearings, sigmas : of each scan, as `smooth_whole_run` takes them.

    Source: docs/method.md, section 5, and docs/incremental.md.
    """
    seen = sightings_of(whole.owners)
    reader = _Reader(whole, seen, bearings, sigmas, config)
    found = [owner.copy() for owner in whole.owners]
    changed = False
    for number in sorted(seen, key=lambda number: (len(seen[number]), number)):
        places = seen[number]
        if not 2 <= len(places) <= MOST:
            continue
        own = reader.log_evidence(number, places)
        others, chosen = reader.read_as_others(number, places)
        if others > own:
            changed = True
            for (scan, detection), other in zip(places, chosen, strict=True):
                found[scan][detection] = other
            reader.give_up(number, places, chosen)
    return found if changed else None


class _Reader:
    """What the detections of a run say, given its smoothed poses and landmarks."""

    def __init__(
        self,
        whole: WholeRun,
        seen: dict[int, list[Place]],
        bearings: Sequence[FloatArray],
        sigmas: Sequence[FloatArray],
        config: SlamConfig,
    ) -> None:
        self._poses, self._bearings, self._sigmas = whole.poses, bearings, sigmas
        self._model = config.observation_model
        self._sightings = Sightings(whole, config)
        self._points = dict(zip(whole.numbers.tolist(), whole.points, strict=True))
        self._scans = {number: [scan for scan, _ in places] for number, places in seen.items()}

    def log_evidence(self, number: int, places: Sequence[Place]) -> float:
        """Log weight of a landmark that is seen there and nowhere else."""
        scans = [scan for scan, _ in places]
        z = np.array([self._bearings[scan][detection] for scan, detection in places])
        s = np.array([self._sigmas[scan][detection] for scan, detection in places])
        model = self._model
        return self._sightings.log_weight(number, scans) + log_sightings(
            self._poses[scans], z, s, model.bearing_dof, model.landmark_sigma,
            shortest_range(model.motion),
        )  # fmt: skip

    def read_as_others(self, number: int, places: Sequence[Place]) -> tuple[float, list[int]]:
        """Log weight of the best other reading of a stray, and the owners it gives."""
        others = [
            other
            for other, scans in self._scans.items()
            if len(scans) >= max(SURE, MORE * len(places))
            and other != number
            and other in self._points
        ]
        alone = np.array([self._sightings.alone(scan) for scan, _ in places])
        if not others:
            return float(alone.sum()), [MISSED] * len(places)
        points = np.array([self._points[other] for other in others])
        densities = np.array([self._log_densities(place, points) for place in places])
        near = np.flatnonzero((densities > alone[:, None]).any(axis=0))
        others = [others[i] for i in near.tolist()]
        densities = densities[:, near]
        readings = [
            self._one_by_one(places, others, densities, alone, first)
            for first in (None, *range(len(others)))
        ]
        return max(readings, key=lambda reading: reading[0])

    def give_up(self, number: int, places: Sequence[Place], chosen: Sequence[int]) -> None:
        """Let the detections of a stray belong to others."""
        del self._scans[number]
        for (scan, _), other in zip(places, chosen, strict=True):
            if other != MISSED:
                insort(self._scans[other], scan)

    def _log_densities(self, place: Place, points: FloatArray) -> FloatArray:
        scan, detection = place
        at = slice(detection, detection + 1)
        z, sigma = self._bearings[scan][at], self._sigmas[scan][at]
        dof = self._model.bearing_dof
        return np.asarray(log_as_seen(self._poses[scan], points, z, sigma, dof)[0])

    def _one_by_one(
        self,
        places: Sequence[Place],
        others: Sequence[int],
        densities: FloatArray,
        alone: FloatArray,
        first: int | None,
    ) -> tuple[float, list[int]]:
        """Read each detection as is best given those before; `first` has the first it can have."""
        total = 0.0
        chosen: list[int] = []
        for k, (scan, _) in enumerate(places):
            odds = [self._sightings.log_odds(other, self._scans[other], scan) for other in others]
            gains = densities[k] + odds
            best = int(np.argmax(gains)) if others else -1
            if first is not None and densities[k, first] > alone[k] and odds[first] > -math.inf:
                best, first = first, None
            elif best >= 0 and gains[best] <= alone[k]:
                best = -1
            total += float(gains[best] if best >= 0 else alone[k])
            chosen.append(others[best] if best >= 0 else MISSED)
            if best >= 0:
                insort(self._scans[others[best]], scan)
        for (scan, _), other in zip(places, chosen, strict=True):
            if other != MISSED:
                self._scans[other].remove(scan)
        return total, chosen
