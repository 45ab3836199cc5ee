"""Everything that was measured, and the quantiles of it that tables, claims and figures share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from paper_measure import PAPER, TRUE, Located, Ranked

from mht_slam.arrays import BoolArray, FloatArray

COVERAGE = 0.8
"""Share of the experiments that every interval holds: the paper's."""


class Spread(NamedTuple):
    """The median of some experiments, and what the middle 80 % of them lie between."""

    median: float
    low: float
    high: float


@dataclass(frozen=True)
class Outcome:
    """All rows of a study."""

    ranked: list[Ranked]
    located: list[Located]

    @property
    def epsilons(self) -> tuple[float, ...]:
        """Vision errors, degrees, increasing."""
        return tuple(sorted({row.epsilon_deg for row in self.ranked}))

    @property
    def n_experiments(self) -> int:
        """Experiments of each track and epsilon."""
        return 1 + max(row.experiment for row in self.ranked)

    def rankings(self, method: str, epsilon: float, track: str = PAPER) -> list[Ranked]:
        """One row per experiment, in their order."""
        return [
            row
            for row in self.ranked
            if (row.track, row.epsilon_deg, row.method) == (track, epsilon, method)
        ]

    def right(self, method: str, epsilon: float, track: str = PAPER) -> BoolArray:
        """(n,) whether the truth comes first."""
        return np.array([r.truth_rank == 1 for r in self.rankings(method, epsilon, track)])

    def places(
        self, method: str, item: str, epsilon: float, track: str = PAPER, hypothesis: str = TRUE
    ) -> list[Located]:
        """One row per experiment, in their order."""
        wanted = (track, epsilon, method, hypothesis, item)
        return [
            row
            for row in self.located
            if (row.track, row.epsilon_deg, row.method, row.hypothesis, row.item) == wanted
        ]

    def figures(
        self,
        measure: str,
        method: str,
        item: str,
        epsilon: float,
        track: str = PAPER,
        hypothesis: str = TRUE,
    ) -> FloatArray:
        """(n,) metres of "uncertainty" or "error"; a method that says nothing is infinitely off."""
        rows = self.places(method, item, epsilon, track, hypothesis)
        values = np.array([getattr(row, measure) for row in rows], dtype=np.float64)
        return np.where(np.isnan(values), np.inf, values)

    def spread(
        self,
        measure: str,
        method: str,
        item: str,
        epsilon: float,
        track: str = PAPER,
        hypothesis: str = TRUE,
    ) -> Spread:
        """Median of `figures` and the interval about it."""
        values = self.figures(measure, method, item, epsilon, track, hypothesis)
        tails = (0.5, 0.5 - 0.5 * COVERAGE, 0.5 + 0.5 * COVERAGE)
        # Infinite errors cannot be averaged with their neighbours.
        method = "linear" if np.isfinite(values).all() else "inverted_cdf"
        return Spread(*np.quantile(values, tails, method=method).tolist())

    def by_epsilon(self, holds: Callable[[float], bool]) -> tuple[tuple[str, bool], ...]:
        """Pairs of an epsilon's name and whether something holds there."""
        return tuple((f"{epsilon:g} deg", bool(holds(epsilon))) for epsilon in self.epsilons)
