"""What a comparison says: figures of every method in every cell, with intervals and tests."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from mht_slam.evaluation.bench.compare import Outcome
from mht_slam.evaluation.bench.jobs import JobResult
from mht_slam.evaluation.bench.judging import Verdict
from mht_slam.evaluation.bench.methods import CEILINGS, GRAPH_EVIDENCE, ORDER_KEEPING, POLYGON
from mht_slam.evaluation.bench.tables import forecast_of
from mht_slam.evaluation.calibration import (
    CalibrationExcess,
    Forecast,
    expected_calibration_error_excess,
    mean_brier_score,
    mean_log_score,
)
from mht_slam.evaluation.metrics import mean_reciprocal_rank, top_k_rate
from mht_slam.evaluation.significance import Interval, mcnemar, paired_bootstrap, wilson_interval

ALL = "all cells"
TOP_K = 3

_SEED = 0
"""Of bootstraps and of draws of perfect calibration: tables come out the same every time."""


@dataclass(frozen=True)
class MethodSummary:
    """One method in one cell, or in all of them. None where there is no such figure.

    Attributes
    ----------
    cell, method, is_ceiling : whose figures these are.
    scenes, failures : how many it was asked about, and on how many it failed.
    exact : share of scenes whose first association is the truth, Wilson interval.
    exact_kept, exact_changed : the same where the visual order stays, and where it changes.
    minus_order_keeping : paired difference of `exact`, bootstrap interval; None for order-keeping.
    mcnemar_p : of the same two successes.
    top_3, mean_reciprocal_rank, f1 : means over scenes.
    log_score, brier : of the probabilities, means over scenes.
    top_probability : mean of the first answers.
    calibration : expected calibration error of the first answers, with that of chance.
    map_error : mean `gospa`, baselines, bootstrap interval; None with one scene.
    tau : mean Kendall tau-b with the graph evidence, over the scenes that have one.
    """

    cell: str
    method: str
    is_ceiling: bool
    scenes: int
    failures: int
    exact: Interval
    exact_kept: Interval
    exact_changed: Interval
    minus_order_keeping: Interval | None
    mcnemar_p: float | None
    top_3: float
    mean_reciprocal_rank: float
    f1: float
    log_score: float | None
    brier: float | None
    top_probability: float | None
    calibration: CalibrationExcess | None
    map_error: Interval | None
    tau: float | None


@dataclass(frozen=True)
class Agreement:
    """How polygon score and graph evidence order associations, and who is right where they differ.

    Attributes
    ----------
    cell : whose scenes.
    scenes : on which both answered.
    tau : mean Kendall tau-b over the scenes that have one, bootstrap interval; None without.
    same_first : share of scenes where both put the same association first.
    polygon_right, graph_right, neither_right : scenes by who is right where they do not.
    mcnemar_p : of the two successes.
    """

    cell: str
    scenes: int
    tau: Interval | None
    same_first: Interval
    polygon_right: int
    graph_right: int
    neither_right: int
    mcnemar_p: float


@dataclass(frozen=True)
class Summary:
    """A comparison with its figures.

    Attributes
    ----------
    outcome : what they are of.
    methods : every method in every cell, and in all cells where there are more than one.
    agreements : of polygon score and graph evidence, for every cell that asked both.
    """

    outcome: Outcome
    methods: tuple[MethodSummary, ...]
    agreements: tuple[Agreement, ...]

    @property
    def overall(self) -> tuple[MethodSummary, ...]:
        """The figures over all cells."""
        cells = [row.cell for row in self.methods]
        return tuple(row for row in self.methods if row.cell == cells[-1])


Judged: TypeAlias = list[tuple[JobResult, Verdict]]


def summarise(outcome: Outcome) -> Summary:
    """Return the figures of a comparison, with the same intervals every time."""
    return Summary(outcome, tuple(_method_summaries(outcome)), tuple(_agreements(outcome)))


def markdown(summary: Summary) -> str:
    """Return the summary's tables as Markdown, all cells first; the same bytes every time."""
    rows = summary.methods
    lines = [
        "Rates with 95 % Wilson intervals, differences with 95 % paired bootstrap intervals.",
        "A failure counts as a miss. Ceilings know more than a method may.",
    ]
    for cell in sorted(dict.fromkeys(row.cell for row in rows), key=lambda cell: cell != ALL):
        own = [row for row in rows if row.cell == cell]
        lines += ["", f"## {cell}", "", *_table(METHOD_TITLES, [_method_cells(r) for r in own])]
        lines += ["", *_table(PROBABILITY_TITLES, [_probability_cells(r) for r in own])]
    if summary.agreements:
        lines += ["", f"## {POLYGON} against {GRAPH_EVIDENCE}", ""]
        lines += _table(AGREEMENT_TITLES, [_agreement_cells(a) for a in summary.agreements])
    return "\n".join(lines) + "\n"


