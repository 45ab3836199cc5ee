"""What can become of the detections of three scans: the rows that an association may have.

An *option* is one row of a table, or one false alarm, with the interval of ratios under which its
cones meet. An association is a choice of options that uses every detection once, and it is
consistent exactly when the intervals of its options share a ratio.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.consistency.ratio_intervals import Cones, Interval, pair_meets, ratio_intervals
from mht_slam.measurements import BearingScan


@dataclass(frozen=True)
class Options:
    """Options for the detections of three scans, those with the widest intervals first.

    Attributes
    ----------
    rows : (O, 3) detections, -1 where missed. A false alarm is a row with one detection.
    false : (O,) whether the option is a false alarm.
    lowest, highest : (O,) ratios under which the cones meet.
    """

    rows: IntArray
    false: BoolArray
    lowest: FloatArray
    highest: FloatArray

    def __len__(self) -> int:
        return len(self.rows)

    def choose(self, index: BoolArray | IntArray) -> Options:
        """The options of a mask or an order."""
        return Options(self.rows[index], self.false[index], self.lowest[index], self.highest[index])

    @property
    def n_missed(self) -> IntArray:
        """(O,) scans that miss the landmark; 0 for a false alarm."""
        return np.where(self.false, 0, (self.rows == MISSED).sum(axis=1))


def options_of(
    scans: Sequence[BearingScan],
    cones: Sequence[Cones],
    *,
    max_missed: int,
    max_false: int,
    window: Interval,
) -> Options | None:
    """List what can become of the detections of three scans under ratios inside `window`.

    The window is narrowed to ratios for which every detection has an option; None where there are
    none. Options that contradict the labels are left out, as are those that `max_missed` and
    `max_false` rule out by themselves.
    """
    parts = [_seen_by_all(cones)]
    if max_missed >= 1:
        parts += [_seen_by_two(cones, missing) for missing in range(3)]
    alone = _seen_by_one([len(scan) for scan in scans])
    if max_missed >= 2:
        parts.append(alone)
    if max_false >= 1:
        parts.append(Options(alone.rows, ~alone.false, alone.lowest, alone.highest))
    every = Options(
        np.concatenate([part.rows for part in parts]),
        np.concatenate([part.false for part in parts]),
        np.concatenate([part.lowest for part in parts]),
        np.concatenate([part.highest for part in parts]),
    )
    every = every.choose(permitted_by_labels(every.rows, every.false, scans))
    within = _within(every, [len(scan) for scan in scans], window)
    if within is None:
        return None
    options, (low, high) = within
    width = np.minimum(options.highest, high) - np.maximum(options.lowest, low)
    return options.choose(np.argsort(-width, kind="stable"))


def permitted_by_labels(
    rows: IntArray, false: BoolArray, scans: Sequence[BearingScan]
) -> BoolArray:
    """Which rows (N, m), `false` (N,) marking false alarms, do not contradict the scans' labels.

    A row with a label holds every detection of that label and none of another; a labelled
    detection is no false alarm.
    """
    permitted = np.ones(len(rows), dtype=np.bool_)
    numbers: dict[str, int] = {}
    columns = []
    for scan, column in zip(scans, rows.T, strict=True):
        names = [
            MISSED if label is None else numbers.setdefault(label, len(numbers))
            for label in scan.labels or (None,) * len(scan)
        ]
        columns.append(np.array([*names, MISSED], dtype=np.int64)[column])
    labels = np.stack(columns, axis=1)
    label = labels.max(axis=1)
    permitted &= ((labels == MISSED) | (labels == label[:, None])).all(axis=1)
    permitted &= ~(false & (label != MISSED))
    for name, number in numbers.items():
        holders = [name in (scan.labels or ()) for scan in scans]
        permitted &= (label != number) | ((labels == number) == holders).all(axis=1)
    return permitted


def _seen_by_all(cones: Sequence[Cones]) -> Options:
    lowest, highest = ratio_intervals(
        cones[0].at(slice(None), None, None),
        cones[1].at(None, slice(None), None),
        cones[2].at(None, None, slice(None)),
    )
    meets = lowest <= highest
    rows = np.argwhere(meets)
    return Options(rows, np.zeros(len(rows), np.bool_), lowest[meets], highest[meets])


def _seen_by_two(cones: Sequence[Cones], missing: int) -> Options:
    earlier, later = (scan for scan in range(3) if scan != missing)
    pairs = np.argwhere(
        pair_meets(cones[earlier].at(slice(None), None), cones[later].at(None, slice(None)))
    )
    return _any_ratio(np.insert(pairs, missing, MISSED, axis=1))


def _seen_by_one(counts: Sequence[int]) -> Options:
    rows = np.full((sum(counts), 3), MISSED, dtype=np.int64)
    scan = np.repeat(np.arange(3), counts)
    rows[np.arange(len(rows)), scan] = np.concatenate([np.arange(count) for count in counts])
    return _any_ratio(rows)


def _any_ratio(rows: IntArray) -> Options:
    n = len(rows)
    return Options(rows, np.zeros(n, np.bool_), np.zeros(n), np.full(n, np.inf))


def _within(
    options: Options, counts: Sequence[int], window: Interval
) -> tuple[Options, Interval] | None:
    """Shrink the window to ratios that every detection has an option for, until nothing changes."""
    low, high = window
    while True:
        options = options.choose((options.lowest <= high) & (options.highest >= low))
        narrowed = (low, high)
        for scan, count in enumerate(counts):
            seen = options.rows[:, scan] != MISSED
            detection = options.rows[seen, scan]
            first, last = np.full(count, np.inf), np.full(count, -np.inf)
            np.minimum.at(first, detection, options.lowest[seen])
            np.maximum.at(last, detection, options.highest[seen])
            low = max(low, float(first.max(initial=0.0)))
            high = min(high, float(last.min(initial=np.inf)))
        if low > high:
            return None
        if (low, high) == narrowed:
            return options, (low, high)
