"""Lists of associations as index arrays: assignments of detections, and what is left over."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, product
from math import comb, factorial

import numpy as np

from mht_slam.arrays import BoolArray, IntArray
from mht_slam.association import MISSED
from mht_slam.errors import OptionError

MAX_HYPOTHESES = 200_000_000
"""The most hypotheses that one exhaustive ranking goes through."""

MAX_ASSIGNMENTS = 5_000_000
"""The most assignments of one scan's detections that are kept in memory."""

_COUNTED = 10**18
"""Larger numbers of hypotheses are not spelled out."""

Completion = tuple[tuple[int, ...], ...]
"""Rows of left-over detections, one entry per scan, -1 where missed."""


def assignments(allowed: BoolArray) -> IntArray:
    """Every way to give each landmark (row of `allowed`) its own detection (column).

    `allowed` (n, n) masks what is possible. Returns (N, n) detections in lexicographic order.
    Raises `OptionError` beyond `MAX_ASSIGNMENTS`.

    >>> assignments(np.array([[True, True], [True, True]])).tolist()
    [[0, 1], [1, 0]]
    """
    partial = np.empty((1, 0), dtype=np.int64)
    free = np.ones((1, allowed.shape[1]), dtype=np.bool_)
    for possible in allowed:
        row, detection = np.nonzero(free & possible)
        if len(row) > MAX_ASSIGNMENTS:
            raise too_many_hypotheses(len(row))
        partial = np.column_stack([partial[row], detection])
        free = free[row]
        free[np.arange(len(row)), detection] = False
    return partial


def too_many_hypotheses(count: int) -> OptionError:
    """The error for an enumeration that would not end."""
    number = f"{count:,}" if count < _COUNTED else "10^18"
    return OptionError(
        f'method "exhaustive" would go through {number} hypotheses or more, and stops at '
        f"{MAX_HYPOTHESES:,}: rank fewer detections, lower max_missed and max_false, or label "
        "detections whose identity is known"
    )


def level_size(n_detections: tuple[int, ...], n_full: int, n_completions: int) -> int:
    """Number of associations with `n_full` landmarks seen in every scan, labels aside."""
    subsets = 1
    for count in n_detections:
        subsets *= comb(count, n_full)
    return int(subsets * factorial(n_full) ** (len(n_detections) - 1) * n_completions)


def subsets(n_detections: tuple[int, ...], size: int) -> Iterator[tuple[tuple[int, ...], ...]]:
    """Every choice of `size` detections of each scan."""
    return product(*(combinations(range(count), size) for count in n_detections))


def completions(left_over: tuple[int, ...], max_missed: int, max_false: int) -> list[Completion]:
    """Every way to sort left-over detections into partly seen landmarks and false alarms.

    `left_over` counts them by scan. A partly seen landmark misses at least one scan; all of them
    together miss at most `max_missed`, and at most `max_false` detections are false alarms.

    >>> completions((1, 1, 0), max_missed=1, max_false=1)
    [((0, 0, -1),)]
    """
    detections = [(scan, i) for scan, count in enumerate(left_over) for i in range(count)]
    n_scans = len(left_over)
    found: list[Completion] = []
    # A partly seen landmark takes at most n_scans - 1 detections and misses at least one scan.
    if len(detections) > max_false + (n_scans - 1) * max_missed:
        return found

    def extend(position: int, rows: list[list[int]], n_false: int) -> None:
        if position == len(detections):
            missed = sum(row.count(MISSED) for row in rows)
            if missed <= max_missed:
                found.append(tuple(tuple(row) for row in rows))
            if len(found) > MAX_ASSIGNMENTS:
                raise too_many_hypotheses(len(found))
            return
        scan, detection = detections[position]
        # What the scans up to this one have not seen of a row stays missed.
        if sum(row[:scan].count(MISSED) for row in rows) > max_missed:
            return
        for row in rows:
            if row[scan] == MISSED and row.count(MISSED) > 1:
                row[scan] = detection
                extend(position + 1, rows, n_false)
                row[scan] = MISSED
        opened = [MISSED] * n_scans
        opened[scan] = detection
        extend(position + 1, [*rows, opened], n_false)
        if n_false < max_false:
            extend(position + 1, rows, n_false + 1)

    extend(0, [], 0)
    return found
