"""Tables and figure of the ranking study, from its rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from statistics import median

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from measure import KINDS, LARGEST_LP, TOP_K, Row

REFERENCE_RATE = 30_000.0
"""Feasible pairs of hypotheses a second of an exhaustive ranking without tables."""

EXPECTED_PAIRS = {5: 1080.0, 7: 2e5, 8: 8e6, 10: 4e10, 12: 5e14}
"""Medians once measured on other one-sided scenes at epsilon 1 degree."""

MARKERS = {1.0: "o", 3.0: "s", 5.0: "^"}
EXACT, EXHAUSTIVE, PEER = "black", "#2f6fad", "0.6"
SECONDS_SHOWN = (2e-3, 1e6)


def summarise(rows: Sequence[Row], compiling: tuple[float, float] | None) -> Iterator[str]:
    """Markdown: times of exact ranking, then what holds over all scenes, then the targets."""
    columns = sorted({(KINDS.index(row.kind), row.epsilon_deg) for row in rows})
    titles = [f"{KINDS[kind].replace('_', '-')}, {epsilon:g} deg" for kind, epsilon in columns]
    scenes = sorted({row.n: _scenes(rows, row.n) for row in rows}.items())
    yield f"Exact ranking, first {TOP_K}: seconds of one core, median over the scenes; in brackets"
    yield "how many were certified, where not all were."
    yield ""
    yield from _table_head(["n", "scenes", *titles])
    for n, count in scenes:
        cells = [
            _seconds([r for r in rows if (r.kind, r.epsilon_deg, r.n) == (KINDS[kind], epsilon, n)])
            for kind, epsilon in columns
        ]
        yield _table_line([str(n), count, *cells])
    yield ""
    yield from _agreement(rows)
    if compiling is not None:
        yield (
            f"- Compiling: the first call on a machine takes {compiling[0]:.0f} s; once compiled, "
            f"the first call of a new process {compiling[1]:.1f} s."
        )
    yield ""
    yield from _targets([row for row in rows if row.epsilon_deg == 1.0])


def details(rows: Sequence[Row]) -> Iterator[str]:
    """Markdown: all that was measured, a line per kind, epsilon and n."""
    limits = sorted({row.work_limit for row in rows})
    yield f"Work limit {', '.join(f'{limit:,}' for limit in limits)} steps. Medians over scenes,"
    yield "times in seconds of one core, `~` extrapolated. The reference goes through 30,000"
    yield "feasible pairs of hypotheses a second."
    yield ""
    header = ["kind", "epsilon", "n", "scenes", f"exact top {TOP_K}, s", "slowest, s", "certified"]
    header += ["largest gap", "steps", "scored", "memory added, MB", "feasible pairs"]
    header += ["exhaustive, s", "exact / exhaustive", "reference, s", "exact / reference"]
    header += ["one LP, s", "all LPs, s"]
    yield from _table_head(header)
    keys = dict.fromkeys((row.kind, row.epsilon_deg, row.n) for row in rows)
    for key in keys:
        mine = [row for row in rows if (row.kind, row.epsilon_deg, row.n) == key]
        yield _table_line([*map(str, key), *_cells(mine)])


def _table_head(titles: Sequence[str]) -> Iterator[str]:
    yield _table_line(titles)
    yield "|" + " --- |" * len(titles)


def _table_line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _scenes(rows: Sequence[Row], n: int) -> str:
    """How many scenes stand behind each cell of a line."""
    seeds = {(row.kind, row.epsilon_deg): 0 for row in rows}
    for row in rows:
        seeds[row.kind, row.epsilon_deg] += row.n == n
    fewest, most = min(seeds.values()), max(seeds.values())
    return str(most) if fewest == most else f"{fewest} to {most}"


def _seconds(rows: Sequence[Row]) -> str:
    if not rows:
        return "-"
    certified = sum(row.complete for row in rows)
    text = f"{median(row.exact_seconds for row in rows):.2g}"
    return text if certified == len(rows) else f"{text} ({certified}/{len(rows)})"


def reference_seconds(row: Row) -> float | None:
    """Time at `REFERENCE_RATE`; None where the feasible pairs are unknown."""
    return None if row.feasible_pairs is None else row.feasible_pairs / REFERENCE_RATE


def all_lp_seconds(row: Row) -> float:
    """Measured, or extrapolated from the time of one program."""
    if row.lp_all_seconds is not None:
        return row.lp_all_seconds
    return row.lp_truth_seconds * math.factorial(row.n) ** 2


def _cells(rows: Sequence[Row]) -> Iterator[str]:
    seconds = [row.exact_seconds for row in rows]
    yield str(len(rows))
    yield f"{median(seconds):.3g}"
    yield f"{max(seconds):.3g}"
    yield f"{sum(row.complete for row in rows)}/{len(rows)}"
    yield f"{max(row.gap for row in rows):.2g}"
    yield f"{median(row.n_steps for row in rows):,.0f}"
    yield f"{median(row.n_scored for row in rows):,.0f}"
    yield f"{median(row.memory_growth_mb for row in rows):.0f}"
    counted = [row.feasible_pairs for row in rows if row.feasible_pairs is not None]
    yield f"{median(counted):.2g}" if counted else "-"
    yield from _against(rows, lambda row: row.exhaustive_seconds, "")
    yield from _against(rows, reference_seconds, "~")
    yield f"{median(row.lp_truth_seconds for row in rows):.2g}"
    yield ("" if rows[0].n <= LARGEST_LP else "~") + f"{median(map(all_lp_seconds, rows)):.2g}"


def _against(
    rows: Sequence[Row], seconds_of: Callable[[Row], float | None], sign: str
) -> Iterator[str]:
    """Median time of a peer, and median of the scenes' own ratios."""
    seconds = [seconds_of(row) for row in rows]
    known = [(row, s) for row, s in zip(rows, seconds, strict=True) if s is not None]
    if not known:
        yield from ("-", "-")
        return
    yield f"{sign}{median(s for _, s in known):.2g}"
    yield f"{sign}{median(row.exact_seconds / s for row, s in known):.2g}"


