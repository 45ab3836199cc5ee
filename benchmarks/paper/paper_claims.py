"""What the paper says of its experiment, point by point, and whether our runs bear it out."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from paper_measure import (
    BENT,
    DEVIATION,
    GRAPH,
    ITEMS,
    LONG_STEP,
    NEAR,
    PAPER,
    POLYGON,
    VERTICES,
    WITH_THIRD_PAIR,
)
from paper_outcome import Outcome

import mht_slam as ms
from mht_slam.simulation.paper_scene import LANDMARKS, OBSERVATION_POINTS, SEEN

CLOSE = ("O1", "O2", "Ld")
FAR = "O3"
TWICE = 2.0


@dataclass(frozen=True)
class Claim:
    """A statement, when we say that it holds, and what we found.

    Attributes
    ----------
    cases : what the statement was tried on, by name, and whether it holds there.
    measured : the figures behind it.
    """

    statement: str
    criterion: str
    cases: tuple[tuple[str, bool], ...]
    measured: str

    @property
    def verdict(self) -> str:
        """Whether it holds, or the cases where it does."""
        good = [name for name, holds in self.cases if holds]
        if len(good) == len(self.cases):
            return "holds"
        return f"holds for {', '.join(good)} only" if good else "does not hold"


def claims(outcome: Outcome) -> list[Claim]:
    """Compute every claim from the rows of the study."""
    return [
        _order_swaps(outcome),
        _cells_and_hypotheses(outcome),
        _truth_is_listed(outcome),
        _truth_is_first(outcome),
        _regions_hold_the_truth(outcome),
        *(
            claim(outcome, measure)
            for measure in ("uncertainty", "error")
            for claim in (_far_point_is_worst, _far_point_is_twice_as_bad, _grows)
        ),
        _cause(
            outcome, LONG_STEP, "because the step to it is short", "that step as long as the first"
        ),
        _cause(
            outcome,
            NEAR,
            "because it is far away",
            "the run ten metres back, O3 beside the landmarks,",
        ),
        _third_pair_helps(outcome),
        _epsilon_covers_a_bent_track(outcome),
    ]


def _order_swaps(outcome: Outcome) -> Claim:
    seen = [LANDMARKS[name] for name in SEEN]
    changes = ms.order_changes(OBSERVATION_POINTS, seen)
    found = "; ".join(
        f"{' and '.join(SEEN[i] for i in change.pair)} {change.point[0]:.1f} m past O1"
        for change in changes
    )

    def share(epsilon: float) -> float:
        return float(np.mean([row.swaps for row in outcome.rankings(POLYGON, epsilon)]))

    return Claim(
        "The order of Ld and Le swaps between O1 and O2",
        "in the scans of every experiment",
        outcome.by_epsilon(lambda epsilon: share(epsilon) == 1.0),
        f"share of experiments {_range(map(share, outcome.epsilons))}; along the track: {found}",
    )


def _cells_and_hypotheses(outcome: Outcome) -> Claim:
    n = len(SEEN)
    n_pairs = math.factorial(n) ** 2

    def most(epsilon: float) -> tuple[int, int]:
        rows = outcome.rankings(POLYGON, epsilon)
        return max(row.n_cells for row in rows), max(row.n_hypotheses for row in rows)

    found = [most(epsilon) for epsilon in outcome.epsilons]
    return Claim(
        f"Two scans have at most n^2 = {n * n} cells, two pairs at most (n!)^2 = "
        f"{n_pairs} hypotheses",
        "no more in any experiment",
        outcome.by_epsilon(
            lambda epsilon: bool((np.array(most(epsilon)) <= (n * n, n_pairs)).all())
        ),
        f"at most {max(cells for cells, _ in found)} cells; the most hypotheses of positive ratio "
        f"{_steps(f'{count}' for _, count in found)}",
    )


def _truth_is_listed(outcome: Outcome) -> Claim:
    def listed(epsilon: float) -> float:
        rows = outcome.rankings(POLYGON, epsilon)
        return float(np.mean([row.truth_rank is not None for row in rows]))

    return Claim(
        "The true hypothesis has a positive ratio while errors stay inside epsilon",
        "in every experiment",
        outcome.by_epsilon(lambda epsilon: listed(epsilon) == 1.0),
        f"share of experiments {_range(map(listed, outcome.epsilons))}",
    )


def _truth_is_first(outcome: Outcome) -> Claim:
    def first(epsilon: float) -> float:
        return float(outcome.right(POLYGON, epsilon).mean())

    return Claim(
        "The true hypothesis has the greatest ratio",
        "in more than half of the experiments",
        outcome.by_epsilon(lambda epsilon: first(epsilon) > 0.5),
        f"share of experiments {_steps(f'{first(epsilon):.2f}' for epsilon in outcome.epsilons)}",
    )


def _regions_hold_the_truth(outcome: Outcome) -> Claim:
    def held(epsilon: float, method: str = POLYGON) -> float:
        return _share_held(outcome, method, epsilon, PAPER)

    vertices = (held(epsilon, VERTICES) for epsilon in outcome.epsilons)
    return Claim(
        "The regions of the true hypothesis hold the true places in F_L",
        "O1, O2, O3 and Ld in every experiment",
        outcome.by_epsilon(lambda epsilon: held(epsilon) == 1.0),
        f"share held {_range(map(held, outcome.epsilons))}; with regions from vertices alone "
        f"{_steps(f'{share:.2f}' for share in vertices)}",
    )


def _far_point_is_worst(outcome: Outcome, measure: str) -> Claim:
    def ratio(epsilon: float) -> float:
        return min(_against_far(outcome, measure, item, epsilon) for item in CLOSE)

    return Claim(
        f"The {measure} of O3 is the largest",
        "by the medians of the four",
        outcome.by_epsilon(lambda epsilon: ratio(epsilon) > 1.0),
        "O3 against the next largest "
        f"{_steps(f'{ratio(epsilon):.1f}' for epsilon in outcome.epsilons)}",
    )


def _far_point_is_twice_as_bad(outcome: Outcome, measure: str) -> Claim:
    def small(epsilon: float) -> bool:
        return all(_against_far(outcome, measure, item, epsilon) >= TWICE for item in CLOSE)

    medians = "; ".join(
        f"{item} {_medians(outcome, measure, POLYGON, item)}" for item in (*CLOSE, FAR)
    )
    return Claim(
        f"The {measure} of O1, O2 and Ld is small, that of O3 large",
        "medians at most half of O3's",
        outcome.by_epsilon(small),
        f"medians in metres: {medians}",
    )


def _grows(outcome: Outcome, measure: str) -> Claim:
    """Whether medians rise; one epsilon alone shows no growth."""
    rises = {
        item: [
            after > before
            for before, after in pairwise(
                outcome.spread(measure, POLYGON, item, epsilon).median
                for epsilon in outcome.epsilons
            )
        ]
        for item in ITEMS
    }
    found = (f"{item} {sum(steps)} of {len(steps)}" for item, steps in rises.items())
    return Claim(
        f"The {measure} grows with epsilon",
        "the median rises at every step",
        tuple((item, bool(steps) and all(steps)) for item, steps in rises.items()),
        f"steps up: {', '.join(found)}",
    )


def _cause(outcome: Outcome, track: str, reason: str, remedy: str) -> Claim:
    def medians(epsilon: float) -> tuple[float, float]:
        before, after = (
            outcome.spread("uncertainty", POLYGON, FAR, epsilon, name).median
            for name in (PAPER, track)
        )
        return before, after

    def falls(epsilon: float) -> bool:
        before, after = medians(epsilon)
        return after < before

    found = ("{:.1f} to {:.1f}".format(*medians(epsilon)) for epsilon in outcome.epsilons)
    return Claim(
        f"O3 is uncertain {reason}",
        f"with {remedy} its median uncertainty falls",
        outcome.by_epsilon(falls),
        f"metres, from and to: {_steps(found)}",
    )


def _third_pair_helps(outcome: Outcome) -> Claim:
    def median(method: str, epsilon: float) -> float:
        return outcome.spread("uncertainty", method, FAR, epsilon).median

    found = (
        f"{median(POLYGON, e):.1f} to {median(WITH_THIRD_PAIR, e):.1f} "
        f"(graph {median(GRAPH, e):.1f})"
        for e in outcome.epsilons
    )
    return Claim(
        "The pair (O1, O3) refines the map",
        "the median uncertainty of O3 at least halves",
        outcome.by_epsilon(
            lambda epsilon: TWICE * median(WITH_THIRD_PAIR, epsilon) <= median(POLYGON, epsilon)
        ),
        f"metres, from and to: {_steps(found)}",
    )


def _epsilon_covers_a_bent_track(outcome: Outcome) -> Claim:
    def held(epsilon: float) -> float:
        return _share_held(outcome, POLYGON, epsilon, BENT)

    def first(epsilon: float) -> float:
        return float(outcome.right(POLYGON, epsilon, BENT).mean())

    return Claim(
        "A larger epsilon makes up for a track that is not quite straight",
        f"O3 {DEVIATION:g} m off the line, bearings within 1 deg: the regions hold the truth",
        outcome.by_epsilon(lambda epsilon: held(epsilon) == 1.0),
        f"share held {_steps(f'{held(epsilon):.2f}' for epsilon in outcome.epsilons)}; there the "
        "true hypothesis has the greatest ratio in "
        f"{_steps(f'{first(epsilon):.2f}' for epsilon in outcome.epsilons)}",
    )


def _share_held(outcome: Outcome, method: str, epsilon: float, track: str) -> float:
    rows = [row for item in ITEMS for row in outcome.places(method, item, epsilon, track)]
    return float(np.mean([row.holds_truth for row in rows]))


def _against_far(outcome: Outcome, measure: str, item: str, epsilon: float) -> float:
    far = outcome.spread(measure, POLYGON, FAR, epsilon).median
    return far / outcome.spread(measure, POLYGON, item, epsilon).median


def _medians(outcome: Outcome, measure: str, method: str, item: str) -> str:
    found = (outcome.spread(measure, method, item, epsilon).median for epsilon in outcome.epsilons)
    return _steps(f"{value:.1f}" for value in found)


def _steps(values: Iterable[str]) -> str:
    """Figures from the smallest epsilon to the largest."""
    return ", ".join(values)


def _range(values: Iterable[float]) -> str:
    shares = list(values)
    low, high = min(shares), max(shares)
    return f"{low:.2f}" if low == high else f"{low:.2f} to {high:.2f}"
