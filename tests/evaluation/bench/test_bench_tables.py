"""Tables count what happened, failures included, and come out the same byte for byte."""

from __future__ import annotations

import csv
import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from mht_slam.evaluation.bench.compare import Outcome, compare
from mht_slam.evaluation.bench.jobs import JobResult, JobTimes
from mht_slam.evaluation.bench.judging import Verdict
from mht_slam.evaluation.bench.methods import GRAPH_EVIDENCE, ORDER_KEEPING, POLYGON
from mht_slam.evaluation.bench.summary import (
    ALL,
    MethodSummary,
    Summary,
    markdown,
    summarise,
    summary_rows,
)
from mht_slam.evaluation.bench.sweep import Sweep
from mht_slam.evaluation.bench.tables import tidy_rows, time_rows, write_csv, write_parquet
from mht_slam.evaluation.significance import mcnemar, wilson_interval


@pytest.fixture(scope="module")
def outcome(own: ModuleType) -> Outcome:
    sweep = Sweep(
        kinds=("annulus",), landmarks=(4,), epsilons=(math.radians(5), math.radians(9)),
        noises=("uniform",), scenes=12,
    )  # fmt: skip
    return compare(
        sweep,
        {"mine": own.CHEAP, "raises": own.RAISES},
        ours=["smallest epsilon", "order-keeping", "nearest bearing"],
    )


def verdict(method: str, *, right: bool, first: str = "a", **changes: object) -> Verdict:
    plain = Verdict(
        method=method,
        failure=None,
        listed=2,
        rank=1 if right else 2,
        f1=1.0 if right else 0.5,
        first=first,
        forecast=[0.8, 0.2],
        truth=0 if right else 1,
        tau=0.5,
        map_error=0.25,
    )
    return replace(plain, **changes)  # type: ignore[arg-type]


def made_up(outcome: Outcome, scenes: list[list[Verdict]]) -> Outcome:
    """An outcome of one cell with these verdicts, the order changing in odd scenes."""
    source = outcome.sources[0]
    results = tuple(
        JobResult(source.key, i, bool(i % 2), 3, True, tuple(verdicts))
        for i, verdicts in enumerate(scenes)
    )
    times = tuple(JobTimes(r.source, r.scene, {"m": 0.5 + r.scene}, {}) for r in results)
    names = tuple(dict.fromkeys(v.method for verdicts in scenes for v in verdicts))
    return Outcome((source,), names, results, times)


def of(summary: Summary, method: str, cell: str = ALL) -> MethodSummary:
    return next(row for row in summary.methods if (row.method, row.cell) == (method, cell))


def test_rates_are_the_counts_of_the_tidy_table(outcome: Outcome) -> None:
    rows, tidy = summarise(outcome).methods, tidy_rows(outcome)
    assert len(tidy) == sum(len(result.verdicts) for result in outcome.results)
    assert {row.cell for row in rows} == {ALL, *(s.name for s in outcome.sources)}
    for row in rows:
        own_rows = [r for r in tidy if r["method"] == row.method and row.cell in (ALL, r["cell"])]
        right = sum(r["exact"] for r in own_rows)
        assert row.scenes == len(own_rows)
        assert row.exact == wilson_interval(right, len(own_rows))
        assert row.f1 == pytest.approx(np.mean([r["f1"] for r in own_rows]))
        changed = [r for r in own_rows if r["order_changes"]]
        assert (row.exact_changed.low, row.exact_changed.high) == pytest.approx(
            wilson_interval(sum(r["exact"] for r in changed), len(changed))[1:]
        )


def test_order_keeping_is_never_right_where_the_order_changes(outcome: Outcome) -> None:
    row = of(summarise(outcome), ORDER_KEEPING)
    assert any(result.order_changes for result in outcome.results)
    assert row.exact_changed.estimate == 0.0
    assert row.exact_kept.estimate == 1.0


def test_failures_count_as_misses_in_every_figure(outcome: Outcome) -> None:
    row = of(summarise(outcome), "raises")
    assert (row.failures, row.exact.estimate, row.f1, row.top_3) == (24, 0.0, 0.0, 0.0)
    assert row.mean_reciprocal_rank == 0.0
    assert row.minus_order_keeping is not None
    assert row.minus_order_keeping.estimate == -of(summarise(outcome), ORDER_KEEPING).exact[0]
    assert row.calibration is None


