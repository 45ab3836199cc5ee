"""The tidy table of a comparison: one row per scene and method, as CSV and Parquet."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mht_slam.errors import MissingExtraError
from mht_slam.evaluation.bench.compare import Outcome
from mht_slam.evaluation.bench.judging import Verdict
from mht_slam.evaluation.calibration import LOG_SCORE_FLOOR, Forecast, mean_log_score
from mht_slam.evaluation.metrics import brier_score

TIME_COLUMNS = ("cell", "method", "scenes", "median_ms", "total_s")


def tidy_rows(outcome: Outcome) -> list[dict[str, Any]]:
    """Return one row per scene and method, in the order of cells, scenes and methods.

    Columns: those of the cell; ``scene``; ``order_changes``, ``candidates`` and ``truth_listed``
    of the scene; ``method``; and the fields of its `Verdict`, where the forecast is given as
    ``top_probability``, ``truth_probability``, ``log_score`` (not below ln 1e-6) and ``brier``.
    None where a method has no such figure.
    """
    return list(_rows(outcome))


def write_csv(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write rows of equal columns; None is an empty field."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def write_parquet(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write the same rows as Parquet; raises `MissingExtraError` without pyarrow."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as cause:
        raise MissingExtraError(
            "Parquet needs pyarrow: pip install 'mht-slam[bench]', or read the CSV"
        ) from cause
    parquet.write_table(pyarrow.Table.from_pylist(list(rows)), path)


def time_rows(outcome: Outcome) -> list[dict[str, Any]]:
    """Return the median and the sum of each method's times, cell by cell; `TIME_COLUMNS`.

    Times of methods that weigh the shared candidates are without finding those, which has a row
    of its own.
    """
    names = {source.key: source.name for source in outcome.sources}
    rows = []
    for source in outcome.sources:
        taken: dict[str, list[float]] = {}
        for times in outcome.times:
            if times.source == source.key:
                for method, seconds in times.seconds.items():
                    taken.setdefault(method, []).append(seconds)
        for method, seconds_of in taken.items():
            figures = 1e3 * float(np.median(seconds_of)), sum(seconds_of)
            entries = (names[source.key], method, len(seconds_of), *figures)
            rows.append(dict(zip(TIME_COLUMNS, entries, strict=True)))
    return rows


def forecast_of(verdict: Verdict) -> Forecast | None:
    """Return a verdict's probabilities; none said, or an empty one for a failure."""
    if verdict.failure is not None:
        return Forecast([], None)
    return None if verdict.forecast is None else Forecast(verdict.forecast, verdict.truth)


def _rows(outcome: Outcome) -> Iterator[dict[str, Any]]:
    columns = {source.key: source.columns for source in outcome.sources}
    for result in outcome.results:
        for verdict in result.verdicts:
            yield {
                **columns[result.source],
                "scene": result.scene,
                "order_changes": result.order_changes,
                "candidates": result.candidates,
                "truth_listed": result.truth_listed,
                "method": verdict.method,
                "failure": verdict.failure,
                "listed": verdict.listed,
                "rank": verdict.rank,
                "exact": verdict.rank == 1,
                "f1": verdict.f1,
                **_of_forecast(verdict),
                "tau": verdict.tau,
                "map_error": verdict.map_error,
                "first": verdict.first,
            }


def _of_forecast(verdict: Verdict) -> dict[str, float | None]:
    names = ("top_probability", "truth_probability", "log_score", "brier")
    said = forecast_of(verdict)
    if said is None or verdict.failure is not None:
        return dict.fromkeys(names)
    p = [*said.probabilities.tolist(), said.rest]
    truth = len(p) - 1 if said.truth is None else said.truth
    log = mean_log_score([said], LOG_SCORE_FLOOR)
    brier = brier_score(p, truth)
    top = max(said.probabilities.tolist(), default=0.0)
    return dict(zip(names, (top, p[truth], log, brier), strict=True))
