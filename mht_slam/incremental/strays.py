"""Strays: landmarks seen a few times only, read again as others once the whole run is smoothed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.evidence.bearing_noise import log_bearing_noise
from mht_slam.incremental.associate import Weights, log_seen_again, shortest_range
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.whole_run import WholeRun
from mht_slam.measurements import wrap_angle

MOST = 8
"""Detections of a stray, at most."""
MORE = 2
"""A landmark has to be seen this many times as often as the stray that it explains."""
SURE = 5
"""Detections from which a landmark explains others."""
RANGES = 1000
"""Log-spaced ranges over which the place of a stray is integrated."""
ROUNDS = 4
"""Newton steps to the best direction at each of them."""

Place: TypeAlias = tuple[int, int]
"""Scan and detection."""


def strays_reread(
    whole: WholeRun,
    owners: Sequence[IntArray],
    bearings: Sequence[FloatArray],
    sigmas: Sequence[FloatArray],
    config: SlamConfig,
) -> list[IntArray] | None:
    """Return the owners with strays read as sightings of other landmarks, None where none is.

    At its start a run knows no landmarks, and mistakes there are settled before the map tells them.
    Given smoothed poses, a stray of detections z_1, z_2, ... is a landmark of its own with weight

        lambda prod P(seen again) int p0(x) prod t(z_i; x) dx,

    lambda the expected number of new landmarks in the scan of z_1. Or each detection stands alone,
    or belongs to a landmark of many detections, not seen in this scan: t(z_i; x, sqrt(2) sigma)
    times P_D / (1 - P_D) where that one is seen not long before or after, else times
    P(back in view) P_D. Its place and the pose are taken to be as sure as one bearing. A stray is
    given up for the best of these readings where it gains `SlamConfig.twin_odds` nats.

    Parameters
    ----------
    whole : the run smoothed with these owners.
    owners, bearings, sigmas : of each scan, as `smooth_whole_run` takes them.

    Source: docs/method.md, section 5, and docs/incremental.md.
    """
    seen: dict[int, list[Place]] = {}
    for scan, owner in enumerate(owners):
        for detection, number in enumerate(owner.tolist()):
            if number != MISSED:
                seen.setdefault(number, []).append((scan, detection))
    reader = _Reader(whole, seen, bearings, sigmas, config)
    found = [owner.copy() for owner in owners]
    changed = False
    for number in sorted(seen, key=lambda number: (len(seen[number]), number)):
        places = seen[number]
        scans = {scan for scan, _ in places}
        if not 2 <= len(places) <= MOST or len(scans) < len(places):
            continue
        own = reader.log_evidence(places)
        others, chosen = reader.read_as_others(number, places)
        if others - own >= config.twin_odds:
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
        self._config, self._model = config, config.observation_model
        self._weights = Weights.of(config)
        self._points = dict(zip(whole.numbers.tolist(), whole.points, strict=True))
        self._scans = {number: {scan for scan, _ in seen[number]} for number in seen}
        self._counts = {number: len(places) for number, places in seen.items()}
        chance = self._model.detection_probability
        assert chance is not None  # noqa: S101 - checked by the configuration
        self._chance = chance

    def log_evidence(self, places: Sequence[Place]) -> float:
        """Log weight of a landmark that is seen there and nowhere else."""
        model, back = self._model, self._config.return_probability
        total = self._weights.landmark(places[0][0])
        for (before, _), (after, _) in pairwise(places):
            gap = after - before
            total += log_seen_again(self._chance, model.stay_probability, back, gap)
        scans = [scan for scan, _ in places]
        z = np.array([self._bearings[scan][detection] for scan, detection in places])
        s = np.array([self._sigmas[scan][detection] for scan, detection in places])
        return total + log_sightings(
            self._poses[scans], z, s, model.bearing_dof, model.landmark_sigma,
            shortest_range(model.motion),
        )  # fmt: skip

    def read_as_others(self, number: int, places: Sequence[Place]) -> tuple[float, list[int]]:
        """Log weight of the best other reading of a stray, and the owners it gives."""
        total = 0.0
        chosen: list[int] = []
        candidates = [
            other
            for other, count in self._counts.items()
            if count >= max(SURE, MORE * len(places)) and other != number and other in self._points
        ]
        points = np.array([self._points[other] for other in candidates]).reshape(-1, 2)
        for scan, detection in places:
            pose = self._poses[scan]
            away = points - pose[:2]
            expected = np.arctan2(away[:, 1], away[:, 0]) - pose[2]
            off = wrap_angle(expected - self._bearings[scan][detection])
            sigma = math.sqrt(2.0) * float(self._sigmas[scan][detection])
            gains = log_bearing_noise((off / sigma) ** 2, self._model.bearing_dof) - math.log(sigma)
            for i, other in enumerate(candidates):
                gains[i] += self._log_seen(other, scan, other in chosen)
            best = int(np.argmax(gains)) if candidates else -1
            alone = self._weights.alone(scan)
            if best >= 0 and gains[best] > alone:
                total += float(gains[best])
                chosen.append(candidates[best])
            else:
                total += alone
                chosen.append(MISSED)
        return total, chosen

    def give_up(self, number: int, places: Sequence[Place], chosen: Sequence[int]) -> None:
        """Let the detections of a stray belong to others."""
        del self._scans[number], self._counts[number]
        for (scan, _), other in zip(places, chosen, strict=True):
            if other != MISSED:
                self._scans[other].add(scan)
                self._counts[other] += 1

    def _log_seen(self, other: int, scan: int, just_chosen: bool) -> float:
        scans = self._scans[other]
        if scan in scans:
            return -math.inf
        lag = self._config.lag
        if just_chosen or any(near in scans for near in range(scan - lag, scan + lag + 1)):
            return math.log(self._chance) - math.log(max(1.0 - self._chance, 1e-9))
        return math.log(self._config.return_probability * self._chance)


def log_sightings(
    poses: FloatArray,
    bearings: FloatArray,
    sigmas: FloatArray,
    dof: float | None,
    landmark_sigma: float,
    nearest: float,
) -> float:
    """Log density of the bearings of one landmark from known poses, its place integrated out.

        int p0(phi, rho) prod_i t(z_i; h(phi, rho), sigma_i) dphi drho

    with the half-normal prior of `smooth_window` about the first pose. The direction is integrated
    by Laplace's method at each of a row of log ranges, which are summed.

    Parameters
    ----------
    poses, bearings, sigmas : (k, 3), (k,), (k,).
    nearest : the shortest range; `landmark_sigma` where that is shorter.
    """
    shortest = min(nearest, landmark_sigma)
    rho = np.linspace(math.log(shortest), math.log(4.0 * landmark_sigma), RANGES)
    reach = np.exp(rho)
    phi = np.full(RANGES, poses[0, 2] + bearings[0])
    heavy = math.inf if dof is None else dof
    for _ in range(ROUNDS + 1):
        off, slope = _offsets(phi, reach, poses, bearings)
        ratio = off / sigmas
        weight = 1.0 if dof is None else (heavy + 1.0) / (heavy + ratio**2)
        information = (weight * (slope / sigmas) ** 2).sum(axis=1)
        phi = phi - (weight * ratio * slope / sigmas).sum(axis=1) / np.maximum(information, 1e-12)
    off, _ = _offsets(phi, reach, poses, bearings)
    log_density = (log_bearing_noise((off / sigmas) ** 2, dof) - np.log(sigmas)).sum(axis=1)
    spread = 0.5 * np.log(2.0 * math.pi / np.maximum(information, 1.0 / (2.0 * math.pi)))
    scaled = reach / landmark_sigma
    log_prior = np.log(scaled) - 0.5 * scaled**2 - math.log(2.0 * math.pi)
    log_prior -= 0.5 * math.log(0.5 * math.pi)
    return float(np.logaddexp.reduce(log_prior + log_density + spread) + math.log(rho[1] - rho[0]))


def _offsets(
    phi: FloatArray, reach: FloatArray, poses: FloatArray, bearings: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(q, k) bearings to places minus those seen, and their derivatives by direction."""
    arm = reach[:, None] * np.stack([np.cos(phi), np.sin(phi)])[..., None]  # (2, q, 1)
    x = arm[0] + poses[0, 0] - poses[:, 0]
    y = arm[1] + poses[0, 1] - poses[:, 1]
    off = wrap_angle(np.arctan2(y, x) - poses[:, 2] - bearings)
    slope = (x * arm[0] + y * arm[1]) / np.maximum(x**2 + y**2, 1e-12)
    return off, slope
