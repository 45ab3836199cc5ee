"""Figures of a comparison: reliability, polygons against graphs, and time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mht_slam.evaluation.bench.jobs import CANDIDATES
from mht_slam.evaluation.bench.methods import CEILINGS, GRAPH_EVIDENCE, ORDER_KEEPING, POLYGON
from mht_slam.evaluation.bench.summary import Agreement, Summary, rate_text
from mht_slam.evaluation.bench.tables import forecast_of
from mht_slam.evaluation.calibration import Forecast
from mht_slam.plotting.bench_rates import Captioned, method_styles
from mht_slam.plotting.reliability import draw_reliability_curve
from mht_slam.plotting.style import INK, TRUTH_TONE

FEWEST = 8
"""Candidates of a bin that is drawn; a curve breaks at bins with fewer."""
N_BINS = 5
CERTAIN = (ORDER_KEEPING, "nearest bearing")
"""Methods that state certainty, of which no curve can be drawn."""

_LIKELIHOOD = "graph likelihood"
_LIKELIHOOD_STYLE: dict[str, object] = {"color": "#7a7a7a", "marker": "v", "linestyle": "-."}
_SIDESTEP = 0.008
_WORK = {CANDIDATES: "finding the candidates"}


def reliability_figure(summary: Summary) -> Captioned | None:
    """Draw how often candidates of a stated probability were true, with 95 % Wilson intervals.

    None where no method states probabilities.
    """
    said = _said(summary)
    if not said:
        return None
    styles = {_LIKELIHOOD: _LIKELIHOOD_STYLE, **method_styles(summary.outcome.methods)}
    figure = Figure(figsize=(6.0, 5.6), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="0.85", linewidth=5, zorder=1, solid_capstyle="butt",
              label="perfect calibration")  # fmt: skip
    shown = [name for name in styles if name in said]
    for place, name in enumerate(shown):
        sidestep = _SIDESTEP * (place - 0.5 * (len(shown) - 1))
        draw_reliability_curve(axes, said[name], name, styles[name], fewest=FEWEST, n_bins=N_BINS,
                               sidestep=sidestep)  # fmt: skip
    axes.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), aspect="equal",
             xlabel="stated probability of a candidate",
             ylabel="share of such candidates that were true, 95 % interval")  # fmt: skip
    axes.grid(alpha=0.25)
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    return Captioned("Do probabilities come true", figure, _reliability_caption(summary, shown))


def agreement_figure(summary: Summary) -> Captioned | None:
    """Draw, cell by cell, how polygon and graph agree, and who is right where they do not.

    None where one of the two took no part.
    """
    found = [row for row in summary.agreements if row.scenes]
    if not found:
        return None
    height = 1.6 + 0.36 * len(found)
    figure = Figure(figsize=(9.5, height), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(found), dtype=np.float64)[::-1]
    _draw_taus(left, found, places)
    start = np.zeros(len(found))
    parts = (
        ("polygon alone right", "polygon_right", "#2f6fad", ""),
        ("graph alone right", "graph_right", "0.25", ""),
        ("neither", "neither_right", "0.85", "//"),
    )
    for label, field, tone, hatch in parts:
        shares = np.array([getattr(row, field) / row.scenes for row in found])
        right.barh(places, shares, left=start, color=tone, hatch=hatch, edgecolor=INK,
                   linewidth=0.6, height=0.6, label=label)  # fmt: skip
        start += shares
    low, high = (np.array([1.0 - getattr(row.same_first, end) for row in found])
                 for end in ("high", "low"))  # fmt: skip
    right.errorbar(start, places, xerr=np.maximum([start - low, high - start], 0.0),
                   linestyle="none", color=TRUTH_TONE, elinewidth=0.9)  # fmt: skip
    right.set_xlabel("share of scenes where they name\ndifferent associations, 95 % interval")
    right.set_xlim(0.0, 1.02)
    right.grid(axis="x", alpha=0.3)
    left.set_yticks(places, [f"{row.cell} ({row.scenes})" for row in found])
    left.set_ylim(-0.7, len(found) - 0.3)
    left.tick_params(axis="y", labelsize=8)
    bars = right.containers[: len(parts)]
    figure.legend(bars, [label for label, *_ in parts], loc="outside lower center", ncols=3,
                  frameon=False)  # fmt: skip
    return Captioned(
        "Where polygon score and graph evidence differ", figure, _agreement_caption(found[-1])
    )


def times_figure(summary: Summary) -> Captioned:
    """Draw the time of each method on a scene: median, and the range of half of the scenes."""
    taken: dict[str, list[float]] = {}
    for times in summary.outcome.times:
        for method, seconds in times.seconds.items():
            if method not in CEILINGS:
                taken.setdefault(method, []).append(max(1e3 * seconds, 1e-3))
    quartiles = {name: np.percentile(ms, [25, 50, 75]) for name, ms in taken.items()}
    figure = Figure(figsize=(8.5, 1.1 + 0.3 * len(quartiles)), layout="constrained")
    axes = figure.subplots()
    places = np.arange(len(quartiles), dtype=np.float64)[::-1]
    middle = np.array([q[1] for q in quartiles.values()])
    errors = [[q[1] - q[0] for q in quartiles.values()], [q[2] - q[1] for q in quartiles.values()]]
    axes.errorbar(middle, places, xerr=errors, linestyle="none", marker="o", color=INK,
                  markersize=4.5, elinewidth=0.9)  # fmt: skip
    axes.set_xscale("log")
    axes.set_yticks(places, [_WORK.get(name, name) for name in quartiles])
    axes.set_xlabel("time on one scene, ms: median, and the range of half of the scenes")
    axes.grid(axis="x", alpha=0.3)
    return Captioned("Time", figure, _times_caption(quartiles))


def _said(summary: Summary) -> dict[str, list[Forecast]]:
    """Forecasts by method, of those that state probabilities with candidates."""
    stating = {
        row.method
        for row in summary.overall
        if row.log_score is not None and not row.is_ceiling and row.method not in CERTAIN
    }
    found: dict[str, list[Forecast]] = {}
    for result in summary.outcome.results:
        for verdict in result.verdicts:
            forecast = forecast_of(verdict)
            if verdict.method in stating and forecast is not None:
                found.setdefault(verdict.method, []).append(forecast)
    return found


def _draw_taus(axes: Axes, found: Sequence[Agreement], places: np.ndarray) -> None:
    taus = [(place, row.tau) for place, row in zip(places, found, strict=True)]
    known = [(place, tau) for place, tau in taus if tau is not None]
    if known:
        middle = np.array([tau.estimate for _, tau in known])
        low, high = (np.array([getattr(tau, end) for _, tau in known]) for end in ("low", "high"))
        axes.errorbar(middle, [place for place, _ in known],
                      xerr=np.maximum([middle - low, high - middle], 0.0), linestyle="none",
                      marker="o", color=INK, markersize=4.5, elinewidth=0.9)  # fmt: skip
    axes.axvline(0.0, color=TRUTH_TONE, linewidth=0.8, linestyle=":")
    axes.set_xlim(-1.05, 1.05)
    axes.set_xlabel("Kendall tau-b of the two orders,\n95 % interval")
    axes.grid(axis="x", alpha=0.3)


def _reliability_caption(summary: Summary, shown: Sequence[str]) -> str:
    words = []
    for row in summary.overall:
        calibration = row.calibration
        if row.method in shown and calibration is not None:
            beyond = calibration.excess > 2.0 * calibration.spread
            verdict = "beyond chance" if beyond else "within what a perfect forecaster shows"
            words.append(
                f"{_capital(row.method)}: calibration error of first answers "
                f"{calibration.error:.3f}, "
                f"chance alone {calibration.of_chance:.3f} ({verdict}), "
                f"log score {row.log_score:.2f} nats."
            )
    if words:
        words.append(f"Bins with fewer than {FEWEST} candidates are left out.")
    return " ".join(words)


def _agreement_caption(row: Agreement) -> str:
    apart = row.polygon_right + row.graph_right + row.neither_right
    tau = "" if row.tau is None else f", mean tau-b {rate_text(row.tau)}"
    words = [
        f"{_capital(POLYGON)} and {GRAPH_EVIDENCE} name the same association in "
        f"{rate_text(row.same_first)} of {row.scenes} scenes{tau}."
    ]
    if apart:
        if row.mcnemar_p >= 0.05:
            verdict = "which is no evidence that either is right more often"
        elif row.graph_right > row.polygon_right:
            verdict = "so the graph is right more often"
        else:
            verdict = "so the polygons are right more often"
        words.append(
            f"Of the other {apart}, the polygons alone are right in {row.polygon_right}, the "
            f"graph alone in {row.graph_right} and neither in {row.neither_right}: {verdict} "
            f"(McNemar p = {row.mcnemar_p:.2g})."
        )
    words.append(
        "In brackets: scenes that both answered. A cell shows a tau where in two scenes or more "
        "both list the same two associations."
    )
    return " ".join(words)


def _times_caption(quartiles: dict[str, np.ndarray]) -> str:
    middle = {name: float(q[1]) for name, q in quartiles.items()}
    slowest, quickest = max(middle, key=middle.__getitem__), min(middle, key=middle.__getitem__)
    words = (
        f"What takes longest at the median is {_WORK.get(slowest, slowest)} with "
        f"{_ms(middle[slowest])}; the quickest is {_WORK.get(quickest, quickest)} with "
        f"{_ms(middle[quickest])}."
    )
    if POLYGON in middle and GRAPH_EVIDENCE in middle:
        ratio = middle[GRAPH_EVIDENCE] / middle[POLYGON]
        words += f" The graph evidence takes {ratio:.2g} times as long as {POLYGON}"
        words += ", candidates aside." if CANDIDATES in middle else "."
    return words


def _ms(time: float) -> str:
    return f"{time:.0f} ms" if time >= 100.0 else f"{time:.2g} ms"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