def test_a_failure_of_a_forecaster_costs_it_probability(outcome: Outcome) -> None:
    fails = verdict("m", right=False, failure="ValueError", forecast=None, truth=None, rank=None)
    good = made_up(outcome, [[verdict("m", right=True)]] * 2)
    half = made_up(outcome, [[verdict("m", right=True)], [fails]])
    better, worse = summarise(good).overall[0], summarise(half).overall[0]
    assert better.log_score == pytest.approx(math.log(0.8))
    assert worse.log_score == pytest.approx(0.5 * (math.log(0.8) + math.log(1e-6)))
    assert better.brier is not None
    assert worse.brier is not None
    assert worse.brier > better.brier


def test_differences_to_order_keeping_are_paired(outcome: Outcome) -> None:
    mine = [True, True, True, True, False, True]
    theirs = [True, False, False, False, True, False]
    scenes = [
        [verdict(ORDER_KEEPING, right=b), verdict("m", right=a)]
        for a, b in zip(mine, theirs, strict=True)
    ]
    row = next(row for row in summarise(made_up(outcome, scenes)).methods if row.method == "m")
    assert row.minus_order_keeping is not None
    assert row.minus_order_keeping.estimate == pytest.approx(3 / 6)
    assert row.mcnemar_p == mcnemar(mine, theirs)
    assert row.exact.estimate == 5 / 6


def test_scores_that_are_no_probabilities_have_no_probability_figures(outcome: Outcome) -> None:
    row = of(summarise(outcome), "smallest epsilon")
    assert (row.log_score, row.brier, row.calibration, row.top_probability) == (None,) * 4


def test_where_polygons_and_graph_disagree_it_is_counted_who_is_right(outcome: Outcome) -> None:
    def scene(polygon: bool, graph: bool, *, same: bool) -> list[Verdict]:
        other = "a" if same else "b"
        return [
            verdict(POLYGON, right=polygon, first="a", tau=0.2),
            verdict(GRAPH_EVIDENCE, right=graph, first=other, tau=1.0),
        ]

    scenes = [
        scene(True, True, same=True),
        scene(False, False, same=True),
        scene(True, False, same=False),
        scene(False, True, same=False),
        scene(False, True, same=False),
        scene(False, False, same=False),
    ]
    summary = summarise(made_up(outcome, scenes))
    (found,) = summary.agreements
    assert (found.polygon_right, found.graph_right, found.neither_right) == (1, 2, 1)
    assert found.same_first == wilson_interval(2, 6)
    assert found.tau is not None
    assert found.tau.estimate == pytest.approx(0.2)
    assert POLYGON in markdown(summary)


def test_all_cells_together_come_before_each(outcome: Outcome) -> None:
    lines = markdown(summarise(outcome)).splitlines()
    heads = [line.removeprefix("## ") for line in lines if line.startswith("## ")]
    assert heads == [ALL, *(source.name for source in outcome.sources)]


def test_times_stand_in_a_table_of_their_own(outcome: Outcome) -> None:
    rows = time_rows(made_up(outcome, [[verdict("m", right=True)]] * 3))
    assert [(row["method"], row["scenes"], row["median_ms"]) for row in rows] == [("m", 3, 1500.0)]
    text = markdown(summarise(outcome))
    assert "ms" not in {word.strip("|") for word in text.split()}


def test_csv_and_parquet_hold_the_same_rows(outcome: Outcome, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = tidy_rows(outcome)
    write_csv(tmp_path / "t.csv", rows)
    write_parquet(tmp_path / "t.parquet", rows)
    assert parquet.read_table(tmp_path / "t.parquet").to_pylist() == rows
    with (tmp_path / "t.csv").open(newline="") as file:
        read = list(csv.DictReader(file))
    as_text = [{k: "" if v is None else str(v) for k, v in row.items()} for row in rows]
    assert read == as_text


def tables(outcome: Outcome, folder: Path) -> list[bytes]:
    folder.mkdir()
    write_csv(folder / "rows.csv", tidy_rows(outcome))
    write_csv(folder / "summary.csv", summary_rows(summarise(outcome)))
    write_parquet(folder / "rows.parquet", tidy_rows(outcome))
    (folder / "summary.md").write_text(markdown(summarise(outcome)))
    return [path.read_bytes() for path in sorted(folder.iterdir())]


def test_tables_are_the_same_bytes_on_any_executor_and_after_a_killed_worker(
    own: ModuleType, tmp_path: Path, small_sweep: Sweep, cheap: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    pytest.importorskip("pyarrow")
    monkeypatch.setenv("BENCH_TEST_MARKER", str(tmp_path / "killed"))
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        pooled = compare(
            small_sweep, {"k": own.KILLS}, ours=cheap, store=tmp_path / "s", executor=pool
        )
    assert (tmp_path / "killed").exists()
    serial = compare(small_sweep, {"k": own.KILLS}, ours=cheap)
    assert tables(pooled, tmp_path / "pooled") == tables(serial, tmp_path / "serial")
