"""Uncertainty and error against epsilon, after the paper's Figs. 10 and 11."""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter
from paper_measure import GRAPH, ITEMS, POLYGON, UNIT, WITH_THIRD_PAIR
from paper_outcome import COVERAGE, Outcome

PANELS = (POLYGON, WITH_THIRD_PAIR, GRAPH)
STYLES: MappingProxyType[str, dict[str, Any]] = MappingProxyType(
    {
        "O1": {"color": "#1f4e8c", "marker": "o", "linestyle": "-"},
        "O2": {"color": "#c8701a", "marker": "s", "linestyle": "--"},
        "O3": {"color": "black", "marker": "^", "linestyle": "-", "linewidth": 2.0},
        "Ld": {"color": "#3d7a3d", "marker": "D", "linestyle": ":", "markerfacecolor": "white"},
    }
)
NAMES = MappingProxyType(
    {
        "uncertainty": "uncertainty: radius of the\nsmallest circle round it, m",
        "error": "error: distance of the\nestimate from the truth, m",
    }
)
SIDESTEP = 0.11
"""Degrees between the marks of one epsilon."""
TICKS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)


def curves_figure(outcome: Outcome, measures: Sequence[str]) -> Figure:
    """Draw medians and intervals of "uncertainty" or "error", one row each, one panel a method."""
    figure = Figure(figsize=(11.0, 1.4 + 3.1 * len(measures)), layout="constrained")
    rows = figure.subplots(len(measures), len(PANELS), squeeze=False, sharex=True, sharey="row")
    for measure, panels in zip(measures, rows, strict=True):
        for method, axes in zip(PANELS, panels, strict=True):
            _draw(axes, outcome, measure, method)
        panels[0].set_ylabel(NAMES[measure])
    for axes, method in zip(rows[0], PANELS, strict=True):
        axes.set_title("graph, 95 % ellipse" if method == GRAPH else method, fontsize=10)
    for axes in rows[-1]:
        axes.set_xlabel("vision error epsilon, degrees")
    figure.legend(
        *rows[0, 0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=len(ITEMS),
        frameon=False,
    )
    lines = [
        *(caption(outcome, measure) for measure in measures),
        f"Map of the true hypothesis in F_L, |Lc Le| = {UNIT:g} m; bars hold {COVERAGE:.0%} of "
        f"{outcome.n_experiments} experiments",
    ]
    figure.suptitle("\n".join(lines), fontsize=10)
    return figure


def caption(outcome: Outcome, measure: str) -> str:
    """What the figure shows, in numbers."""
    first, last = outcome.epsilons[0], outcome.epsilons[-1]

    def ends(method: str, item: str) -> str:
        medians = (
            outcome.spread(measure, method, item, epsilon).median for epsilon in (first, last)
        )
        return "{:.1f} to {:.1f} m".format(*medians)

    far = "; ".join(f"{method} {ends(method, 'O3')}" for method in PANELS)
    return f"Median {measure} of O3 from {first:g} to {last:g} deg: {far}"


def _draw(axes: Axes, outcome: Outcome, measure: str, method: str) -> None:
    epsilons = np.array(outcome.epsilons)
    for place, item in enumerate(ITEMS):
        spreads = [outcome.spread(measure, method, item, float(epsilon)) for epsilon in epsilons]
        median, low, high = np.array(spreads).T
        axes.errorbar(
            epsilons + SIDESTEP * (place - 0.5 * (len(ITEMS) - 1)),
            median,
            yerr=[median - low, high - median],
            label=item,
            markersize=5,
            capsize=2,
            elinewidth=0.8,
            **STYLES[item],
        )
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(FixedLocator(TICKS))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.set_xticks(epsilons)
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
