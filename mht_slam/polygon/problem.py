"""What `rank` is asked, and how hypotheses become the rows of its list."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from mht_slam.arrays import BoolArray, IntArray
from mht_slam.association import MISSED, allowed_pairs
from mht_slam.measurements import BearingScan
from mht_slam.polygon.base import choose_base
from mht_slam.polygon.enumeration import Completion, completions
from mht_slam.polygon.tables import PairOfScans, ThirdLandmark, third_landmarks

MIN_LANDMARKS = 3
"""Two landmarks carry F_L; the third is the first that can be compared."""

PADDING = -1
"""Fills up the row keys of tables that run out of rows."""


@dataclass(frozen=True)
class Problem:
    """What is ranked, and how.

    Attributes
    ----------
    scans : the scans of the associations' columns.
    pairs : the two pairs of scans that are compared.
    middle : the column whose detections name the landmarks.
    base : base detections the caller gave, or None for the rule.
    """

    scans: tuple[BearingScan, ...]
    pairs: tuple[PairOfScans, PairOfScans]
    middle: int
    base: tuple[int, int] | None
    ratio: str
    region: str
    top_k: int | None
    max_missed: int
    max_false: int
    include_zero: bool
    _tables: dict[tuple[int, int], dict[int, ThirdLandmark]] = field(default_factory=dict)

    @property
    def n_detections(self) -> tuple[int, ...]:
        """Number of detections of each scan."""
        return tuple(len(scan) for scan in self.scans)

    @cached_property
    def allowed(self) -> dict[tuple[int, int], BoolArray]:
        """For two columns, which detections may be one landmark as far as labels tell."""
        n = len(self.scans)
        return {
            (a, b): allowed_pairs(self.scans[a], self.scans[b])
            for a in range(n)
            for b in range(n)
            if a != b
        }

    def completions(self, n_full: int) -> list[Completion]:
        """What can become of the detections besides `n_full` landmarks seen in every scan."""
        left_over = tuple(n - n_full for n in self.n_detections)
        return completions(left_over, self.max_missed, self.max_false)

    def base_among(self, seen: tuple[int, ...]) -> tuple[int, int] | None:
        """The base of hypotheses whose fully seen landmarks are `seen` in the middle scan."""
        if len(seen) < MIN_LANDMARKS:
            return None
        if self.base is None:
            return choose_base(self.scans[self.middle].bearings, seen)
        return self.base if set(self.base) <= set(seen) else None

    def thirds(self, base: tuple[int, int]) -> dict[int, ThirdLandmark]:
        """Ratio tables of all third landmarks for one base."""
        if base not in self._tables:
            self._tables[base] = third_landmarks(
                self.pairs, base, ratio=self.ratio, region=self.region
            )
        return self._tables[base]

    def decode(self, keys: IntArray) -> IntArray:
        """Undo `row_keys` for one table."""
        radix = max(self.n_detections) + 2
        powers = radix ** np.arange(len(self.scans))[::-1]
        entries = keys[keys != PADDING][:, None] // powers % radix
        return np.where(entries == radix - 1, MISSED, entries)


def completed_rows(
    problem: Problem, chosen: tuple[tuple[int, ...], ...], rest: list[Completion]
) -> list[tuple[IntArray, bool]]:
    """Partly seen rows of each completion, and whether all their cells exist.

    Completions that contradict labels are left out, and unless zeros are wanted also those
    without a cell.
    """
    left_over = [
        [d for d in range(count) if d not in used]
        for count, used in zip(problem.n_detections, chosen, strict=True)
    ]
    completed = []
    for completion in rest:
        rows = np.array(
            [
                [MISSED if d == MISSED else left_over[scan][d] for scan, d in enumerate(row)]
                for row in completion
            ],
            dtype=np.int64,
        ).reshape(-1, len(problem.scans))
        if not _labels_permit(problem, rows, left_over):
            continue
        feasible = all(cell_exists(problem, row) for row in rows)
        if feasible or problem.include_zero:
            completed.append((rows, feasible))
    return completed


def cell_exists(problem: Problem, row: IntArray) -> bool:
    """Whether the detections of a row meet in a cell of every pair that sees it twice."""
    return all(
        bool(pair.cells.filled[row[a], row[b]])
        for pair in problem.pairs
        for a, b in (pair.columns,)
        if row[a] != MISSED and row[b] != MISSED
    )


def _labels_permit(problem: Problem, rows: IntArray, left_over: list[list[int]]) -> bool:
    labels = [scan.labels or (None,) * len(scan) for scan in problem.scans]
    for row in rows:
        names = {labels[s][d] for s, d in enumerate(row) if d != MISSED} - {None}
        if len(names) > 1:
            return False
        for name in names:
            if any(
                name in of and (row[s] == MISSED or of[row[s]] != name)
                for s, of in enumerate(labels)
            ):
                return False
    return all(
        labels[s][d] is None or d in rows[:, s]
        for s, unused in enumerate(left_over)
        for d in unused
    )


def full_tables(
    problem: Problem, seen: tuple[int, ...], first: IntArray, second: IntArray
) -> IntArray:
    """(N, landmarks, scans) tables of the fully seen landmarks."""
    table = np.empty((len(first), len(seen), len(problem.scans)), dtype=np.int64)
    table[:, :, problem.middle] = seen
    for pair, columns in zip(problem.pairs, (first, second), strict=True):
        names = [c for c in pair.columns if c != problem.middle]
        for place, name in enumerate(names):
            table[:, :, name] = columns[:, place, :]
    return table


def row_keys(problem: Problem, full: IntArray, rows_left: IntArray) -> IntArray:
    """(N, rows) one whole number per row, in the order of an association's sorted table."""
    radix = max(problem.n_detections) + 2
    powers = radix ** np.arange(len(problem.scans))[::-1]
    left = np.where(rows_left == MISSED, radix - 1, rows_left) @ powers
    keys = np.concatenate([full @ powers, np.broadcast_to(left, (len(full), len(left)))], axis=1)
    return np.sort(keys, axis=1)
