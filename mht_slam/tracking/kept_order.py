"""The paper's rule alone: identities follow the visual order, which changes by one rule."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mht_slam.association import MISSED
from mht_slam.matchings import best_in_order
from mht_slam.tracking.order import TURN, apparent_angles
from mht_slam.tracking.scan_step import ScanStep
from mht_slam.tracking.tracks import Track

CROSSED = np.deg2rad(30.0)
"""Neighbours that are predicted this far the wrong way round at most have just crossed."""


def next_order(tracks: Sequence[Track], step: ScanStep) -> tuple[list[Track], list[Track]]:
    """Carry tracks, in their visual order, through one scan: those that go on, those that end.

    Two neighbours whose apparent angle is predicted to have passed through zero exchange places
    where another apparent angle exceeds 180 degrees, and nowhere else. Then the scan's bearings are
    aligned with the tracks in this cyclic order, with the greatest gain. Source: the paper's
    section 2; docs/method.md, section 6.
    """
    order = _exchanged(list(tracks), step)
    detections = np.argsort(step.bearings, kind="stable").tolist()
    pairs = best_in_order(step.gains(order)[:, detections], cyclic=True)
    owned = {row: detections[column] for row, column in pairs}
    after = [step.after(*seen) for seen in _settled(order, owned, step)]
    going_on = [track for track in after if not track.has_ended]
    for detection in detections:
        if detection not in owned.values():
            _insert(going_on, step.begun(detection))
    return going_on, [track for track in after if track.has_ended]


def _exchanged(order: list[Track], step: ScanStep) -> list[Track]:
    """Exchange neighbours by the paper's rule, those that crossed last first."""
    n = len(order)
    bearings = [step.predicted_bearing(track) for track in order]
    for _ in range(n * n):
        ahead = np.mod(np.roll(bearings, -1) - bearings, TURN)
        # Neighbours that crossed are nearly a whole turn apart, and the order goes round twice.
        crossed = [k for k in range(n) if n > 2 and TURN - ahead[k] < CROSSED]
        if not crossed or round(float(ahead.sum()) / TURN) < 2:
            break
        k = max(crossed, key=lambda k: float(ahead[k]))
        following = (k + 1) % n
        if not _may_exchange(bearings, following):
            break
        order[k], order[following] = order[following], order[k]
        bearings[k], bearings[following] = bearings[following], bearings[k]
    return order


def _settled(
    order: Sequence[Track], owned: dict[int, int], step: ScanStep
) -> list[tuple[Track, int]]:
    """Decide which of the neighbours that may cross did so: tracks and detections in the new order.

    Predictions cross a scan early or late; where both neighbours are seen, the bearings decide.
    """
    seen = [(track, owned.get(row, MISSED)) for row, track in enumerate(order)]
    gains = step.gains(order)
    bearings = [step.predicted_bearing(track) for track in order]
    row_of = {id(track): row for row, track in enumerate(order)}
    for k in range(len(order)):
        following = (k + 1) % len(order)
        (one, a), (other, b) = seen[k], seen[following]
        if MISSED in (a, b) or not _may_exchange(bearings, row_of[id(other)]):
            continue
        i, j = row_of[id(one)], row_of[id(other)]
        if gains[i, b] + gains[j, a] > gains[i, a] + gains[j, b]:
            seen[k], seen[following] = (other, a), (one, b)
    return seen


def _may_exchange(bearings: Sequence[float], member: int) -> bool:
    """Whether an apparent angle exceeds 180 degrees while one of a pair hides the other."""
    return bool((apparent_angles(np.delete(bearings, member)) > np.pi).any())


def _insert(order: list[Track], track: Track) -> None:
    """Put a new track behind the one that it follows in the scan."""
    behind = [float(np.mod(track.mean[0] - other.mean[0], TURN)) for other in order]
    order.insert(int(np.argmin(behind)) + 1 if order else 0, track)
