"""Summary of the study in Markdown: claims, rankings, maps, and where the polygon method wins."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from paper_claims import Claim
from paper_measure import (
    FIRST,
    GRAPH,
    ITEMS,
    MAPPED,
    NEAR_POLYGON,
    NEAR_PRIOR,
    PAPER,
    POLYGON,
    POLYGONS,
    PRIORS,
    QUADRATURE,
    TRUE,
    WITH_THIRD_PAIR,
    model_of,
)
from paper_outcome import COVERAGE, Outcome
from scipy.stats import binomtest

from mht_slam.evaluation.significance import LEVEL, mcnemar, wilson_interval
from mht_slam.plotting.style import ELLIPSE_COVERAGE

COMPARED = (POLYGON, WITH_THIRD_PAIR, GRAPH)
"""Methods whose maps stand in tables."""


def summarise(outcome: Outcome, claims: Sequence[Claim]) -> Iterator[str]:
    """Yield the lines of the summary."""
    model = model_of(GRAPH, math.radians(outcome.epsilons[0]))
    yield "# The paper's experiment"
    yield ""
    yield (
        f"{outcome.n_experiments} experiments at each epsilon, noise uniform inside it. Medians, "
        f"with the interval that holds {COVERAGE:.0%} of the experiments; rates with {LEVEL:.0%} "
        "Wilson intervals. Metres: |Lc Le| = 10."
    )
    yield ""
    yield (
        f"Model of the graph at {outcome.epsilons[0]:g} deg; sigma is epsilon / sqrt(3) "
        f"everywhere: {model.describe()}. Quadrature has a landmark prior of "
        f"{PRIORS[QUADRATURE]:g} baselines, or of the sensor's range, {PRIORS[NEAR_PRIOR]:g}. "
        "Graph and quadrature weigh the hypotheses of positive ratio."
    )
    yield from ("", "## What the paper says, and what we find", "")
    yield from claims_table(claims)
    yield from ("", "## The true hypothesis comes first", "")
    yield from rankings_table(outcome)
    for measure, meaning in (
        ("uncertainty", "radius of the smallest circle round the region; graph: 95 % ellipse"),
        ("error", "distance from the region's centroid, or the graph's estimate, to the truth"),
    ):
        yield from ("", f"## {measure.capitalize()} in F_L, map of the true hypothesis, metres", "")
        yield f"The {measure} is the {meaning}."
        yield ""
        yield from spread_table(outcome, measure, TRUE)
    yield from ("", "## Error in F_L, map of each method's first hypothesis, metres", "")
    yield from spread_table(outcome, "error", FIRST)
    yield from (
        "",
        "## Who is nearer to the truth, the graph or the polygons",
        "",
    )
    yield "Experiments, graph : polygons; maps of the true hypothesis."
    yield ""
    yield from nearer_table(outcome)
    yield from ("", "## Share of true places inside the region or the 95 % ellipse", "")
    yield from held_table(outcome)
    yield from ("", "## Where the polygon method wins", "")
    yield from polygon_wins(outcome)


def claims_table(claims: Sequence[Claim]) -> Iterator[str]:
    """One row a claim."""
    yield "| claim | holds when | verdict | measured |"
    yield "| --- | --- | --- | --- |"
    for claim in claims:
        yield f"| {claim.statement} | {claim.criterion} | {claim.verdict} | {claim.measured} |"


def rankings_table(outcome: Outcome) -> Iterator[str]:
    """How often each method puts the truth first, and McNemar's test of polygons and graph."""
    yield from _header("method", outcome)
    for method in (*POLYGONS, *PRIORS):
        rates = []
        for epsilon in outcome.epsilons:
            right = outcome.right(method, epsilon)
            rate = wilson_interval(int(right.sum()), len(right))
            rates.append(f"{rate.estimate:.2f} [{rate.low:.2f}, {rate.high:.2f}]")
        yield _row(method, rates)
    for first, second in ((POLYGON, GRAPH), (NEAR_POLYGON, NEAR_PRIOR)):
        p_values = (
            mcnemar(outcome.right(first, epsilon), outcome.right(second, epsilon))
            for epsilon in outcome.epsilons
        )
        yield _row(f"McNemar p: {first} / {second}", [f"{p_value:.2g}" for p_value in p_values])


