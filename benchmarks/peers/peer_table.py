"""The table of a comparison with peers: rates, paired differences to our graph, ratios of times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from statistics import median

import numpy as np
from peer_registry import Peer

from mht_slam.evaluation.bench.compare import Outcome
from mht_slam.evaluation.bench.jobs import CANDIDATES, JobResult
from mht_slam.evaluation.bench.methods import CEILINGS, GRAPH_EVIDENCE, KNOWN
from mht_slam.evaluation.bench.summary import rate_text
from mht_slam.evaluation.significance import Interval, mcnemar, paired_bootstrap, wilson_interval

TITLES = (
    "method", "told", "scenes", "failed", "exact", "minus graph evidence", "McNemar p",
    "order kept", "order changes", "time / refine",
)  # fmt: skip
OURS = "bearings only (ours)"
CEILING = "truth (ceiling)"
PREAMBLE = (
    "Rates with 95 % Wilson intervals, differences with 95 % paired bootstrap intervals. An",
    "exception or an empty answer is a failure, and a miss. Times are medians over the scenes of",
    "the ratio to `refine` of the shared candidates, the row *graph evidence*, in the same",
    "process.",
)


def markdown_table(outcome: Outcome, peers: Mapping[str, Peer]) -> str:
    """Return one table per cell, with every registered peer, installed or not."""
    lines = list(PREAMBLE)
    for source in outcome.sources:
        results = [result for result in outcome.results if result.source == source.key]
        seconds = [times.seconds for times in outcome.times if times.source == source.key]
        lines += ["", f"### {source.name}", "", _line(TITLES), "|" + " --- |" * len(TITLES)]
        lines += [_line(cells) for cells in _rows(outcome.methods, results, seconds, peers)]
    return "\n".join(lines)


def _rows(
    methods: Sequence[str],
    results: Sequence[JobResult],
    seconds: Sequence[Mapping[str, float]],
    peers: Mapping[str, Peer],
) -> Iterator[list[str]]:
    right = {name: [_is_right(result, name) for result in results] for name in methods}
    for name in (m for m in methods if m != KNOWN):  # right by definition
        told = _told(name, peers)
        failed = sum(v.failure is not None for r in results for v in r.verdicts if v.method == name)
        cells = [name, told, str(len(results)), str(failed), rate_text(_rate(right[name]))]
        cells += (
            _difference(right[name], right[GRAPH_EVIDENCE]) if name != GRAPH_EVIDENCE else ["", ""]
        )
        for changes in (False, True):
            part = [
                hit
                for hit, r in zip(right[name], results, strict=True)
                if r.order_changes == changes
            ]
            cells.append(f"{rate_text(_rate(part))} of {len(part)}")
        yield [*cells, _time_ratio(name, seconds)]
    yield ["finding the candidates", OURS, *[""] * 7, _time_ratio(CANDIDATES, seconds)]
    for name, found in peers.items():
        if name not in methods:
            yield [name, found.tier, f"not installed: {', '.join(found.missing)}", *[""] * 7]


def _told(name: str, peers: Mapping[str, Peer]) -> str:
    if name in CEILINGS:
        return CEILING
    return peers[name].tier if name in peers else OURS


def _is_right(result: JobResult, method: str) -> bool:
    return any(v.method == method and v.rank == 1 for v in result.verdicts)


def _rate(right: Sequence[bool]) -> Interval:
    return wilson_interval(sum(right), len(right))


def _difference(right: Sequence[bool], reference: Sequence[bool]) -> list[str]:
    if len(right) < 2:
        return ["", ""]
    d = paired_bootstrap(right, reference, rng=np.random.default_rng(0))
    text = f"{d.estimate:+.2f} [{d.low:+.2f}, {d.high:+.2f}]"
    return [text, f"{mcnemar(right, reference):.2g}"]


def _time_ratio(name: str, seconds: Sequence[Mapping[str, float]]) -> str:
    """Median of the ratios to `refine` of the shared candidates; "" where no time was taken."""
    ratios = [taken[name] / taken[GRAPH_EVIDENCE] for taken in seconds if name in taken]
    return f"{median(ratios):.2g}" if ratios else ""


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
