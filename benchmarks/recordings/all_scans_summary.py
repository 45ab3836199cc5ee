"""Tables and figure of the study of all scans."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from contenders import (
    BEARING_TRACKER,
    CEILING,
    CEILING_IN_VIEW,
    ESTIMATOR,
    HALVES,
    ORDER_KEEPING,
    ORDER_TRACKER,
)
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mht_slam.evaluation.agreement import (
    PairCounts,
    pooled,
    pooled_f1_difference,
    pooled_f1_interval,
)
from mht_slam.evaluation.significance import (
    Interval,
    mcnemar,
    paired_bootstrap,
    wilson_interval,
)

CONFIDENT = 0.9
HEADER = (
    "method",
    "options",
    "exact",
    "forgiven",
    "F1, pooled",
    "F1, pooled, without false pairs",
    "F1, mean",
    "exact, order kept",
    "exact, order changes",
    "F1, order kept",
    "F1, order changes",
    "exact minus {}",
    "McNemar p",
    "F1 minus {}",
)


@dataclass(frozen=True)
class Row:
    """One method on one run; what only the estimator has is None for the others.

    Attributes
    ----------
    exact, forgiven : of the first answer; both False where there is none.
    counts : same-landmark pairs in common, of the answer, of the truth.
    counts_labelled : the same without the answer's pairs of two detections without a label.
    top_probability : of the first answer.
    proposed, truth_rank : whether the truth is among the answers, and where, from 1.
    truth_log_evidence, best_log_evidence : of the truth and of the first answer.
    """

    set_name: str
    half: str
    run: str
    method: str
    options: str
    order_changes: bool
    exact: bool
    forgiven: bool
    counts: PairCounts
    counts_labelled: PairCounts
    top_probability: float | None
    proposed: bool | None
    truth_rank: int | None
    truth_log_evidence: float | None
    best_log_evidence: float | None
    seconds: float
    error: str | None


def summarise(rows: Sequence[Row], models: Mapping[str, str]) -> Iterator[str]:
    """Markdown: a table for each set and half, then what the estimator's probabilities mean."""
    yield "Rates have 95 % Wilson intervals, F1 and differences 95 % bootstrap intervals over runs."
    yield "F1 pooled counts the pairs of all runs together, or all but those that answers"
    yield "form of two detections without a label; F1 mean averages over runs. Options of"
    yield "baselines and ceilings have the greatest pooled F1 on the tuning half. Differences are"
    yield "to order-keeping, or else to the tracker that is the better one in the table's own half."
    for set_name in dict.fromkeys(row.set_name for row in rows):
        for half in HALVES:
            members = [row for row in rows if (row.set_name, row.half) == (set_name, half)]
            if members:
                yield from _table(set_name, half, members)
                mine = [row for row in members if row.method == ESTIMATOR]
                if mine:
                    yield f"Model of the estimator: {models[set_name]}."
                    yield from _meaning(mine)
                    yield from _failures(mine)


def _table(set_name: str, half: str, rows: Sequence[Row]) -> Iterator[str]:
    by_method = {name: [row for row in rows if row.method == name] for name in _methods(rows)}
    runs = next(iter(by_method.values()))
    changed = sum(row.order_changes for row in runs)
    reference = reference_of(rows)
    yield ""
    yield f"## {set_name}, {half} half: {len(runs)} runs"
    yield ""
    yield f"The visual order changes in {changed} of them."
    yield ""
    yield "| " + " | ".join(cell.format(reference) for cell in HEADER) + " |"
    yield "|" + " --- |" * len(HEADER)
    for method, mine in by_method.items():
        yield "| " + " | ".join([method, *_cells(mine, by_method[reference])]) + " |"
    yield ""


def _methods(rows: Iterable[Row]) -> list[str]:
    return list(dict.fromkeys(row.method for row in rows))


def reference_of(rows: Sequence[Row]) -> str:
    """Name the baseline to beat: order-keeping, or the tracker of the greater pooled F1."""
    methods = _methods(rows)
    if ORDER_KEEPING in methods:
        return ORDER_KEEPING
    trackers = [name for name in (ORDER_TRACKER, BEARING_TRACKER) if name in methods]
    return max(
        trackers,
        key=lambda name: pooled(row.counts for row in rows if row.method == name).f1,
    )


def _cells(mine: Sequence[Row], reference: Sequence[Row]) -> Iterator[str]:
    kept = [row for row in mine if not row.order_changes]
    changed = [row for row in mine if row.order_changes]
    yield mine[0].options
    yield _rate([row.exact for row in mine])
    yield _rate([row.forgiven for row in mine])
    yield _interval(_f1(mine))
    yield f"{pooled(row.counts_labelled for row in mine).f1:.3f}"
    yield f"{np.mean([row.counts.f1 for row in mine]):.3f}"
    yield _rate([row.exact for row in kept])
    yield _rate([row.exact for row in changed])
    for part in (kept, changed):
        yield f"{pooled(row.counts for row in part).f1:.3f}" if part else "-"
    if mine[0].method == reference[0].method or len(mine) < 2:
        yield from ("", "", "")
        return
    ours, theirs = [row.exact for row in mine], [row.exact for row in reference]
    yield _interval(paired_bootstrap(ours, theirs, rng=np.random.default_rng(0)), sign="+")
    yield f"{mcnemar(ours, theirs):.2g}"
    difference = pooled_f1_difference(
        [row.counts for row in mine],
        [row.counts for row in reference],
        rng=np.random.default_rng(0),
    )
    yield _interval(difference, sign="+")


