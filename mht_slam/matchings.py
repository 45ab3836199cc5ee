"""Matchings of rows with columns: the best, the next, and so on; the best that keep the order."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from typing import TypeAlias

import numpy as np
from scipy.optimize import linear_sum_assignment

from mht_slam.arrays import FloatArray

Matches: TypeAlias = tuple[tuple[int, int], ...]
"""(row, column) pairs, sorted by row."""


def best_matching(gains: FloatArray) -> tuple[Matches, float]:
    """Return the matching of most gain and its gain, without pairs of gain zero.

    `gains` (r, d) are not negative: what a match saves against leaving both alone.
    """
    rows, columns = linear_sum_assignment(gains, maximize=True)
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return tuple(sorted(p for p in pairs if gains[p] > 0.0)), float(gains[rows, columns].sum())


def ranked_matchings(gains: FloatArray) -> Iterator[tuple[Matches, float]]:
    """Yield all matchings of positive gain and the empty one, with their gains, the best first.

    `gains` (r, d) are not negative; a pair of gain zero is not matched. Source: Murty, "An
    Algorithm for Ranking all the Assignments in Order of Increasing Cost" (1968): the matchings
    that are left fall into those that keep the first i matches of the best and lack the next.
    """
    serial = 0
    best, gain = best_matching(gains)
    heap: list[tuple[float, Matches, int, FloatArray, Matches]] = [(-gain, best, serial, gains, ())]
    while heap:
        negative, matches, _, allowed, forced = heapq.heappop(heap)
        yield matches, -negative
        kept: Matches = forced
        for match in matches:
            if match in forced:
                continue
            without = allowed.copy()
            without[match] = 0.0
            for row, column in kept:
                without[row, :] = 0.0
                without[:, column] = 0.0
            others, gain = best_matching(without)
            held = sum(float(gains[pair]) for pair in kept)
            serial += 1
            whole = tuple(sorted((*kept, *others)))
            heapq.heappush(heap, (-(gain + held), whole, serial, without, kept))
            kept = (*kept, match)


def best_in_order(gains: FloatArray, *, cyclic: bool = False) -> Matches:
    """Return the matching of most gain whose columns follow each other as the rows do.

    With `cyclic` the columns may begin anywhere and go on from the last with the first. `gains`
    (r, d) are not negative. By dynamic programming over rows and columns, for all beginnings at
    once: the most gain of the first i rows and j columns comes from leaving out the last row, or
    the last column, or from matching both.
    """
    n, m = gains.shape
    columns = np.arange(m)
    turned = (columns[:, None] + columns) % m if cyclic else columns[None]
    if not n or not m:
        return ()
    best = np.zeros((n + 1, len(turned), m + 1))
    for i in range(n):
        matched = best[i, :, :-1] + gains[i][turned]
        best[i + 1, :, 1:] = np.maximum(best[i, :, 1:], matched)
        best[i + 1] = np.maximum.accumulate(best[i + 1], axis=1)
    start = int(np.argmax(best[n, :, m]))
    table, order = best[:, start], turned[start].tolist()
    pairs = []
    i, j = n, m
    while i and j:
        if table[i, j] == table[i - 1, j]:
            i -= 1
        elif table[i, j] == table[i, j - 1]:
            j -= 1
        else:
            i, j = i - 1, j - 1
            pairs.append((i, order[j]))
    return tuple(reversed(pairs))
