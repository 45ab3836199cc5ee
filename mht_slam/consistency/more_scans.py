"""Consistent associations of more than three scans: three by search, the others one by one.

What three scans leave is extended depth first, scan by scan. Within a scan the detections are given
to landmarks one after the other while the ratio bounds of every three scans can still be kept; the
linear program of `mht_slam.consistency.steps` decides each association of the scans so far.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.consistency.options import options_of, permitted_by_labels
from mht_slam.consistency.ratio_intervals import (
    Cones,
    pair_meets,
    ratio_intervals,
    shared_ratios,
)
from mht_slam.consistency.steps import RatioBounds, triples
from mht_slam.consistency.three_scans import associations_of_three
from mht_slam.consistency.work import Work
from mht_slam.measurements import BearingScan

FALSE_ALARM = -1
NEW_LANDMARK = -2


@dataclass(frozen=True)
class Problem:
    """What is searched: scans, their cones, and how much may be missed or false."""

    scans: tuple[BearingScan, ...]
    epsilon: float
    max_missed: int
    max_false: int
    cones: tuple[Cones, ...] = field(init=False)

    def __post_init__(self) -> None:
        cones = tuple(Cones.of(scan.bearings, self.epsilon) for scan in self.scans)
        object.__setattr__(self, "cones", cones)


def consistent_tables(problem: Problem, work: Work) -> Iterator[tuple[IntArray, RatioBounds]]:
    """Each consistent association's rows, with what they ask of the steps, exactly once.

    They are all unless `work` is exhausted afterwards.
    """
    first_scans, first_cones = problem.scans[:3], problem.cones[:3]
    full = problem.max_missed == 0 and problem.max_false == 0
    options = options_of(
        first_scans,
        first_cones,
        max_missed=problem.max_missed,
        max_false=problem.max_false,
        window=shared_ratios(first_cones) if full else (0.0, np.inf),
    )
    if options is None:
        return
    a, b, c = (len(scan) for scan in first_scans)
    for choice in associations_of_three(
        options, (a, b, c), problem.max_missed, problem.max_false, work
    ):
        chosen = options.choose(choice)
        bounds = RatioBounds(
            3,
            np.array([chosen.lowest.max(initial=0.0)]),
            np.array([chosen.highest.min(initial=np.inf)]),
        )
        partial = _Partial(chosen.rows[~chosen.false], int(chosen.false.sum()), bounds)
        for complete in _extended(problem, partial, work):
            yield complete.rows, complete.bounds
        if work.exhausted:
            return


def ratio_bounds(rows: IntArray, cones: Sequence[Cones]) -> RatioBounds | None:
    """What the rows (n, m) of an association ask of the steps; None where some cones never meet."""
    n_scans = rows.shape[1]
    for a, b in combinations(range(n_scans), 2):
        seen = rows[(rows[:, [a, b]] != MISSED).all(axis=1)]
        if not pair_meets(cones[a].at(seen[:, a]), cones[b].at(seen[:, b])).all():
            return None
    lowest, highest = [], []
    for chosen in triples(n_scans):
        seen = rows[(rows[:, chosen] != MISSED).all(axis=1)]
        low, high = ratio_intervals(*(cones[scan].at(seen[:, scan]) for scan in chosen))
        if (low > high).any():
            return None
        lowest.append(low.max(initial=0.0))
        highest.append(high.min(initial=np.inf))
    return RatioBounds(n_scans, np.array(lowest), np.array(highest))


@dataclass(frozen=True)
class _Partial:
    """A consistent association of the first scans, one row per landmark seen so far."""

    rows: IntArray
    n_false: int
    bounds: RatioBounds


def _extended(problem: Problem, partial: _Partial, work: Work) -> Iterator[_Partial]:
    """All consistent ways to take the remaining scans in, one scan after the other."""
    if partial.bounds.n_scans == len(problem.scans):
        yield partial
        return
    for longer in _with_next_scan(problem, partial, work):
        yield from _extended(problem, longer, work)
        if work.exhausted:
            return


def _with_next_scan(problem: Problem, partial: _Partial, work: Work) -> Iterator[_Partial]:
    n_old = len(partial.rows)
    column = partial.bounds.n_scans
    scans, cones = problem.scans[: column + 1], problem.cones[: column + 1]
    n_detections = len(scans[column])
    allowed, lowest, highest = _sightings(partial.rows, scans, cones)
    order = np.argsort(allowed[:n_old, :n_detections].sum(axis=0), kind="stable").tolist()
    already_missed = int((partial.rows == MISSED).sum())
    # Rows that stay without a detection have to be permitted, and paid for.
    may_miss = allowed[:n_old, n_detections]

    def place(
        position: int, owners: tuple[int, ...], n_false: int, low: FloatArray, high: FloatArray
    ) -> Iterator[_Partial]:
        if not work.spend():
            return
        n_new = owners.count(NEW_LANDMARK)
        n_taken = len(owners) - n_new - owners.count(FALSE_ALARM)
        unplaced = n_detections - position
        n_missed = already_missed + column * n_new + max(0, n_old - n_taken - unplaced)
        if n_missed > problem.max_missed or n_false > problem.max_false:
            return
        if position == n_detections:
            left = np.setdiff1d(np.arange(n_old), owners)
            bounds = RatioBounds(
                column + 1,
                np.concatenate([partial.bounds.lowest, low]),
                np.concatenate([partial.bounds.highest, high]),
            )
            if may_miss[left].all() and bounds.steps_exist:
                rows = _appended(partial.rows, order, owners)
                yield _Partial(rows, n_false, bounds)
            return
        detection = order[position]
        for row in range(n_old):
            if allowed[row, detection] and row not in owners:
                tighter_low = np.maximum(low, lowest[row, detection])
                tighter_high = np.minimum(high, highest[row, detection])
                if (tighter_low <= tighter_high).all():
                    yield from place(
                        position + 1, (*owners, row), n_false, tighter_low, tighter_high
                    )
        if allowed[n_old, detection]:
            yield from place(position + 1, (*owners, NEW_LANDMARK), n_false, low, high)
        if allowed[n_old + 1, detection]:
            yield from place(position + 1, (*owners, FALSE_ALARM), n_false + 1, low, high)

    n_bounds = lowest.shape[2]
    yield from place(0, (), partial.n_false, np.zeros(n_bounds), np.full(n_bounds, np.inf))


def _sightings(
    rows: IntArray, scans: Sequence[BearingScan], cones: Sequence[Cones]
) -> tuple[BoolArray, FloatArray, FloatArray]:
    """What the last of `scans` may mean for the landmarks of the scans before it.

    Returns a mask (n + 2, d + 1): may row l be detection i; the last column: may it be missed; the
    last two rows: may a detection be a new landmark, a false alarm. And the (n, d, K) bounds that
    a sighting adds, for every two scans before and the last one.
    """
    column = len(scans) - 1
    n_old, n_detections = len(rows), len(scans[column])
    detections = np.arange(n_detections)
    candidates = np.append(detections, MISSED)
    every = np.empty((n_old + 2, n_detections + 1, column + 1), dtype=np.int64)
    every[..., :column] = MISSED
    every[:n_old, :, :column] = rows[:, None]
    every[..., column] = candidates
    false = np.zeros(every.shape[:2], dtype=np.bool_)
    false[n_old + 1] = True
    allowed = permitted_by_labels(every.reshape(-1, column + 1), false.ravel(), scans).reshape(
        false.shape
    )
    last = cones[column].at(None, slice(None))
    for scan in range(column):
        seen = rows[:, scan] != MISSED
        meets = pair_meets(cones[scan].at(rows[seen, scan], None), last)
        allowed[np.flatnonzero(seen)[:, None], detections] &= meets
    pairs = [abc[:2] for abc in triples(column + 1) if abc[2] == column]
    lowest = np.zeros((n_old, n_detections, len(pairs)))
    highest = np.full((n_old, n_detections, len(pairs)), np.inf)
    for k, (a, b) in enumerate(pairs):
        seen = (rows[:, [a, b]] != MISSED).all(axis=1)
        lowest[seen, :, k], highest[seen, :, k] = ratio_intervals(
            cones[a].at(rows[seen, a], None), cones[b].at(rows[seen, b], None), last
        )
    allowed[:n_old, :n_detections] &= (lowest <= highest).all(axis=2)
    return allowed, lowest, highest


def _appended(rows: IntArray, order: list[int], owners: tuple[int, ...]) -> IntArray:
    """The rows with one more column, and a row for each new landmark."""
    column = np.full(len(rows), MISSED, dtype=np.int64)
    new = []
    for detection, owner in zip(order, owners, strict=True):
        if owner >= 0:
            column[owner] = detection
        elif owner == NEW_LANDMARK:
            new.append([MISSED] * rows.shape[1] + [detection])
    grown = np.column_stack([rows, column])
    return np.vstack([grown, np.array(new, dtype=np.int64).reshape(-1, grown.shape[1])])
