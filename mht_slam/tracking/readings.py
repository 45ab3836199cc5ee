"""Ambiguities kept apart: groups of tracks, each with the few best readings of its last scans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import TypeAlias

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.association import MISSED
from mht_slam.matchings import ranked_matchings
from mht_slam.tracking.options import TrackerConfig
from mht_slam.tracking.scan_step import ScanStep
from mht_slam.tracking.tracks import Track


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """One way to read the scans: which tracks there are, with their detections.

    Attributes
    ----------
    log_weight : up to a constant that all readings of a group share.
    tracks : those that go on.
    ended : those that have ended, while other readings of the group do not agree on them.
    """

    log_weight: float
    tracks: tuple[Track, ...]
    ended: tuple[Track, ...] = ()

    @property
    def all_tracks(self) -> tuple[Track, ...]:
        """Those that go on and those that have ended."""
        return self.tracks + self.ended

    def joined_by(self, log_weight: float) -> Reading:
        """Return the reading with the weight of another one added."""
        total = float(np.logaddexp(self.log_weight, log_weight))
        return Reading(total, self.tracks, self.ended)

    @property
    def ends(self) -> set[tuple[int, tuple[int, int]]]:
        """Number and latest detection of every track: who is who by now."""
        return {(track.number, track.last_seen) for track in self.all_tracks}


N_RECENT = 3
"""Scans on which two readings must agree to be taken for one."""

Group: TypeAlias = list[Reading]
"""Readings of the same detections, the most probable first."""


def probabilities(group: Sequence[Reading]) -> FloatArray:
    """Probability of each reading among those given."""
    logs = np.array([reading.log_weight for reading in group])
    weights = np.exp(logs - logs.max())
    return np.asarray(weights / weights.sum())


def merged(groups: Sequence[Group], most: int) -> Group:
    """Join groups: the best choices of one reading from each, at most so many."""
    joint = groups[0][:most]
    for group in groups[1:]:
        pairs = sorted(product(joint, group), key=lambda p: -p[0].log_weight - p[1].log_weight)
        joint = [
            Reading(a.log_weight + b.log_weight, a.tracks + b.tracks, a.ended + b.ended)
            for a, b in pairs[:most]
        ]
    return joint


def extended(
    group: Group, detections: Sequence[int], step: ScanStep, config: TrackerConfig
) -> Group:
    """Read one more scan, of which the group may use these detections, in every likely way.

    For each reading the best matchings of its tracks with the detections are taken; a detection
    left over begins a track. Source: docs/method.md, section 5.
    """
    columns = list(detections)
    children: list[Reading] = []
    best = -np.inf
    for reading in group:
        none_seen = reading.log_weight + step.log_missed(reading.tracks)
        gains = step.gains(reading.tracks)[:, columns]
        for count, (matches, gain) in enumerate(ranked_matchings(gains), start=1):
            total = none_seen + gain
            if count > config.n_alternatives or total < best - config.drop:
                break
            best = max(best, total)
            owned = {row: columns[column] for row, column in matches}
            after = [
                step.after(track, owned.get(row, MISSED))
                for row, track in enumerate(reading.tracks)
            ]
            after += [step.begun(j) for j in columns if j not in owned.values()]
            ended = tuple(track for track in after if track.has_ended)
            going_on = tuple(track for track in after if not track.has_ended)
            children.append(Reading(total, going_on, reading.ended + ended))
    return sorted(children, key=lambda reading: -reading.log_weight)


def likely(group: Group, config: TrackerConfig) -> Group:
    """Keep the best few readings, of those that agree by now on who is who the best.

    Readings that agree on the last scans differ in a detection lent before; their weights add up,
    or an ambiguity that lasts would fill the list with them.
    """
    best_of: dict[frozenset[tuple[int, ...]], Reading] = {}
    for reading in group:
        key = frozenset(_recently(track) for track in reading.all_tracks)
        known = best_of.get(key)
        best_of[key] = reading if known is None else known.joined_by(reading.log_weight)
    kept = sorted(best_of.values(), key=lambda reading: -reading.log_weight)
    least = kept[0].log_weight - config.drop
    return [reading for reading in kept[: config.n_alternatives] if reading.log_weight >= least]


def agreeing(group: Group, scan: int, config: TrackerConfig) -> Group:
    """Keep the readings that agree with the best one on all but the last few scans."""
    best, final = group[0], scan - config.window
    if len(group) == 1 or final < 0:
        return group
    decided = _detections_at(best, final)
    return [r for r in group if r is best or _detections_at(r, final) == decided]


def identity_risk(before: Group, after: Group) -> dict[int, float]:
    """Probability that the readings just given up were right on who is who.

    For each track of the best reading, by number: the probability of the readings in which its
    latest detection belongs to another track.
    """
    remaining = set(map(id, after))
    weights = probabilities(before).tolist()
    given_up = [
        (weight, reading.ends)
        for weight, reading in zip(weights, before, strict=True)
        if id(reading) not in remaining
    ]
    return {
        number: sum(weight for weight, ends in given_up if (number, last_seen) not in ends)
        for number, last_seen in before[0].ends
        if given_up
    }


def still_right(sure: float, risk: float) -> float:
    """Probability that an identity is right after one more exchange that may have happened.

    Two exchanges of the same two tracks undo each other.
    """
    return sure * (1.0 - risk) + (1.0 - sure) * risk


def split(group: Group) -> tuple[list[Group], list[Track]]:
    """Let go of what all readings agree on: groups of their own, and tracks that have ended."""
    best = group[0]
    common = set.intersection(*(set(reading.all_tracks) for reading in group))
    groups = [[Reading(0.0, (track,))] for track in best.tracks if track in common]
    ended = [track for track in best.ended if track in common]
    if len(group) > 1:
        left = [
            Reading(
                reading.log_weight - best.log_weight,
                tuple(track for track in reading.tracks if track not in common),
                tuple(track for track in reading.ended if track not in common),
            )
            for reading in group
        ]
        groups.append(left)
    return groups, ended


def _recently(track: Track) -> tuple[int, ...]:
    """Number of a track, the scan it is at, and its detections in the last few scans."""
    found = [track.number, track.scan]
    at: Track | None = track
    for _ in range(N_RECENT):
        if at is None:
            break
        found.append(at.detection)
        at = at.parent
    return tuple(found)


def _detections_at(reading: Reading, scan: int) -> set[tuple[int, int]]:
    """Which track has which detection of an earlier scan."""
    found = set()
    for track in reading.all_tracks:
        at: Track | None = track
        while at is not None and at.scan > scan:
            at = at.parent
        if at is not None and at.scan == scan and at.detection != MISSED:
            found.add((at.number, at.detection))
    return found
