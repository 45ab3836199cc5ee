"""Trivial trackers for many scans with misses and false alarms: nearest bearing, and kept order.

Both know no geometry beyond "bearings change little between scans". They read a run scan by scan,
keep one hypothesis, and may start and end tracks at any scan; the full tables of
`mht_slam.evaluation.baselines` cannot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from mht_slam.arrays import FloatArray, finite_number, whole_number
from mht_slam.association import MISSED, Association
from mht_slam.errors import OptionError
from mht_slam.matchings import best_in_order
from mht_slam.measurements import StraightRun, wrap_angle

RATE_STEPS = 2
"""Steps between detections over which a rate is taken: one is noisy, many are late."""


def nearest_bearing_tracker(
    run: StraightRun, gate: float, max_gap: int, *, with_rate: bool = True
) -> Association:
    """Assign the bearings of each scan to the bearings predicted from the tracks before it.

    Parameters
    ----------
    gate : radians, above 0 and at most pi. The assignment of a scan has the least sum of squared
        differences from the predictions, where a track and a detection that stay alone cost the
        gate squared; so none is assigned across more than the gate. (Absolute differences tie
        wherever all predictions lie on one side of the detections.)
    max_gap : scans in a row that a track survives unseen.
    with_rate : predict that a track moves on at its mean rate over the last three detections, once
        it has two; otherwise, that it stands still.

    Unassigned detections start tracks, and one that stays alone is a landmark seen once; nothing is
    called a false alarm. Raises `OptionError` for a gate or gap out of range, and for a run with
    known identities, of which trackers know nothing.
    """
    _check(run, gate, max_gap)
    tracks: list[_Track] = []
    for scan, seen in enumerate(run.scans):
        live = [track for track in tracks if track.lives(scan, max_gap)]
        gain = _gain(_predicted(live, scan, with_rate=with_rate), seen.bearings, gate)
        rows, columns = linear_sum_assignment(gain, maximize=True)
        owners = {
            j: live[i]
            for i, j in zip(rows.tolist(), columns.tolist(), strict=True)
            if gain[i, j] > 0.0
        }
        found = [owners.get(j) or _Track() for j in range(len(seen))]
        for j, (track, bearing) in enumerate(zip(found, seen.bearings.tolist(), strict=True)):
            track.see(scan, j, bearing)
        tracks += [track for j, track in enumerate(found) if j not in owners]
    return _association(tracks, run)


def order_keeping_tracker(
    run: StraightRun, gate: float, max_gap: int, *, with_rate: bool = True
) -> Association:
    """Assign bearings to tracks so that no two tracks ever exchange places in the visual order.

    Each scan's bearings, sorted from -pi to pi, are aligned with the tracks in the order they have
    had so far, by dynamic programming. Costs, options and errors are those of
    `nearest_bearing_tracker`; the order alone is a constraint, whatever the predictions.
    """
    _check(run, gate, max_gap)
    tracks: list[_Track] = []
    live: list[_Track] = []
    for scan, seen in enumerate(run.scans):
        live = [track for track in live if track.lives(scan, max_gap)]
        predicted = _predicted(live, scan, with_rate=with_rate)
        order = np.argsort(seen.bearings, kind="stable")
        bearings = seen.bearings[order]
        pairs = best_in_order(_gain(predicted, bearings, gate))
        owners = {j: live[i] for i, j in pairs}
        found = [owners.get(j) or _Track() for j in range(len(bearings))]
        for track, detection, bearing in zip(found, order.tolist(), bearings.tolist(), strict=True):
            track.see(scan, detection, bearing)
        tracks += [track for j, track in enumerate(found) if j not in owners]
        live = _merged(live, predicted, found, bearings, pairs)
    return _association(tracks, run)


@dataclass(eq=False)
class _Track:
    detections: dict[int, int] = field(default_factory=dict)
    bearings: dict[int, float] = field(default_factory=dict)

    def see(self, scan: int, detection: int, bearing: float) -> None:
        self.detections[scan] = detection
        self.bearings[scan] = bearing

    def lives(self, scan: int, max_gap: int) -> bool:
        return scan - max(self.bearings) - 1 <= max_gap

    def predicted(self, scan: int, *, with_rate: bool) -> float:
        *earlier, (last_scan, last) = self.bearings.items()
        if not (with_rate and earlier):
            return last
        before_scan, before = earlier[-RATE_STEPS:][0]
        rate = wrap_angle(last - before) / (last_scan - before_scan)
        return wrap_angle(last + rate * (scan - last_scan))


def _check(run: StraightRun, gate: float, max_gap: int) -> None:
    finite_number(gate, "gate", above=0.0, at_most=np.pi)
    whole_number(max_gap, "max_gap", at_least=0)
    for scan, seen in enumerate(run.scans):
        if any(label is not None for label in seen.labels or ()):
            raise OptionError(f"run has labels in scan {scan}: give bearings alone")


def _predicted(live: Sequence[_Track], scan: int, *, with_rate: bool) -> FloatArray:
    return np.array([track.predicted(scan, with_rate=with_rate) for track in live])


def _gain(predicted: FloatArray, bearings: FloatArray, gate: float) -> FloatArray:
    """(n_live, n_detections): what a match saves against leaving both alone, at least 0."""
    turn: FloatArray = np.abs(wrap_angle(predicted[:, None] - bearings))
    return np.maximum(gate**2 - turn**2, 0.0)


def _merged(
    live: Sequence[_Track],
    predicted: FloatArray,
    found: Sequence[_Track],
    bearings: FloatArray,
    pairs: Sequence[tuple[int, int]],
) -> list[_Track]:
    """Return the new order: new tracks go between the unseen ones by bearing."""
    order: list[_Track] = []
    i = j = 0
    for next_i, next_j in [*pairs, (len(live), len(found))]:
        while i < next_i or j < next_j:
            if j == next_j or (i < next_i and predicted[i] <= bearings[j]):
                order.append(live[i])
                i += 1
            else:
                order.append(found[j])
                j += 1
        order += found[next_j : next_j + 1]
        i, j = next_i + 1, next_j + 1
    return order


def _association(tracks: Sequence[_Track], run: StraightRun) -> Association:
    table = [[track.detections.get(scan, MISSED) for scan in range(len(run))] for track in tracks]
    return Association(table, run.n_detections)