def _agreement(rows: Sequence[Row]) -> Iterator[str]:
    both = [row for row in rows if row.same_list is not None and row.complete]
    if both:
        same = sum(bool(row.same_list) for row in both)
        largest = max(row.largest_difference or 0.0 for row in both)
        yield (
            f"- Exact and exhaustive list the same associations in the same order in {same} of "
            f"{len(both)} scenes with a certified list; scores differ by {largest:.1g} at most."
        )
    true = sum(row.lp_truth_consistent for row in rows)
    yield f"- The linear program finds the truth consistent in {true} of {len(rows)} scenes."
    decided = [row for row in rows if row.lp_consistent is not None]
    if decided:
        equal = sum(row.lp_consistent == row.consistent for row in decided)
        yield (
            "- Linear programs and `consistent_associations` count as many consistent associations "
            f"in {equal} of {len(decided)} scenes (n to {LARGEST_LP})."
        )
    memory = max(row.memory_mb for row in rows)
    added = max(row.memory_growth_mb for row in rows)
    yield f"- Memory: at most {memory:.0f} MB; one exact ranking added at most {added:.0f} MB."


def _targets(rows: Sequence[Row]) -> Iterator[str]:
    """The targets, all at epsilon 1 degree, for both readings of an exhaustive ranking."""
    one_sided = [row for row in rows if row.kind == "one_sided"]
    annulus = [row for row in rows if row.kind == "annulus"]
    yield "Targets at epsilon 1 degree; a ratio at most its target, in brackets, meets it."
    yield ""
    for n in sorted({row.n for row in one_sided}):
        yield from _pairs_line(n, [row for row in one_sided if row.n == n])
    for name, seconds_of in (
        ("exhaustive, measured", lambda row: row.exhaustive_seconds),
        ("reference of 30,000 pairs a second, extrapolated", reference_seconds),
    ):
        at_eight = [(r.exact_seconds, s) for r in one_sided if r.n == 8 and (s := seconds_of(r))]
        if at_eight:
            ratio = median(exact / seconds for exact, seconds in at_eight)
            yield _verdict(f"one-sided n = 8 against the same scenes by {name}", ratio, 1e-3)
        at_seven = [s for row in one_sided if row.n == 7 and (s := seconds_of(row))]
        for kind, scenes, n in (("one-sided", one_sided, 12), ("annulus", annulus, 20)):
            exact = [row.exact_seconds for row in scenes if row.n == n]
            if exact and at_seven:
                what = f"{kind} n = {n} ({median(exact):.3g} s) against one-sided n = 7 by {name}"
                ratio = median(exact) / median(at_seven)
                yield _verdict(f"{what} ({median(at_seven):.3g} s)", ratio, 0.1)