def spread_table(outcome: Outcome, measure: str, hypothesis: str) -> Iterator[str]:
    """Median and interval of each thing by each method."""
    yield from _header("method", outcome, "of")
    for method in COMPARED:
        for item in ITEMS:
            found = []
            for epsilon in outcome.epsilons:
                spread = outcome.spread(measure, method, item, epsilon, PAPER, hypothesis)
                found.append(f"{spread.median:.1f} [{spread.low:.1f}, {spread.high:.1f}]")
            yield _row(method, [item, *found])


def nearer_table(outcome: Outcome) -> Iterator[str]:
    """How often the graph's error is the smaller one."""
    yield from _header("than", outcome, "of")
    for method in (POLYGON, WITH_THIRD_PAIR):
        for item in ITEMS:
            counts = (nearer_counts(outcome, method, item, epsilon) for epsilon in outcome.epsilons)
            yield _row(method, [item, *(f"{graph} : {polygon}" for graph, polygon in counts)])


def nearer_counts(
    outcome: Outcome, method: str, item: str, epsilon: float, hypothesis: str = TRUE
) -> tuple[int, int]:
    """Experiments where the graph is nearer to the truth than a polygon reading, and farther."""
    graph, polygon = (
        outcome.figures("error", name, item, epsilon, PAPER, hypothesis) for name in (GRAPH, method)
    )
    return int((graph < polygon).sum()), int((graph > polygon).sum())


def held_table(outcome: Outcome) -> Iterator[str]:
    """Containment of the true places, all four together."""
    yield from _header("method", outcome)
    for method in MAPPED:
        held = (share_held(outcome, method, epsilon) for epsilon in outcome.epsilons)
        yield _row(method, [f"{share:.2f}" for share in held])


def share_held(outcome: Outcome, method: str, epsilon: float) -> float:
    """Share of true places that lie inside what a method says of them."""
    rows = [row for item in ITEMS for row in outcome.places(method, item, epsilon)]
    return float(np.mean([row.holds_truth for row in rows]))


def polygon_wins(outcome: Outcome) -> Iterator[str]:
    """Every figure in which a polygon reading beats the graph, maps only beyond chance."""
    lines = [*_wins_of_ranking(outcome), *_wins_of_maps(outcome), *_wins_of_regions(outcome)]
    yield from lines or ["- nowhere"]


def _wins_of_ranking(outcome: Outcome) -> Iterator[str]:
    for epsilon in outcome.epsilons:
        polygon, graph = (outcome.right(method, epsilon) for method in (POLYGON, GRAPH))
        if polygon.sum() > graph.sum():
            yield (
                f"- {epsilon:g} deg: the truth comes first in {polygon.sum()} of {len(polygon)}, "
                f"with the graph in {graph.sum()} (McNemar p = {mcnemar(polygon, graph):.2g})"
            )


def _wins_of_maps(outcome: Outcome) -> Iterator[str]:
    for hypothesis, method, item in product((TRUE, FIRST), (POLYGON, WITH_THIRD_PAIR), ITEMS):
        found = []
        for epsilon in outcome.epsilons:
            graph, polygon = nearer_counts(outcome, method, item, epsilon, hypothesis)
            n = graph + polygon
            if graph < polygon and binomtest(polygon, n).pvalue < 1.0 - LEVEL:
                found.append(f"{epsilon:g} deg ({polygon} of {n})")
        if found:
            yield (
                f"- map of the {hypothesis} hypothesis, {item}: {method} is nearer to the truth "
                f"than the graph at {', '.join(found)}; sign test, p < {1.0 - LEVEL:.2g} each"
            )


def _wins_of_regions(outcome: Outcome) -> Iterator[str]:
    for epsilon in outcome.epsilons:
        polygon, graph = (share_held(outcome, method, epsilon) for method in (POLYGON, GRAPH))
        if graph < ELLIPSE_COVERAGE and polygon > graph:
            yield (
                f"- {epsilon:g} deg: its regions hold {polygon:.1%} of the true places, the "
                f"graph's {ELLIPSE_COVERAGE:.0%} ellipses {graph:.1%}"
            )


def _header(first: str, outcome: Outcome, *more: str) -> Iterator[str]:
    names = [first, *more, *(f"{epsilon:g} deg" for epsilon in outcome.epsilons)]
    yield f"| {' | '.join(names)} |"
    yield f"|{' --- |' * len(names)}"


def _row(first: str, cells: Sequence[str]) -> str:
    return f"| {' | '.join([first, *cells])} |"
