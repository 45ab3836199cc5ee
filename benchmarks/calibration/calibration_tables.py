"""Tables of the calibration study, from its rows: targets, scorers side by side, polygon seeds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from calibration_cells import Cell
from calibration_scores import LAPLACE, MARGINAL, ORDER, QUADRATURE, SCORERS, SEED_SPREADS, Row

from mht_slam.evaluation.calibration import (
    CalibrationExcess,
    Forecast,
    expected_calibration_error_excess,
    mean_brier_score,
    mean_log_score,
    top_forecast,
    total_variation,
)
from mht_slam.evaluation.metrics import top_k_rate
from mht_slam.evaluation.significance import Interval, paired_bootstrap, wilson_interval

LARGEST_EXCESS = 0.02
LARGEST_DIFFERENCE = 0.03
LARGEST_VARIATION = 0.02
ENOUGH_SCENES = 2000
"""With fewer a cell is shown and not judged: chance hides what the targets ask for."""
SEEDS = (10, 50, 200)

_SEED = 0
"""Of the draws of perfect calibration and of the bootstrap."""


def summarise(cells: Sequence[Cell], rows: Sequence[Row]) -> Iterator[str]:
    """Markdown: targets, then every scorer in every cell, then the truth among polygon seeds."""
    by_cell = {cell: [row for row in rows if row.cell == cell.name] for cell in cells}
    done = {cell: mine for cell, mine in by_cell.items() if mine}
    yield "Laplace evidence against quadrature, and the calibration of both. Calibration errors are"
    yield "those of the first answers minus their mean under simulated perfect calibration, +- one"
    yield "standard deviation of that."
    yield ""
    yield from _targets(done)
    yield ""
    yield "All scorers over the same candidates. Rates with 95 % Wilson intervals."
    yield ""
    yield from _scorers(done)
    yield ""
    yield "Share of scenes whose truth is among the first k of the polygon ranking."
    yield ""
    yield from _seeds(done)


def forecasts(rows: Sequence[Row], scorer: str) -> list[Forecast]:
    """What a scorer said of the scenes it was asked about; a failed one said nothing."""
    return [
        Forecast(said, row.truth if said else None)
        for row in rows
        if (said := row.probabilities.get(scorer)) is not None
    ]


def _targets(done: dict[Cell, list[Row]]) -> Iterator[str]:
    titles = ["cell", "scenes", "candidates", "truth listed", "order changes"]
    titles += ["laplace - quadrature, top-1", "mean total variation, laplace"]
    titles += ["mean total variation, marginal (scenes)", "excess, laplace", "excess, quadrature"]
    titles += ["excess where listed, laplace", "targets, laplace"]
    yield from _table_head(titles)
    for cell, rows in done.items():
        if not cell.from_model:
            continue
        listed = [row for row in rows if row.truth is not None]
        excess = _excess(forecasts(rows, LAPLACE))
        where_listed = _excess(forecasts(listed, LAPLACE))
        exact = forecasts(rows, QUADRATURE)
        sizes = [len(row.probabilities[LAPLACE]) for row in rows]
        cells = [cell.name, str(len(rows)), f"{np.mean(sizes):.1f}"]
        cells += [_rate(len(listed), len(rows)), f"{np.mean([r.order_changes for r in rows]):.2f}"]
        if exact:
            difference, variation = _difference(rows), _variation(rows, LAPLACE)
            sampled = [row for row in rows if MARGINAL in row.probabilities]
            marginal = f"{_variation(sampled, MARGINAL):.4f} ({len(sampled)})" if sampled else "-"
            cells += [_signed(difference), f"{variation:.4f}", marginal, _spread(excess)]
            cells += [_spread(_excess(exact)), _spread(where_listed)]
            cells += [_verdict(excess, difference, variation, len(rows))]
        else:
            cells += ["-", "-", "-", _spread(excess), "-", _spread(where_listed)]
            cells += [_verdict(excess, None, None, len(rows))]
        yield _table_line(cells)


def _scorers(done: dict[Cell, list[Row]]) -> Iterator[str]:
    titles = ["cell", "scorer", "scenes", "top-1", "mean top probability", "excess, first answers"]
    titles += ["excess, all candidates", "log score", "Brier"]
    yield from _table_head(titles)
    for cell, rows in done.items():
        for scorer in SCORERS:
            said = forecasts(rows, scorer)
            if not said:
                continue
            top = top_forecast(said)
            yield _table_line(
                [
                    cell.name,
                    scorer,
                    str(len(said)),
                    _rate(round(top.accuracy * len(said)), len(said)),
                    f"{top.mean_probability:.3f}",
                    _spread(_excess(said)),
                    f"{_excess_of_all(said):+.3f}",
                    "-" if scorer == ORDER else f"{mean_log_score(said):.3f}",
                    f"{mean_brier_score(said):.3f}",
                ]
            )


def _seeds(done: dict[Cell, list[Row]]) -> Iterator[str]:
    columns = [(i, spread, k) for i, spread in enumerate(SEED_SPREADS) for k in SEEDS]
    titles = [f"{spread:g} sigma, k = {k}" for _, spread, k in columns]
    yield from _table_head(["cell", "scenes", *titles, f"any of them, k = {SEEDS[1]} each"])
    for cell, rows in done.items():
        rates = [top_k_rate([row.seed_rank[i] for row in rows], k) for i, _, k in columns]
        first = [min((rank for rank in row.seed_rank if rank), default=None) for row in rows]
        rates.append(top_k_rate(first, SEEDS[1]))
        yield _table_line([cell.name, str(len(rows)), *(f"{rate:.3f}" for rate in rates)])


def _difference(rows: Sequence[Row]) -> Interval:
    """Top-1 of Laplace minus that of quadrature, paired."""
    right = [
        [forecast.truth is not None and forecast.top == forecast.truth for forecast in said]
        for said in (forecasts(rows, LAPLACE), forecasts(rows, QUADRATURE))
    ]
    return paired_bootstrap(*right, rng=np.random.default_rng(_SEED))


def _variation(rows: Sequence[Row], scorer: str) -> float:
    """Mean total variation between a scorer and quadrature; 1 where one of them failed."""
    variations = []
    for row in rows:
        both = row.probabilities[scorer], row.probabilities[QUADRATURE]
        variations.append(total_variation(*both) if all(both) else 1.0)
    return float(np.mean(variations))


def _verdict(
    excess: CalibrationExcess, difference: Interval | None, variation: float | None, n: int
) -> str:
    missed = []
    if excess.excess > LARGEST_EXCESS:
        missed.append("calibration")
    if difference is not None and max(-difference.low, difference.high) > LARGEST_DIFFERENCE:
        missed.append("top-1")
    if variation is not None and variation > LARGEST_VARIATION:
        missed.append("total variation")
    if n < ENOUGH_SCENES:
        return "too few scenes"
    return f"NOT met: {', '.join(missed)}" if missed else "met"


def _excess(said: Sequence[Forecast]) -> CalibrationExcess:
    return expected_calibration_error_excess(said, rng=np.random.default_rng(_SEED))


def _excess_of_all(said: Sequence[Forecast]) -> float:
    if not any(len(forecast.probabilities) for forecast in said):
        return float("nan")
    rng = np.random.default_rng(_SEED)
    return expected_calibration_error_excess(said, "all", rng=rng).excess


def _rate(count: int, n: int) -> str:
    rate = wilson_interval(count, n)
    return f"{rate.estimate:.3f} [{rate.low:.3f}, {rate.high:.3f}]"


def _signed(interval: Interval) -> str:
    return f"{interval.estimate:+.4f} [{interval.low:+.4f}, {interval.high:+.4f}]"


def _spread(excess: CalibrationExcess) -> str:
    return f"{excess.excess:+.3f} +- {excess.spread:.3f}"


def _table_head(titles: Sequence[str]) -> Iterator[str]:
    yield _table_line(titles)
    yield "|" + " --- |" * len(titles)


def _table_line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
