"""Figures of a comparison: how often each method is right, over all scenes and against noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mht_slam.evaluation.bench.methods import (
    CEILINGS,
    GIVEN_TRUTH,
    GRAPH_EVIDENCE,
    KNOWN,
    METHODS,
    ORDER_KEEPING,
    POLYGON,
)
from mht_slam.evaluation.bench.summary import ALL, MethodSummary, Summary, rate_text
from mht_slam.evaluation.significance import Interval
from mht_slam.plotting.style import INK, TRUTH_TONE

COLUMNS = 3
"""Panels side by side."""
MARKERS = "DPXvp*"
"""Of a user's own methods, in turn."""
STYLES: dict[str, dict[str, object]] = {
    POLYGON: {"color": "#2f6fad", "marker": "s", "linestyle": "--"},
    GRAPH_EVIDENCE: {"color": INK, "marker": "o", "linestyle": "-"},
    ORDER_KEEPING: {"color": "0.55", "marker": "^", "linestyle": ":"},
    GIVEN_TRUTH: {"color": "0.75", "marker": "_", "linestyle": "-."},
}
"""The methods drawn against noise: more lines than these and the user's own are not read."""

_SIDESTEP = 0.015
_ROWS_A_PANEL = 0.32


class Captioned(NamedTuple):
    """A figure with what it shows, in words that its numbers decide."""

    title: str
    figure: Figure
    caption: str


def exact_rates_figure(summary: Summary) -> Captioned:
    """Draw each method's share of exact associations, where the order is kept and where it changes.

    Over all scenes that the method was asked about, with 95 % Wilson intervals.
    """
    rows = summary.overall
    shown = [row for row in rows if row.method != KNOWN]  # right by definition
    figure = Figure(figsize=(8.5, 1.4 + _ROWS_A_PANEL * len(shown)), layout="constrained")
    axes = figure.subplots()
    places = np.arange(len(shown), dtype=np.float64)[::-1]
    parts = (
        ("all scenes", "exact", 0.22, {"color": INK, "marker": "o"}),
        ("visual order kept", "exact_kept", 0.0, {"color": "#2f6fad", "marker": "s"}),
        ("visual order changes", "exact_changed", -0.22, {"color": TRUTH_TONE, "marker": "^"}),
    )
    for label, field, shift, style in parts:
        rates = [getattr(row, field) for row in shown]
        estimate, errors = _bars(rates)
        axes.errorbar(
            estimate, places + shift, xerr=errors, label=label, linestyle="none",
            markersize=4.5, elinewidth=0.9, **style,  # type: ignore[arg-type]
        )  # fmt: skip
    names = [f"{row.method} (ceiling)" if row.is_ceiling else row.method for row in shown]
    axes.set_yticks(places, names)
    axes.set_xlim(-0.02, 1.02)
    axes.set_xlabel("share of scenes with every association right, 95 % interval")
    axes.grid(axis="x", alpha=0.3)
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    return Captioned("How often each method is right", figure, _rates_caption(rows))


