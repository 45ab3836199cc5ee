"""Sightings of a landmark: what it weighs that some scans of a run see it and no others do."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.evidence.bearing_noise import log_bearing_noise
from mht_slam.incremental.associate import CERTAIN, Weights
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.whole_run import WholeRun
from mht_slam.measurements import wrap_angle

Place: TypeAlias = tuple[int, int]
"""Scan and detection."""

NEAREST = 1e-3
"""Range of a landmark, in deviations of the prior of a new landmark's range, at least."""


def sightings_of(owners: Sequence[IntArray]) -> dict[int, list[Place]]:
    """Return the scans and detections of every landmark, from the owners by scan."""
    seen: dict[int, list[Place]] = {}
    for scan, owner in enumerate(owners):
        for detection, number in enumerate(owner.tolist()):
            if number != MISSED:
                seen.setdefault(number, []).append((scan, detection))
    return seen


class Sightings:
    """Weights of when landmarks are seen, over a whole run.

    A landmark seen in scans k_1 < k_2 < ... and in no other weighs

        lambda(k_1) prod P(next seen in k_i+1 | seen in k_i) P(not seen again | seen in the last),

    lambda the expected number of landmarks first seen in a scan, the chances those of a landmark
    that comes into view and leaves it (docs/incremental.md, 5); scans that have its place outside
    the sensor's field say nothing. Not seen for more than `lag` scans it has left, and how long it
    stays away is the robot's doing: seen then, it weighs the share of time that landmarks are in
    view, P(back) / (P(leaves) + P(back)), times P_D.

    Parameters
    ----------
    whole : the smoothed run, whose poses and landmarks say what is in the sensor's field of view.
    """

    def __init__(self, whole: WholeRun, config: SlamConfig) -> None:
        model = config.observation_model
        self._weights = Weights.of(config)
        self._lag = config.lag
        assert model.false_alarm_rate is not None  # noqa: S101 - checked by the configuration
        self._false_alarms = model.false_alarm_rate * model.field_of_view
        chance = model.detection_probability
        assert chance is not None  # noqa: S101 - checked by the configuration
        self._chances = chance, model.stay_probability, config.return_probability
        away = whole.points[:, None] - whole.poses[None, :, :2]
        ranges = np.hypot(away[..., 0], away[..., 1])
        bearings = np.arctan2(away[..., 1], away[..., 0]) - whole.poses[:, 2]
        inside = np.abs(wrap_angle(bearings)) <= 0.5 * model.field_of_view
        inside &= ranges <= (math.inf if config.sight is None else config.sight)
        # Of a place first seen from there, but for constants: any direction, half-normal range.
        ranges = np.maximum(ranges / model.landmark_sigma, NEAREST)
        log_first = -np.log(ranges) - 0.5 * ranges**2
        self._row = {number: i for i, number in enumerate(whole.numbers.tolist())}
        self._inside, self._log_first = inside, log_first

    def alone(self, scan: int) -> float:
        """Log weight, per radian, of a detection on its own."""
        return self._weights.alone(scan)

    def expected(self, n_scans: int) -> float:
        """Expected number of first sightings and false alarms: the exponent of Poisson counts.

        The same for all associations of a run, but not under all models.
        """
        new = sum(math.exp(self._weights.landmark(scan)) for scan in range(n_scans))
        return new + self._false_alarms * n_scans

    def log_weight(self, number: int, scans: Sequence[int]) -> float:
        """Log weight of a landmark seen in these scans, increasing, and in no others.

        `number` is that of the landmark in the map whose place it has.
        """
        total = self._weights.landmark(scans[0]) + self._log_next(number, scans[-1], None)
        return total + sum(self._log_next(number, *gap) for gap in pairwise(scans))

    def log_odds(self, number: int, scans: Sequence[int], scan: int) -> float:
        """Log odds of one more sighting; -inf where there can be none.

        That is where the scan sees the landmark already, or its place is not in the sensor's field.
        A sighting before all others moves the prior of its place, too.
        """
        at = bisect_left(scans, scan)
        after = scans[at] if at < len(scans) else None
        row = self._row[number]
        if after == scan or not self._inside[row, scan]:
            return -math.inf
        odds = self._log_next(number, scan, after)
        if at:
            before = scans[at - 1]
            odds += self._log_next(number, before, scan)
            return odds - self._log_next(number, before, after)
        odds += self._weights.landmark(scan) + float(self._log_first[row, scan])
        if after is None:
            return odds
        return odds - self._weights.landmark(after) - float(self._log_first[row, after])

    def _log_next(self, number: int, before: int, after: int | None) -> float:
        """Log chance that a landmark seen in one scan is seen next in another, or in none."""
        inside = self._inside[self._row[number]]
        chance, stay, back = self._chances
        if after is not None and after - before <= self._lag:
            return log_unseen(*self._chances, inside[before + 1 : after].tobytes(), True)
        last = before + 1 + self._lag if after is None else min(before + 1 + self._lag, after)
        left = log_unseen(*self._chances, inside[before + 1 : last].tobytes(), False)
        return left if after is None else left + math.log(back / (1.0 - stay + back) * chance)


@lru_cache(maxsize=2**16)
def log_unseen(chance: float, stay: float, back: float, inside: bytes, seen_then: bool) -> float:
    """Log chance that a landmark just seen is not seen in the scans that follow.

    Parameters
    ----------
    chance, stay, back : P_D, and that it stays in view, or comes back, from scan to scan.
    inside : for each of these scans whether the sensor could see it.
    seen_then : that it is seen in the scan after them, too.
    """
    visible, total = 1.0, 0.0
    for could in inside:
        visible = stay * visible + (1.0 - visible) * back
        if could:
            missed = max(1.0 - visible * chance, 1.0 - CERTAIN)
            total += math.log(missed)
            visible = visible * (1.0 - chance) / missed
    if not seen_then:
        return total
    return total + math.log((stay * visible + (1.0 - visible) * back) * chance)


def log_as_seen(
    pose: FloatArray,
    points: FloatArray,
    bearings: FloatArray,
    sigmas: FloatArray,
    dof: float | None,
) -> FloatArray:
    """(d, n) log densities of d bearings from a pose as sightings of n landmarks.

    Places and pose are taken to be together as unsure as one bearing, hence sqrt(2) sigma.
    """
    away = points - pose[:2]
    expected = np.arctan2(away[:, 1], away[:, 0]) - pose[2]
    off = wrap_angle(expected[None] - bearings[:, None])
    wider = math.sqrt(2.0) * sigmas[:, None]
    return np.asarray(log_bearing_noise((off / wider) ** 2, dof) - np.log(wider))
