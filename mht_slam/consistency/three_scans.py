"""Every consistent association of three scans, by a depth-first search over rows.

On a line intervals share a ratio exactly when every two of them do (Helly), so the associations are
the choices of pairwise compatible options that use every detection once. Sets of options are the
bits of whole numbers, which makes a step of the search a handful of bitwise operations.

The search branches on the detection with the fewest options left, counting those less at which it
has failed before. Its running time has a heavy tail all the same, so a run that finds nothing for
long starts again with what it has learned, and with twice the patience: runs end in the end.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mht_slam.arrays import BoolArray, IntArray
from mht_slam.association import MISSED
from mht_slam.consistency.options import Options
from mht_slam.consistency.work import Work

PATIENCE = 2_000
"""Nodes without an association after which the first run starts again."""

_Node = tuple[int, list[int], int, int, tuple[int, ...]]
"""Options left, detections uncovered, misses and false alarms left, options chosen."""


def associations_of_three(
    options: Options, counts: tuple[int, int, int], max_missed: int, max_false: int, work: Work
) -> Iterator[IntArray]:
    """Each choice of `options` that is consistent and uses every detection once, exactly once.

    `counts` are the detections of the scans. Yields indices of options. The choices are all there
    are unless `work` runs out, in which case `work.exhausted` is true.
    """
    search = _Search(options, counts, max_missed, max_false)
    seen: set[tuple[int, ...]] = set()
    patience = PATIENCE
    while True:
        idle = 0
        for choice in search.run():
            if not work.spend():
                return
            idle += 1
            if choice is not None:
                idle = 0
                if choice not in seen:
                    seen.add(choice)
                    yield np.array(choice, dtype=np.int64)
            if idle > patience:
                break
        else:
            return
        patience *= 2


class _Search:
    def __init__(
        self, options: Options, counts: tuple[int, int, int], max_missed: int, max_false: int
    ) -> None:
        self._options = options
        starts = np.cumsum([0, *counts])
        self._detections = [
            frozenset((row + starts[:3])[row != MISSED].tolist()) for row in options.rows
        ]
        self._holders = [
            _bits(options.rows[:, scan] == detection)
            for scan, count in enumerate(counts)
            for detection in range(count)
        ]
        self._n_missed = options.n_missed.tolist()
        self._n_false = options.false.astype(np.int64).tolist()
        self._affordable_missed = [
            _bits(options.n_missed <= left) for left in range(min(max_missed, 2 * sum(counts)) + 1)
        ]
        self._affordable_false = [
            _bits(options.false <= left) for left in range(min(max_false, sum(counts)) + 1)
        ]
        self._failures = [1] * sum(counts)
        self._compatible: dict[int, int] = {}

    def run(self) -> Iterator[tuple[int, ...] | None]:
        """Go through the tree once; yields at each node the association it completes, or None."""
        everything = (1 << len(self._options)) - 1
        missed, false = len(self._affordable_missed) - 1, len(self._affordable_false) - 1
        start: _Node = (everything, list(range(len(self._holders))), missed, false, ())
        stack = [start]
        while stack:
            left, uncovered, missed, false, chosen = stack.pop()
            if not uncovered:
                yield tuple(sorted(chosen))
                continue
            yield None
            detection, branches = self._tightest(left, uncovered)
            if not branches:
                self._failures[detection] += 1
                continue
            children: list[_Node] = []
            while branches:
                option = (branches & -branches).bit_length() - 1
                branches &= branches - 1
                missed_left = missed - self._n_missed[option]
                false_left = false - self._n_false[option]
                children.append(
                    (
                        left
                        & self._compatible_with(option)
                        & self._affordable_missed[missed_left]
                        & self._affordable_false[false_left],
                        [d for d in uncovered if d not in self._detections[option]],
                        missed_left,
                        false_left,
                        (*chosen, option),
                    )
                )
            stack += reversed(children)

    def _tightest(self, left: int, uncovered: list[int]) -> tuple[int, int]:
        """The detection to branch on, and its options among those left."""
        best, least = uncovered[0], np.inf
        for detection in uncovered:
            count = (left & self._holders[detection]).bit_count()
            if count <= 1:
                best = detection
                break
            weighted = count / self._failures[detection]
            if weighted < least:
                best, least = detection, weighted
        return best, left & self._holders[best]

    def _compatible_with(self, option: int) -> int:
        """Options that share a ratio and no detection with this one."""
        if option not in self._compatible:
            every, row = self._options, self._options.rows[option]
            apart = ((every.rows != row) | (row == MISSED)).all(axis=1)
            meet = (every.lowest <= every.highest[option]) & (every.highest >= every.lowest[option])
            self._compatible[option] = _bits(apart & meet)
        return self._compatible[option]


def _bits(mask: BoolArray) -> int:
    """A mask as a whole number, its first entry the lowest bit."""
    return int.from_bytes(np.packbits(mask, bitorder="little").tobytes(), "little")