def summary_rows(summary: Summary) -> list[dict[str, Any]]:
    """Return the summary as rows of plain numbers, intervals as three columns."""
    return [_flat(row) for row in summary.methods]


METHOD_TITLES = (
    "method", "scenes", "failed", "exact", "minus order-keeping", "McNemar p", "order kept",
    "order changes", f"top {TOP_K}", "MRR", "F1", "map error, baselines",
)  # fmt: skip
PROBABILITY_TITLES = (
    "method", "log score", "Brier", "mean top probability", "calibration error beyond chance",
    "tau with graph evidence",
)  # fmt: skip
AGREEMENT_TITLES = (
    "cell", "scenes", "Kendall tau-b", "same first", "polygon alone right", "graph alone right",
    "neither, and different", "McNemar p",
)  # fmt: skip


def rate_text(rate: Interval, digits: int = 2) -> str:
    """Return an estimate with its interval, "-" where there is none."""
    if not math.isfinite(rate.estimate):
        return "-"
    low, high = f"{rate.low:.{digits}f}", f"{rate.high:.{digits}f}"
    return f"{rate.estimate:.{digits}f} [{low}, {high}]"


def _method_summaries(outcome: Outcome) -> list[MethodSummary]:
    rows = []
    for cell, results in _groups(outcome):
        by_method = _by_method(results)
        asked = [method for method in outcome.methods if method in by_method]
        rows += [_summary(cell, method, by_method) for method in asked]
    return rows


def _agreements(outcome: Outcome) -> list[Agreement]:
    found = []
    for cell, results in _groups(outcome):
        by_method = _by_method(results)
        if POLYGON in by_method and GRAPH_EVIDENCE in by_method:
            found.append(_agreement(cell, by_method[POLYGON], by_method[GRAPH_EVIDENCE]))
    return found


def _groups(outcome: Outcome) -> Iterator[tuple[str, list[JobResult]]]:
    by_source: dict[str, list[JobResult]] = {source.key: [] for source in outcome.sources}
    for result in outcome.results:
        by_source[result.source].append(result)
    for source in outcome.sources:
        yield source.name, by_source[source.key]
    if len(by_source) > 1:
        yield ALL, list(outcome.results)


def _by_method(results: Sequence[JobResult]) -> dict[str, Judged]:
    found: dict[str, Judged] = {}
    for result in results:
        for verdict in result.verdicts:
            found.setdefault(verdict.method, []).append((result, verdict))
    return found


def _summary(cell: str, method: str, by_method: dict[str, Judged]) -> MethodSummary:
    judged = by_method[method]
    verdicts = [verdict for _, verdict in judged]
    ranks = [verdict.rank for verdict in verdicts]
    baseline = by_method.get(ORDER_KEEPING)
    paired = None if baseline is None or method == ORDER_KEEPING else _paired(judged, baseline)
    said = _forecasts(verdicts)
    taus = [v.tau for v in verdicts if v.tau is not None]
    return MethodSummary(
        cell=cell,
        method=method,
        is_ceiling=method in CEILINGS,
        scenes=len(verdicts),
        failures=sum(v.failure is not None for v in verdicts),
        exact=_exact(judged),
        exact_kept=_exact([pair for pair in judged if not pair[0].order_changes]),
        exact_changed=_exact([pair for pair in judged if pair[0].order_changes]),
        minus_order_keeping=None if paired is None else _difference(*paired),
        mcnemar_p=None if paired is None or not paired[0] else mcnemar(*paired),
        top_3=top_k_rate(ranks, TOP_K),
        mean_reciprocal_rank=mean_reciprocal_rank(ranks),
        f1=_mean([v.f1 for v in verdicts]),
        log_score=None if said is None else mean_log_score(said),
        brier=None if said is None else mean_brier_score(said),
        top_probability=None if said is None else _mean([_top(f) for f in said]),
        calibration=None if said is None else expected_calibration_error_excess(said, rng=_rng()),
        map_error=_difference([v.map_error for v in verdicts], [0.0] * len(verdicts)),
        tau=_mean(taus) if taus else None,
    )