def _f1(rows: Sequence[Row]) -> Interval:
    return pooled_f1_interval([row.counts for row in rows], rng=np.random.default_rng(0))


def _rate(hits: Sequence[bool]) -> str:
    if not hits:
        return "-"
    return _interval(wilson_interval(sum(hits), len(hits)))


def _interval(interval: Interval, sign: str = "") -> str:
    estimate, low, high = (f"{value:{sign}.3f}" for value in interval)
    return f"{estimate} [{low}, {high}]"


def _meaning(rows: Sequence[Row]) -> Iterator[str]:
    """How often answers are right, against how often they say they are."""
    given = [row for row in rows if row.top_probability is not None]
    if not given:
        return
    probability = np.mean([row.top_probability for row in given])
    sure = [row for row in given if (row.top_probability or 0.0) > CONFIDENT]
    seconds = np.array([row.seconds for row in given])
    yield ""
    yield f"- Mean probability of the first answer {probability:.3f}, exact in"
    yield f"  {_rate([row.exact for row in given])} of {len(given)} runs with an answer."
    yield f"- Answers of probability above {CONFIDENT:g}: {len(sure)}, exact in"
    yield f"  {_rate([row.exact for row in sure])},"
    yield f"  forgiven in {_rate([row.forgiven for row in sure])}."
    yield f"- Time of a run: median {np.median(seconds):.2f} s, longest {seconds.max():.2f} s."


def _failures(rows: Sequence[Row]) -> Iterator[str]:
    """Every wrong answer with what went wrong: no answer, never proposed, or scored lower."""
    wrong = [row for row in rows if not row.exact]
    if not wrong:
        return
    yield ""
    header = "wrong run", "forgiven", "F1", "probability", "truth's rank", "truth - best, nats"
    yield "| " + " | ".join((*header, "error")) + " |"
    yield "|" + " --- |" * 7
    for row in wrong:
        rank = "not proposed" if row.truth_rank is None else f"{row.truth_rank}"
        known = None not in (row.truth_log_evidence, row.best_log_evidence)
        nats = (row.truth_log_evidence or 0.0) - (row.best_log_evidence or 0.0)
        cells = (
            row.run,
            "yes" if row.forgiven else "no",
            f"{row.counts.f1:.3f}",
            "-" if row.top_probability is None else f"{row.top_probability:.3f}",
            rank,
            f"{nats:+.2f}" if known else "-",
            (row.error or "").replace("|", "/").replace("\n", " "),
        )
        yield "| " + " | ".join(cells) + " |"


def draw(rows: Sequence[Row]) -> Figure:
    """Pooled F1 and exact rate of every method, by set and half."""
    names = list(dict.fromkeys(row.set_name for row in rows))
    figure = Figure(figsize=(4.2 * len(names), 5.6), layout="constrained")
    panels = figure.subplots(2, len(names), squeeze=False)
    for above, below, set_name in zip(*panels, names, strict=True):
        of_set = [row for row in rows if row.set_name == set_name]
        _panel(above, of_set, _f1, "F1 over pairs, pooled")
        _panel(below, of_set, _exact, "exact associations")
        above.set_title(set_name)
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8)
    figure.suptitle("All scans of a run: 95 % intervals")
    return figure


def _exact(rows: Sequence[Row]) -> Interval:
    return wilson_interval(sum(row.exact for row in rows), len(rows))


def _panel(axes: Axes, rows: Sequence[Row], figure_of: object, label: str) -> None:
    methods = _methods(rows)
    for half, shift, marker in zip(HALVES, (0.14, -0.14), ("o", "s"), strict=True):
        for place, method in enumerate(reversed(methods)):
            mine = [row for row in rows if (row.half, row.method) == (half, method)]
            if not mine:
                continue
            estimate, low, high = figure_of(mine)  # type: ignore[operator]
            colour = {ESTIMATOR: "C0", CEILING: "0.55", CEILING_IN_VIEW: "0.55"}.get(method, "0.1")
            axes.errorbar(
                [estimate],
                [place + shift],
                xerr=[[estimate - low], [high - estimate]],
                marker=marker,
                markerfacecolor="white" if half == "tuning" else colour,
                color=colour,
                capsize=3,
                linestyle="none",
                label=f"{half} half" if place == 0 else None,
            )
    axes.set_yticks(range(len(methods)), methods[::-1], fontsize=8)
    axes.set_xlabel(label)
    axes.grid(alpha=0.25, axis="x")