def noise_figure(summary: Summary) -> Captioned | None:
    """Draw the share of exact associations against the noise, where cells differ in nothing else.

    Angles in degrees, 95 % Wilson intervals. None where no two cells differ in noise alone.
    """
    rows = [row for row in summary.methods if row.cell != ALL]
    columns = {source.name: source.columns for source in summary.outcome.sources}
    panels = {title: cells for title, cells in _panels(columns).items() if len(cells) > 1}
    if not panels:
        return None
    n_columns = min(COLUMNS, len(panels))
    n_rows = -(-len(panels) // n_columns)
    figure = Figure(figsize=(3.4 * n_columns, 0.9 + 2.7 * n_rows), layout="constrained")
    grid = figure.subplots(n_rows, n_columns, squeeze=False, sharey=True)
    for axes in grid.flat[len(panels) :]:
        axes.set_axis_off()
    for axes, (title, cells) in zip(grid.flat, panels.items(), strict=False):
        _draw_against_noise(axes, rows, cells, summary.outcome.methods)
        axes.set_title(title, fontsize=9)
    for axes in grid[:, 0]:
        axes.set_ylabel("share exactly right,\n95 % interval")
    handles = {
        label: handle
        for axes in grid.flat
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        list(handles.values()), list(handles), loc="outside lower center",
        ncols=min(4, len(handles)), frameon=False,
    )  # fmt: skip
    return Captioned("Against the noise", figure, _noise_caption(rows, panels))


def method_styles(methods: Sequence[str]) -> dict[str, dict[str, object]]:
    """Return the drawing styles of the methods shown: the main ones and the user's own."""
    shown = {name: style for name, style in STYLES.items() if name in methods}
    own = [name for name in methods if name not in METHODS and name not in CEILINGS]
    for place, name in enumerate(own):
        marker = MARKERS[place % len(MARKERS)]
        shown[name] = {"color": TRUTH_TONE, "marker": marker, "linestyle": "-"}
    return shown


def _panels(columns: dict[str, dict[str, object]]) -> dict[str, list[tuple[float, str]]]:
    """Cells that differ in noise alone, by a title: (degrees, name of the cell)."""
    found: dict[str, list[tuple[float, str]]] = {}
    for name, own in columns.items():
        size = "epsilon_deg" if own.get("noise") == "uniform" else "sigma_deg"
        degrees = own.get(size)
        if isinstance(degrees, float):
            rest = [part for part in name.split(", ") if not _is_noise(part, own)]
            noise = "uniform noise" if size == "epsilon_deg" else "Gaussian noise"
            found.setdefault(", ".join([*rest, noise]), []).append((degrees, name))
    return {title: sorted(cells) for title, cells in found.items()}


def _is_noise(part: str, own: dict[str, object]) -> bool:
    return part.startswith((f"{own.get('noise')} epsilon ", f"{own.get('noise')} sigma "))


def _draw_against_noise(
    axes: Axes,
    rows: Sequence[MethodSummary],
    cells: Sequence[tuple[float, str]],
    methods: Sequence[str],
) -> None:
    by_name = {(row.cell, row.method): row for row in rows}
    styles = method_styles(methods)
    width = max(degrees for degrees, _ in cells)
    for place, (method, style) in enumerate(styles.items()):
        drawn = [(x, by_name[cell, method]) for x, cell in cells if (cell, method) in by_name]
        if not drawn:
            continue
        estimate, errors = _bars([row.exact for _, row in drawn])
        shift = _SIDESTEP * width * (place - 0.5 * (len(styles) - 1))
        axes.errorbar(
            np.array([x for x, _ in drawn]) + shift, estimate, yerr=errors, label=method,
            markersize=4.5, linewidth=1.2, elinewidth=0.8, **style,  # type: ignore[arg-type]
        )  # fmt: skip
    bound = any(", uniform epsilon " in name for _, name in cells)
    axes.set_xlabel("bound of the noise, deg" if bound else "standard deviation, deg")
    axes.set_ylim(-0.03, 1.03)
    axes.grid(alpha=0.25)


def _bars(rates: Sequence[Interval]) -> tuple[np.ndarray, np.ndarray]:
    estimate = np.array([rate.estimate for rate in rates], dtype=np.float64)
    low, high = (np.array([getattr(rate, end) for rate in rates]) for end in ("low", "high"))
    # Rounding may put an end a hair inside the estimate.
    return estimate, np.maximum([estimate - low, high - estimate], 0.0)


def _rates_caption(rows: Sequence[MethodSummary]) -> str:
    methods = [row for row in rows if not row.is_ceiling]
    most = max(row.scenes for row in methods)
    asked = [row for row in methods if row.scenes == most]  # the others had easier or harder ones
    best = max(asked, key=lambda row: row.exact.estimate)
    tied = [row.method for row in asked if row.exact.estimate == best.exact.estimate]
    words = [
        f"Right most often, of the methods asked about all {most} scenes: {'; '.join(tied)}, "
        f"{rate_text(best.exact)}."
    ]
    by_name = {row.method: row for row in rows}
    for name in (GRAPH_EVIDENCE, POLYGON):
        row = by_name.get(name)
        if row is not None and row.minus_order_keeping is not None:
            words.append(f"{difference_words(row)}.")
    fewer = [f"{row.method} {row.scenes}" for row in methods if row.scenes < most]
    if fewer:
        words.append(f"Asked about fewer scenes: {', '.join(fewer)}.")
    failing = [f"{row.method} {row.failures}" for row in methods if row.failures]
    if failing:
        words.append(f"Failures, counted as misses: {', '.join(failing)}.")
    changed = by_name.get(ORDER_KEEPING)
    if changed is not None and np.isfinite(changed.exact_changed.estimate):
        graph = by_name.get(GRAPH_EVIDENCE)
        if graph is not None:
            words.append(
                "Where the visual order changes, order-keeping is right in "
                f"{rate_text(changed.exact_changed)} and the graph evidence in "
                f"{rate_text(graph.exact_changed)}."
            )
    return " ".join(words)


def difference_words(row: MethodSummary) -> str:
    """Say how a method does against order-keeping, as strongly as the interval allows."""
    difference = row.minus_order_keeping
    assert difference is not None  # noqa: S101 - callers have looked
    interval = f"{difference.estimate:+.2f} [{difference.low:+.2f}, {difference.high:+.2f}]"
    p = "" if row.mcnemar_p is None else f", McNemar p = {row.mcnemar_p:.2g}"
    if difference.low > 0.0:
        verdict = "is right more often than order-keeping"
    elif difference.high < 0.0:
        verdict = "is right less often than order-keeping"
    else:
        verdict = "shows no difference to order-keeping"
    return f"{row.method[0].upper()}{row.method[1:]} {verdict} ({interval}{p})"


def _noise_caption(
    rows: Sequence[MethodSummary], panels: dict[str, list[tuple[float, str]]]
) -> str:
    by_name = {(row.cell, row.method): row for row in rows}
    exact = {key: row.exact.estimate for key, row in by_name.items()}
    ends = [(cells[0][1], cells[-1][1]) for cells in panels.values()]
    words = []
    for name in (GRAPH_EVIDENCE, POLYGON, ORDER_KEEPING):
        both = [(exact[a, name], exact[b, name]) for a, b in ends
                if (a, name) in exact and (b, name) in exact]  # fmt: skip
        if both:
            least, most = np.mean(both, axis=0).tolist()
            words.append(f"{name} {least:.2f} to {most:.2f}")
    text = f"From least to most noise, mean over {len(ends)} panels: {', '.join(words)}."
    graphs = [by_name[cell, GRAPH_EVIDENCE] for _, cell in ends if (cell, GRAPH_EVIDENCE) in exact]
    apart = [d for d in (row.minus_order_keeping for row in graphs) if d is not None]
    if apart:
        ahead, behind = sum(d.estimate > 0.0 for d in apart), sum(d.estimate < 0.0 for d in apart)
        clear = sum(d.low > 0.0 or d.high < 0.0 for d in apart)
        text += (
            f" At the most noise the graph evidence is ahead of order-keeping in {ahead} of "
            f"{len(apart)} and behind it in {behind}, by more than the 95 % interval of the paired "
            f"difference in {clear}."
        )
    return text