def _agreement(cell: str, polygon: Judged, graph: Judged) -> Agreement:
    others = {result.key: verdict for result, verdict in graph}
    pairs = [(mine, others[result.key]) for result, mine in polygon if result.key in others]
    both = [(x, y) for x, y in pairs if x.failure is None and y.failure is None]
    apart = [(x.rank == 1, y.rank == 1) for x, y in both if x.first != y.first]
    taus = [x.tau for x, _ in both if x.tau is not None]
    return Agreement(
        cell=cell,
        scenes=len(both),
        tau=_difference(taus, [0.0] * len(taus)),
        same_first=wilson_interval(len(both) - len(apart), len(both)),
        polygon_right=sum(x and not y for x, y in apart),
        graph_right=sum(y and not x for x, y in apart),
        neither_right=sum(not x and not y for x, y in apart),
        mcnemar_p=mcnemar([x.rank == 1 for x, _ in both], [y.rank == 1 for _, y in both]),
    )


def _forecasts(verdicts: Sequence[Verdict]) -> list[Forecast] | None:
    """What a method said of its scenes; None where it does not speak in probabilities."""
    said = [forecast_of(verdict) for verdict in verdicts]
    answered = [v for v in verdicts if v.failure is None]
    if not answered or any(v.forecast is None for v in answered):
        return None
    return [forecast for forecast in said if forecast is not None]


def _paired(judged: Judged, baseline: Judged) -> tuple[list[bool], list[bool]]:
    others = {result.key: verdict.rank == 1 for result, verdict in baseline}
    both = [(v.rank == 1, others[r.key]) for r, v in judged if r.key in others]
    return [mine for mine, _ in both], [theirs for _, theirs in both]


def _difference(first: Sequence[float], second: Sequence[float]) -> Interval | None:
    return paired_bootstrap(first, second, rng=_rng()) if len(first) >= 2 else None


def _exact(judged: Judged) -> Interval:
    return wilson_interval(sum(v.rank == 1 for _, v in judged), len(judged))


def _top(forecast: Forecast) -> float:
    return max(forecast.probabilities.tolist(), default=0.0)


def _mean(figures: Sequence[float]) -> float:
    return math.fsum(figures) / len(figures)


def _rng() -> np.random.Generator:
    return np.random.default_rng(_SEED)


def _method_cells(row: MethodSummary) -> list[str]:
    difference = row.minus_order_keeping
    return [
        f"{row.method} (ceiling)" if row.is_ceiling else row.method,
        str(row.scenes),
        str(row.failures),
        rate_text(row.exact),
        "" if difference is None else _signed(difference),
        "" if row.mcnemar_p is None else f"{row.mcnemar_p:.3g}",
        rate_text(row.exact_kept),
        rate_text(row.exact_changed),
        f"{row.top_3:.2f}",
        f"{row.mean_reciprocal_rank:.2f}",
        f"{row.f1:.2f}",
        "" if row.map_error is None else rate_text(row.map_error),
    ]


def _probability_cells(row: MethodSummary) -> list[str]:
    calibration = row.calibration
    error = "" if calibration is None else f"{calibration.excess:+.3f} +- {calibration.spread:.3f}"
    figures = (row.log_score, row.brier, row.top_probability)
    numbers = ["" if figure is None else f"{figure:.3f}" for figure in figures]
    return [row.method, *numbers, error, "" if row.tau is None else f"{row.tau:.2f}"]


def _agreement_cells(row: Agreement) -> list[str]:
    return [
        row.cell,
        str(row.scenes),
        "" if row.tau is None else rate_text(row.tau),
        rate_text(row.same_first),
        str(row.polygon_right),
        str(row.graph_right),
        str(row.neither_right),
        f"{row.mcnemar_p:.3g}",
    ]


def _signed(interval: Interval) -> str:
    return f"{interval.estimate:+.2f} [{interval.low:+.2f}, {interval.high:+.2f}]"


def _table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

    return [line(titles), "|" + " --- |" * len(titles), *map(line, rows)]


def _flat(row: MethodSummary) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in vars(row).items():
        if name == "calibration":
            for part in ("error", "of_chance", "spread"):
                flat[f"calibration_{part}"] = None if value is None else getattr(value, part)
        elif isinstance(value, Interval) or name in ("minus_order_keeping", "map_error"):
            low, high = (None, None) if value is None else (value.low, value.high)
            estimate = None if value is None or math.isnan(value.estimate) else value.estimate
            flat |= {name: estimate, f"{name}_low": low, f"{name}_high": high}
        else:
            flat[name] = value
    return flat
