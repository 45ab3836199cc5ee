"""Score every hypothesis by table look-ups and keep the best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.association import MISSED, allowed_pairs
from mht_slam.measurements import BearingScan
from mht_slam.polygon.base import choose_base
from mht_slam.polygon.enumeration import (
    MAX_HYPOTHESES,
    Completion,
    assignments,
    completions,
    level_size,
    subsets,
    too_many_hypotheses,
)
from mht_slam.polygon.tables import PairOfScans, ThirdLandmark, third_landmarks
from mht_slam.progress import Progress

MIN_LANDMARKS = 3
"""Two landmarks carry F_L; the third is the first that can be compared."""

SCORE_DECIMALS = 12

_BLOCK = 1_000_000
_PADDING = -1


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
        """Undo `_row_keys` for one table."""
        radix = max(self.n_detections) + 2
        powers = radix ** np.arange(len(self.scans))[::-1]
        entries = keys[keys != _PADDING][:, None] // powers % radix
        return np.where(entries == radix - 1, MISSED, entries)


def exhaustive_search(
    problem: Problem, progress: Progress | None = None
) -> tuple[list[tuple[float, IntArray]], int]:
    """Score all hypotheses; return (score, table) of those listed, in order, and how many.

    The order: landmarks seen in every scan (more first), score rounded to 1e-12 (higher first),
    table flattened with -1 as plus infinity (a table that runs out of rows comes first).
    `progress` hears the total of the levels that were reached, which grows where one does not
    fill the list. Raises `OptionError` where that would go through more than `MAX_HYPOTHESES`.
    """
    counts = problem.n_detections
    lowest = 0 if problem.include_zero else MIN_LANDMARKS
    labelled = any(scan.labels is not None for scan in problem.scans)
    listed: list[tuple[float, IntArray]] = []
    n_scored = 0
    done = total = 0
    for n_full in range(min(counts), lowest - 1, -1):
        room = None if problem.top_k is None else problem.top_k - len(listed)
        if room == 0:
            break
        rest = problem.completions(n_full)
        if not rest:
            continue
        size = level_size(counts, n_full, len(rest))
        total += size
        if not labelled and n_scored + size > MAX_HYPOTHESES:
            raise too_many_hypotheses(n_scored + size)
        best = _Best(room)
        per_subset = level_size((n_full,) * len(counts), n_full, len(rest))
        for chosen in subsets(counts, n_full):
            n_scored += _score_subset(problem, chosen, rest, best)
            if n_scored > MAX_HYPOTHESES:
                raise too_many_hypotheses(n_scored)
            done += per_subset
            if progress is not None:
                progress(done, total)
        listed += [
            (float(score), problem.decode(keys))
            for score, keys in zip(best.scores, best.keys, strict=True)
        ]
    return listed, n_scored


class _Best:
    """The best `room` hypotheses so far (all where it is None), in order."""

    def __init__(self, room: int | None) -> None:
        self._room = room
        self._parts: list[tuple[FloatArray, IntArray]] = []
        self._waiting = 0
        self.threshold = -np.inf

    @property
    def scores(self) -> FloatArray:
        self._merge()
        return self._parts[0][0] if self._parts else np.empty(0)

    @property
    def keys(self) -> IntArray:
        self._merge()
        return self._parts[0][1] if self._parts else np.empty((0, 1), dtype=np.int64)

    def add(self, scores: FloatArray, keys: IntArray) -> None:
        """Add scores (N,) with the row keys (N, rows) of their tables."""
        self._parts.append((scores, keys))
        self._waiting += len(scores)
        if self._room is not None and self._waiting > max(_BLOCK // 10, self._room):
            self._merge()

    def _merge(self) -> None:
        if self._waiting == 0:
            return
        width = max(keys.shape[1] for _, keys in self._parts)
        scores = np.concatenate([scores for scores, _ in self._parts])
        keys = np.concatenate(
            [
                np.pad(keys, ((0, 0), (0, width - keys.shape[1])), constant_values=_PADDING)
                for _, keys in self._parts
            ]
        )
        rounded = np.round(scores, SCORE_DECIMALS)
        order = np.lexsort((*keys.T[::-1], -rounded))[: self._room]
        self._parts = [(scores[order], keys[order])]
        self._waiting = 0
        if self._room is not None and len(order) == self._room:
            self.threshold = rounded[order[-1]]


def _score_subset(
    problem: Problem,
    chosen: tuple[tuple[int, ...], ...],
    rest: list[Completion],
    best: _Best,
) -> int:
    """Score all hypotheses whose fully seen landmarks use the `chosen` detections of each scan."""
    completed = _completed(problem, chosen, rest)
    if not completed:
        return 0
    seen = chosen[problem.middle]
    first = _pair_options(problem, 0, chosen)
    second = _pair_options(problem, 1, chosen)
    n_all = len(first.columns) * len(second.columns)
    if n_all * len(completed) > MAX_HYPOTHESES:
        raise too_many_hypotheses(n_all * len(completed))
    base = problem.base_among(seen)
    factors = [] if base is None else _factors(problem, base, seen, first, second)
    if not problem.include_zero:
        if not factors:
            return n_all * len(completed)
        rows, columns = _alive(factors)
    else:
        rows = np.arange(len(first.columns))
        columns = np.arange(len(second.columns))
    linked = _linked(problem, first, second)
    n_forbidden = 0
    step = max(1, _BLOCK // max(1, len(columns)))
    for start in range(0, len(rows), step):
        block = rows[start : start + step]
        score = np.full((len(block), len(columns)), 1.0 if factors else 0.0)
        for index_1, index_2, ratios in factors:
            score *= ratios[index_1[block][:, None], index_2[columns]]
        if len(factors) > 1:
            score **= 1.0 / len(factors)
        permitted = linked(block, columns)
        n_forbidden += int((~permitted).sum())
        for rows_left, feasible in completed:
            value = score if feasible else np.zeros_like(score)
            listed = permitted & (np.round(value, SCORE_DECIMALS) >= best.threshold)
            if not problem.include_zero:
                listed &= value > 0.0
            i, j = np.nonzero(listed)
            if len(i):
                full = _tables(problem, seen, first.columns[block[i]], second.columns[columns[j]])
                best.add(value[i, j], _row_keys(problem, full, rows_left))
    return (n_all - n_forbidden) * len(completed)


@dataclass(frozen=True)
class _PairOptions:
    """What one pair of scans can say of the fully seen landmarks.

    Attributes
    ----------
    options : (N, landmarks) the option each landmark takes.
    columns : (N, columns, landmarks) the detections behind it, middle scan left out.
    names : those columns.
    """

    options: IntArray
    columns: IntArray
    names: tuple[int, ...]


def _pair_options(
    problem: Problem, which: int, chosen: tuple[tuple[int, ...], ...]
) -> _PairOptions:
    seen = np.array(chosen[problem.middle], dtype=np.int64)
    names = tuple(c for c in problem.pairs[which].columns if c != problem.middle)
    lists = []
    for column in names:
        detections = np.array(chosen[column], dtype=np.int64)
        allowed = problem.allowed[problem.middle, column][np.ix_(seen, detections)]
        lists.append(detections[assignments(allowed)])
    if len(names) == 1:
        return _PairOptions(lists[0], lists[0][:, None, :], names)
    if len(lists[0]) * len(lists[1]) > MAX_HYPOTHESES:
        raise too_many_hypotheses(len(lists[0]) * len(lists[1]))
    i, j = np.indices((len(lists[0]), len(lists[1]))).reshape(2, -1)
    third, fourth = lists[0][i], lists[1][j]
    permitted = problem.allowed[names[0], names[1]][third, fourth].all(axis=1)
    third, fourth = third[permitted], fourth[permitted]
    n_fourth = len(problem.scans[names[1]])
    return _PairOptions(third * n_fourth + fourth, np.stack([third, fourth], axis=1), names)


def _factors(
    problem: Problem,
    base: tuple[int, int],
    seen: tuple[int, ...],
    first: _PairOptions,
    second: _PairOptions,
) -> list[tuple[IntArray, IntArray, FloatArray]]:
    """Row and column of every hypothesis half in each third landmark's table of ratios."""
    places = [seen.index(landmark) for landmark in base]
    factors = []
    for place, landmark in enumerate(seen):
        if landmark in base:
            continue
        third = problem.thirds(base)[landmark]
        index_1, index_2 = (
            index[options[:, places[0]], options[:, places[1]], options[:, place]]
            for index, options in (
                (third.index_first, first.options),
                (third.index_second, second.options),
            )
        )
        factors.append((index_1, index_2, third.ratios))
    return factors


