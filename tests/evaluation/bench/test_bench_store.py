"""A sweep that is killed goes on where it was; no job is done twice, lost or doubled."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from mht_slam.errors import OptionError
from mht_slam.evaluation.bench import store as stores
from mht_slam.evaluation.bench.compare import Outcome, compare
from mht_slam.evaluation.bench.store import RESULTS_FILE, TIMES_FILE
from mht_slam.evaluation.bench.sweep import Sweep

PROGRAM = """
import sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import bench_methods_of_tests as own
from mht_slam.evaluation.bench.compare import compare
from mht_slam.evaluation.bench.sweep import Sweep
sweep = Sweep(kinds=("annulus",), landmarks=(3,), epsilons=(0.05,), noises=("uniform",), scenes=60)
compare(sweep, {"counted": own.COUNTED}, ours=["smallest epsilon"], store=Path(sys.argv[2]))
"""
MANY = Sweep(kinds=("annulus",), landmarks=(3,), epsilons=(0.05,), noises=("uniform",), scenes=60)


def test_what_is_done_is_never_done_again(
    own: ModuleType, small_sweep: Sweep, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = tmp_path / "calls"
    monkeypatch.setenv("BENCH_TEST_CALLS", str(calls))
    methods, ours = {"counted": own.COUNTED}, ["order-keeping"]
    first = compare(small_sweep, methods, ours=ours, store=tmp_path / "store")
    again = compare(small_sweep, methods, ours=ours, store=tmp_path / "store")
    assert again == first
    more = compare(replace(small_sweep, scenes=5), methods, ours=ours, store=tmp_path / "store")
    assert len(more.results) == 10
    assert [r for r in more.results if r.scene < 3] == list(first.results)
    assert [*Counter(calls.read_text().split()).values()] == [1] * 10


def test_a_line_that_was_cut_anywhere_is_done_again_and_everything_comes_out_the_same(
    own: ModuleType, small_sweep: Sweep, tmp_path: Path
) -> None:
    def run(folder: Path) -> Outcome:
        return compare(small_sweep, {"mine": own.CHEAP}, ours=["order-keeping"], store=folder)

    whole = run(tmp_path / "whole")
    content = (tmp_path / "whole" / RESULTS_FILE).read_bytes()
    times = (tmp_path / "whole" / TIMES_FILE).read_bytes()
    lines = content.count(b"\n")
    for cut in (1, 40, len(content) // 2, len(content) - 200, len(content) - 1):
        folder = tmp_path / f"cut{cut}"
        folder.mkdir()
        (folder / RESULTS_FILE).write_bytes(content[:cut])
        (folder / TIMES_FILE).write_bytes(times[: cut // 3])
        assert run(folder).results == whole.results
        repaired = (folder / RESULTS_FILE).read_bytes()
        assert repaired.count(b"\n") == lines
        assert sorted(repaired.split(b"\n")) == sorted(content.split(b"\n"))


def test_a_sweep_killed_at_any_moment_goes_on_and_ends_the_same(
    own: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls, folder = tmp_path / "calls", tmp_path / "store"
    monkeypatch.setenv("BENCH_TEST_CALLS", str(calls))
    here = str(Path(own.__file__ or "").parent)
    process = subprocess.Popen(  # noqa: S603 - our own interpreter and program
        [sys.executable, "-c", PROGRAM, here, str(folder)], env=dict(os.environ)
    )
    path = folder / RESULTS_FILE
    deadline = time.monotonic() + 60.0
    while not path.exists() or path.read_bytes().count(b"\n") < 6:
        assert process.poll() is None, "it ended before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    process.wait()
    finished = path.read_bytes().count(b"\n") - 1
    assert 5 <= finished < 60
    methods, ours = {"counted": own.COUNTED}, ["smallest epsilon"]
    resumed = compare(MANY, methods, ours=ours, store=folder)
    assert resumed.results == compare(MANY, methods, ours=ours).results
    counts = Counter(Counter(calls.read_text().split()).values())
    # Each scene was done in the comparison without a store, and once for the store; the one that
    # was under way when the process died may have begun twice.
    assert set(counts) <= {2, 3}
    assert counts[3] <= 1


def test_results_of_other_methods_or_other_code_are_refused(
    own: ModuleType, small_sweep: Sweep, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compare(small_sweep, {"mine": own.CHEAP}, ours=["order-keeping"], store=tmp_path)
    content = (tmp_path / RESULTS_FILE).read_bytes()
    with pytest.raises(OptionError, match="other methods: give another folder"):
        compare(small_sweep, ours=["order-keeping"], store=tmp_path)
    monkeypatch.setattr(stores, "code_digest", lambda: "of another day")
    with pytest.raises(OptionError, match="other code"):
        compare(small_sweep, {"mine": own.CHEAP}, ours=["order-keeping"], store=tmp_path)
    assert (tmp_path / RESULTS_FILE).read_bytes() == content


def test_a_file_that_is_no_store_is_left_alone(small_sweep: Sweep, tmp_path: Path) -> None:
    for content in ("my notes\n", '{"format": 0}\n'):
        (tmp_path / RESULTS_FILE).write_text(content)
        with pytest.raises(OptionError, match="give another folder"):
            compare(small_sweep, ours=["order-keeping"], store=tmp_path)
        assert (tmp_path / RESULTS_FILE).read_text() == content


def test_two_processes_do_not_write_one_store(tmp_path: Path) -> None:
    with (
        stores.job_store(tmp_path, {}),
        pytest.raises(OptionError, match="another process"),
        stores.job_store(tmp_path, {}),
    ):
        pass


def test_a_finished_line_holds_everything_and_no_time(
    own: ModuleType, small_sweep: Sweep, tmp_path: Path
) -> None:
    outcome = compare(small_sweep, {"mine": own.CHEAP}, ours=["order-keeping"], store=tmp_path)
    lines = (tmp_path / RESULTS_FILE).read_text().splitlines()[1:]
    assert len(lines) == len(outcome.results)
    assert "seconds" not in lines[0]
    assert json.loads(lines[0])["verdicts"][0]["method"] == "order-keeping"


def test_a_killed_worker_of_a_pool_loses_nothing(
    own: ModuleType,
    small_sweep: Sweep,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setenv("BENCH_TEST_MARKER", str(tmp_path / "killed"))
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool, caplog.at_level(
        logging.WARNING, logger="mht_slam"
    ):  # fmt: skip
        survived = compare(
            small_sweep,
            {"kills": own.KILLS},
            ours=["order-keeping"],
            store=tmp_path / "store",
            executor=pool,
        )
    assert (tmp_path / "killed").exists()
    serial = compare(small_sweep, {"kills": own.KILLS}, ours=["order-keeping"])
    assert survived.results == serial.results
    assert len([r for r in caplog.records if "goes on in this process" in r.message]) == 1


def test_a_killed_dask_worker_loses_nothing(
    own: ModuleType,
    small_sweep: Sweep,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    start_dask: Callable[[int], Any],
) -> None:
    monkeypatch.setenv("BENCH_TEST_MARKER", str(tmp_path / "killed"))
    with start_dask(2) as cluster, cluster.get_client() as client:
        survived = compare(
            small_sweep,
            {"kills": own.KILLS},
            ours=["order-keeping"],
            store=tmp_path / "store",
            executor=client.get_executor(),
        )
    assert (tmp_path / "killed").exists()
    assert (
        survived.results
        == compare(small_sweep, {"kills": own.KILLS}, ours=["order-keeping"]).results
    )


def test_progress_counts_what_was_done_before_too(
    small_sweep: Sweep, tmp_path: Path, cheap: list[str]
) -> None:
    seen: list[tuple[int, int]] = []
    first = replace(small_sweep, scenes=1)
    compare(first, ours=cheap, store=tmp_path)
    compare(small_sweep, ours=cheap, store=tmp_path, progress=lambda *at: seen.append(at))
    assert seen == [(done, 6) for done in range(2, 7)]
