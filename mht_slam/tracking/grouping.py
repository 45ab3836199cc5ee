"""Which groups of tracks may want one detection of a scan, and so are read together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray
from mht_slam.matchings import best_matching
from mht_slam.tracking.options import TrackerConfig
from mht_slam.tracking.readings import Group, Reading, merged
from mht_slam.tracking.scan_step import ScanStep

WORTH = 4.0
"""Exchanges that lose more nats than this are not thought of."""


def regrouped(
    groups: Sequence[Group], step: ScanStep, config: TrackerConfig
) -> list[tuple[Group, list[int]]]:
    """Return groups with the detections that each may use; groups that may share one are joined.

    Every detection goes to one group; one that nobody may use gets an empty group.
    """
    wanted = _wanted(groups, step)
    leader = list(range(len(groups)))
    taker: dict[int, int] = {}
    for place, detections in enumerate(wanted):
        for detection in detections:
            first = _leader(leader, taker.setdefault(detection, place))
            own = _leader(leader, place)
            leader[max(first, own)] = min(first, own)
    members: dict[int, list[int]] = {}
    for place in range(len(groups)):
        members.setdefault(_leader(leader, place), []).append(place)
    joined = [
        (
            merged([groups[place] for place in places], config.n_alternatives),
            sorted(set().union(*(wanted[place] for place in places))),
        )
        for places in members.values()
    ]
    nobody = [j for j in range(len(step.bearings)) if j not in taker]
    return [*joined, *(([Reading(0.0, ())], [j]) for j in nobody)]


def _wanted(groups: Sequence[Group], step: ScanStep) -> list[set[int]]:
    """Detections that some reading of a group may use, while all other groups are at their best."""
    tracks = [track for group in groups for track in group[0].tracks]
    gains = step.gains(tracks)
    ends = np.cumsum([len(group[0].tracks) for group in groups]).tolist()
    links = _worthwhile(gains)
    wanted = []
    for group, end in zip(groups, ends, strict=True):
        start = end - len(group[0].tracks)
        found = links[start:end].any(axis=0)
        others = np.delete(gains, slice(start, end), axis=0)
        for reading in group[1:]:
            own = step.gains(reading.tracks)
            found |= _worthwhile(np.concatenate([own, others]))[: len(own)].any(axis=0)
        wanted.append(set(np.flatnonzero(found).tolist()))
    return wanted


def _worthwhile(gains: FloatArray) -> BoolArray:
    """Pairs of the best matching, and those that two tracks could exchange for little."""
    n, m = gains.shape
    matches, _ = best_matching(gains)
    own_column, own_row = np.full(n, m), np.full(m, n)
    for row, column in matches:
        own_column[row], own_row[column] = column, row
    padded = np.zeros((n + 1, m + 1))
    padded[:n, :m] = gains
    held = padded[np.arange(n), own_column][:, None] + padded[own_row, np.arange(m)]
    given_back = padded[own_row, own_column[:, None]]
    worth = (gains > 0.0) & (held - gains - given_back <= WORTH)
    for pair in matches:
        worth[pair] = True
    return np.asarray(worth)


def _leader(leader: list[int], place: int) -> int:
    while leader[place] != place:
        place = leader[place]
    return place
