"""Figure (c): polygon score against graph evidence, one mark per hypothesis."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mht_slam.association import Association
from mht_slam.comparison import Comparison, ComparisonRow
from mht_slam.plotting.labels import place_labels
from mht_slam.plotting.style import INK, TRUTH_TONE

EVIDENCE_SHOWN = 30.0
"""Nats below the best hypothesis at which the axis ends; exp(-30) is no probability."""

LABELLED = 5
"""How many of the first by either score are labelled with both ranks."""


def comparison_figure(comparison: Comparison, truth: Association | None = None) -> Figure:
    """Draw polygon score against the graph's log evidence relative to the best.

    Hypotheses more than `EVIDENCE_SHOWN` nats below the best, or without an estimate, stand as
    triangles on the floor, and the legend says how many they are. The first few others by either
    score carry "polygon rank | evidence rank"; the truth, where given and listed, is a star. Rows
    without a polygon score are left out and counted in the title.

    Source: docs/method.md, sections 3 and 4.
    """
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    axes = figure.subplots()
    rows = [row for row in comparison.rows if row.polygon_score is not None]
    if not rows:
        axes.text(0.5, 0.5, "no hypothesis with both scores", ha="center", va="center")
        axes.set_axis_off()
        return figure
    best = max((row.log_evidence for row in comparison.rows), default=-math.inf)
    relative = np.array(
        [row.log_evidence - best if math.isfinite(row.log_evidence) else -math.inf for row in rows]
    )
    scores = np.array([row.polygon_score for row in rows], dtype=np.float64)
    true = np.array([truth is not None and row.association.exact(truth) for row in rows])
    lowest = float(relative[relative >= -EVIDENCE_SHOWN].min(initial=-1.0))
    floor = lowest - 0.12 * (1.0 - lowest)
    below = relative < -EVIDENCE_SHOWN
    heights = np.where(below, floor, relative)
    axes.plot(scores[~below & ~true], heights[~below & ~true], "o", color="0.45",
              markeredgecolor=INK, markersize=7, label="hypothesis")  # fmt: skip
    if below.any():
        axes.plot(scores[below & ~true], heights[below & ~true], "v", color="white",
                  markeredgecolor=INK, markersize=8,
                  label=_floor_label(int(below.sum()), rows))  # fmt: skip
    if true.any():
        axes.plot(scores[true], heights[true], "*", color=TRUTH_TONE, markeredgecolor=INK,
                  markersize=15, label="truth")  # fmt: skip
    _set_limits(axes, scores, floor if below.any() else lowest)
    if below.any():
        axes.axhline(0.5 * (floor + lowest), color="0.6", linewidth=0.8, linestyle=":")
    axes.set_xlabel("polygon score (geometric mean of intersection ratios)")
    axes.set_ylabel("graph log evidence relative to the best, nats")
    axes.set_title(_title(comparison, len(comparison.rows) - len(rows)), fontsize=11)
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    labelled = [i for i, row in enumerate(rows) if _is_top(row) and (true[i] or not below[i])]
    points = np.column_stack([scores, heights])
    place_labels(axes, points[labelled], [_ranks(rows[i]) for i in labelled], avoid=points)
    return figure


def _set_limits(axes: Axes, scores: np.typing.NDArray[np.float64], bottom: float) -> None:
    widest = float(scores.max()) or 1.0
    axes.set_xlim(-0.05 * widest, 1.12 * widest)
    height = max(1.0, -bottom)
    axes.set_ylim(bottom - 0.08 * height, 0.12 * height)
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def _is_top(row: ComparisonRow) -> bool:
    by_polygon = row.polygon_rank is not None and row.polygon_rank <= LABELLED
    return by_polygon or row.evidence_rank <= LABELLED


def _ranks(row: ComparisonRow) -> str:
    polygon = "–" if row.polygon_rank is None else f"{row.polygon_rank}"  # noqa: RUF001
    return f"{polygon} | {row.evidence_rank}"


def _floor_label(n_below: int, rows: list[ComparisonRow]) -> str:
    n_failed = sum(not math.isfinite(row.log_evidence) for row in rows)
    failed = f", {n_failed} of them without an estimate" if n_failed else ""
    return f"{n_below} more than {EVIDENCE_SHOWN:g} nats below{failed}"


def _title(comparison: Comparison, n_unscored: int) -> str:
    first = "the same hypothesis" if comparison.top1_agree else "different hypotheses"
    tau = comparison.kendall_tau
    agreement = "" if tau is None else f", Kendall's tau {tau:.2f}"
    lines = [
        f"The two scores put {first} first{agreement}",
        "labels: polygon rank | evidence rank",
    ]
    if n_unscored:
        lines.append(f"{n_unscored} hypotheses without a polygon score are left out")
    return "\n".join(lines)