def _pairs_line(n: int, rows: Sequence[Row]) -> Iterator[str]:
    """Feasible pairs against those expected, and how many of them a second are gone through."""
    pairs = [row.feasible_pairs for row in rows if row.feasible_pairs is not None]
    if not pairs:
        return
    expected = f", expected {EXPECTED_PAIRS[n]:.2g}" if n in EXPECTED_PAIRS else ""
    line = f"- one-sided n = {n}: {median(pairs):.2g} feasible pairs{expected}"
    rates = [p / row.exhaustive_seconds for row in rows
             if row.exhaustive_seconds and (p := row.feasible_pairs)]  # fmt: skip
    yield line + (f"; exhaustive {median(rates):.2g} of them a second" if rates else "")


def _verdict(what: str, ratio: float, target: float) -> str:
    return f"- {what}: {ratio:.2g}, {'met' if ratio <= target else 'NOT met'} ({target:g})"


def draw(rows: Sequence[Row]) -> Figure:
    """Median time against n: a panel per kind, a line per epsilon and method."""
    kinds = list(dict.fromkeys(row.kind for row in rows))
    figure = Figure(figsize=(4.6 * len(kinds), 5.4), layout="constrained")
    panels = figure.subplots(1, len(kinds), sharey=True, squeeze=False)[0]
    for axes, kind in zip(panels, kinds, strict=True):
        for epsilon, marker in MARKERS.items():
            mine = [row for row in rows if row.kind == kind and row.epsilon_deg == epsilon]
            if mine:
                _draw_epsilon(axes, mine, marker)
        everything = [row for row in rows if row.kind == kind]  # a program knows no epsilon
        _curve(axes, everything, all_lp_seconds, "--", PEER)
        _curve(axes, everything, lambda row: row.lp_all_seconds, "-", PEER, "D")
        axes.set(yscale="log", xlabel="landmarks n", title=kind.replace("_", "-"))
        axes.set_ylim(*SECONDS_SHOWN)
        axes.set_xticks(sorted({row.n for row in rows}))
        axes.tick_params(axis="x", labelsize=8)
        axes.grid(alpha=0.25)
    panels[0].set_ylabel("seconds of one core, median over scenes")
    figure.legend(handles=_legend(), loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    return figure


def _draw_epsilon(axes: Axes, rows: Sequence[Row], marker: str) -> None:
    _curve(axes, rows, lambda row: row.exhaustive_seconds, "-", EXHAUSTIVE, marker)
    _curve(axes, rows, reference_seconds, "--", EXHAUSTIVE)
    n, seconds = _medians(rows, lambda row: row.exact_seconds)
    axes.plot(n, seconds, "-", color=EXACT, linewidth=1.4, zorder=3)
    for size, second in zip(n, seconds, strict=True):
        certified = all(row.complete for row in rows if row.n == size)
        axes.plot(size, second, marker, color=EXACT, markersize=7, zorder=3,
                  markerfacecolor=EXACT if certified else "white")  # fmt: skip


def _curve(
    axes: Axes,
    rows: Sequence[Row],
    seconds_of: Callable[[Row], float | None],
    style: str,
    color: str,
    marker: str = "",
) -> None:
    n, seconds = _medians(rows, seconds_of)
    axes.plot(n, seconds, style, marker=marker, color=color, markersize=4, linewidth=1.1, zorder=4)


def _medians(
    rows: Sequence[Row], seconds_of: Callable[[Row], float | None]
) -> tuple[list[int], list[float]]:
    sizes, medians = [], []
    for n in sorted({row.n for row in rows}):
        seconds = [s for row in rows if row.n == n and (s := seconds_of(row)) is not None]
        if seconds:
            sizes.append(n)
            medians.append(median(seconds))
    return sizes, medians


def _legend() -> list[Line2D]:
    def line(label: str, **style: object) -> Line2D:
        return Line2D([], [], label=label, **style)  # type: ignore[arg-type]

    return [
        line(f"exact, first {TOP_K}", color=EXACT),
        line("exact, not all certified", color=EXACT, marker="o", markerfacecolor="white"),
        line("exhaustive", color=EXHAUSTIVE),
        line("30,000 feasible pairs a second", color=EXHAUSTIVE, linestyle="--"),
        line("all linear programs", color=PEER, marker="D", markersize=4),
        line("linear programs, extrapolated", color=PEER, linestyle="--"),
        *(
            line(f"epsilon {epsilon:g} deg", color="0.3", marker=marker, linestyle="")
            for epsilon, marker in MARKERS.items()
        ),
    ]