def _alive(factors: list[tuple[IntArray, IntArray, FloatArray]]) -> tuple[IntArray, IntArray]:
    """The halves of hypotheses that can have a positive score at all."""
    rows = np.ones(len(factors[0][0]), dtype=np.bool_)
    columns = np.ones(len(factors[0][1]), dtype=np.bool_)
    for index_1, index_2, ratios in factors:
        rows &= (ratios.max(axis=1) > 0.0)[index_1]
        columns &= (ratios.max(axis=0) > 0.0)[index_2]
    return np.flatnonzero(rows), np.flatnonzero(columns)


def _linked(
    problem: Problem, first: _PairOptions, second: _PairOptions
) -> Callable[[IntArray, IntArray], BoolArray]:
    """Mask of hypotheses that labels permit between the two pairs' outer scans."""
    constraints = [
        (problem.allowed[name_a, name_b], a, b)
        for a, name_a in enumerate(first.names)
        for b, name_b in enumerate(second.names)
        if not problem.allowed[name_a, name_b].all()
    ]

    def permitted(rows: IntArray, columns: IntArray) -> BoolArray:
        mask = np.ones((len(rows), len(columns)), dtype=np.bool_)
        for allowed, a, b in constraints:
            for landmark in range(first.options.shape[1]):
                mask &= allowed[
                    first.columns[rows, a, landmark][:, None],
                    second.columns[columns, b, landmark][None, :],
                ]
        return mask

    return permitted


def _completed(
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


def _tables(problem: Problem, seen: tuple[int, ...], first: IntArray, second: IntArray) -> IntArray:
    """(N, landmarks, scans) tables of the fully seen landmarks."""
    table = np.empty((len(first), len(seen), len(problem.scans)), dtype=np.int64)
    table[:, :, problem.middle] = seen
    for pair, columns in zip(problem.pairs, (first, second), strict=True):
        names = [c for c in pair.columns if c != problem.middle]
        for place, name in enumerate(names):
            table[:, :, name] = columns[:, place, :]
    return table


def _row_keys(problem: Problem, full: IntArray, rows_left: IntArray) -> IntArray:
    """(N, rows) one whole number per row, in the order of an association's sorted table."""
    radix = max(problem.n_detections) + 2
    powers = radix ** np.arange(len(problem.scans))[::-1]
    left = np.where(rows_left == MISSED, radix - 1, rows_left) @ powers
    keys = np.concatenate([full @ powers, np.broadcast_to(left, (len(full), len(left)))], axis=1)
    return np.sort(keys, axis=1)
