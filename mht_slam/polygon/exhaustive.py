"""Score every hypothesis by table look-ups and keep the best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.polygon.best import SCORE_DECIMALS, Best, Listing
from mht_slam.polygon.enumeration import (
    MAX_HYPOTHESES,
    Completion,
    assignments,
    level_size,
    subsets,
    too_many_hypotheses,
)
from mht_slam.polygon.problem import (
    MIN_LANDMARKS,
    Problem,
    completed_rows,
    full_tables,
    row_keys,
)
from mht_slam.progress import Progress

_BLOCK = 1_000_000


def exhaustive_search(problem: Problem, progress: Progress | None = None) -> Listing:
    """Score all hypotheses.

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
        best = Best(room)
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
    return Listing(listed, n_scored)


def _score_subset(
    problem: Problem,
    chosen: tuple[tuple[int, ...], ...],
    rest: list[Completion],
    best: Best,
) -> int:
    """Score all hypotheses whose fully seen landmarks use the `chosen` detections of each scan."""
    completed = completed_rows(problem, chosen, rest)
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
                full = full_tables(
                    problem, seen, first.columns[block[i]], second.columns[columns[j]]
                )
                best.add(value[i, j], row_keys(problem, full, rows_left))
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
