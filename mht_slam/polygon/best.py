"""The best hypotheses so far, in the order of the list."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.polygon.problem import PADDING

SCORE_DECIMALS = 12

_MERGE_AT = 100_000


@dataclass(frozen=True)
class Listing:
    """What a search lists.

    Attributes
    ----------
    listed : (score, table) of the hypotheses listed, in order.
    n_scored : how many hypotheses were scored one by one.
    complete : whether nothing unlisted comes before the last one.
    bound : what no unlisted score exceeds, where the search was cut short.
    n_steps : choices of base cells bounded, intersection ratios computed, partial hypotheses
        extended and hypotheses scored.
    """

    listed: list[tuple[float, IntArray]]
    n_scored: int
    complete: bool = True
    bound: float = 0.0
    n_steps: int = 0


class Best:
    """The best `room` hypotheses so far (all where it is None), in order."""

    def __init__(self, room: int | None) -> None:
        self._room = room
        self._parts: list[tuple[FloatArray, IntArray]] = []
        self._waiting = 0
        self._threshold = -np.inf

    @property
    def threshold(self) -> float:
        """A score below which nothing can enter; -inf while there is room."""
        if self._room is not None and self._waiting > self._room // 8:
            self._merge()
        return self._threshold

    @property
    def scores(self) -> FloatArray:
        """(N,) scores in order."""
        self._merge()
        return self._parts[0][0] if self._parts else np.empty(0)

    @property
    def keys(self) -> IntArray:
        """(N, rows) row keys in the same order, filled up with `PADDING`."""
        self._merge()
        return self._parts[0][1] if self._parts else np.empty((0, 1), dtype=np.int64)

    def add(self, scores: FloatArray, keys: IntArray) -> None:
        """Add scores (N,) with the row keys (N, rows) of their tables."""
        self._parts.append((scores, keys))
        self._waiting += len(scores)
        if self._room is not None and self._waiting > max(_MERGE_AT, self._room):
            self._merge()

    def _merge(self) -> None:
        if self._waiting == 0:
            return
        width = max(keys.shape[1] for _, keys in self._parts)
        scores = np.concatenate([scores for scores, _ in self._parts])
        keys = np.concatenate(
            [
                np.pad(keys, ((0, 0), (0, width - keys.shape[1])), constant_values=PADDING)
                for _, keys in self._parts
            ]
        )
        rounded = np.round(scores, SCORE_DECIMALS)
        order = np.lexsort((*keys.T[::-1], -rounded))
        # A search that was taken up again finds what it found before.
        again = (keys[order[1:]] == keys[order[:-1]]).all(axis=1)
        order = order[np.append(True, ~again)][: self._room]
        self._parts = [(scores[order], keys[order])]
        self._waiting = 0
        if self._room is not None and len(order) == self._room:
            self._threshold = float(rounded[order[-1]])
