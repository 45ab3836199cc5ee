"""Executors change how long work takes and nothing else, also when a worker is killed."""

from __future__ import annotations

import logging
import math
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from functools import partial
from itertools import permutations, product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mht_slam import (
    Association,
    Posterior,
    StraightRun,
    evidence_by_quadrature,
    rank_by_evidence,
    refine,
)
from mht_slam.errors import OptionError
from mht_slam.evidence import cluster_table
from mht_slam.parallel import ordered_map
from mht_slam.simulation import simulate_scene

SIGMA = math.radians(1.0)


def squared(number: int) -> int:
    return number * number


def squared_unless_first(number: int, marker: Path) -> int:
    """The first call of all kills its worker."""
    try:
        marker.touch(exist_ok=False)
    except FileExistsError:
        return number * number
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError("a killed process goes on")


def refused(number: int) -> int:
    raise OptionError(f"{number} is refused")


def a_pool() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(1, mp_context=get_context("forkserver"))


@pytest.fixture(scope="module")
def sound_pool() -> Iterator[ProcessPoolExecutor]:
    with a_pool() as pool:
        yield pool


def a_run(n: int = 3) -> StraightRun:
    return simulate_scene("one_sided", n, np.random.default_rng(2), sigma=SIGMA).run


def all_associations(n: int = 3) -> list[Association]:
    orders = [np.array(order) for order in permutations(range(n))]
    return [
        Association(np.column_stack([np.arange(n), second, third]), (n, n, n))
        for second, third in product(orders, orders)
    ]


def bits(posterior: Posterior) -> list[tuple[Any, ...]]:
    """Everything a posterior says, arrays as bytes."""
    return [
        (
            h,
            *(
                None if array is None else array.tobytes()
                for array in (h.poses, h.landmarks, h.landmark_covariances, h.pose_covariances)
            ),
        )
        for h in posterior
    ]


def test_results_come_in_the_order_of_the_chunks(sound_pool: ProcessPoolExecutor) -> None:
    assert list(ordered_map(sound_pool, squared, range(20))) == [k * k for k in range(20)]
    assert list(ordered_map(None, squared, range(20))) == [k * k for k in range(20)]


def test_a_killed_worker_costs_time_and_never_a_result(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    function = partial(squared_unless_first, marker=tmp_path / "killed")
    with a_pool() as pool, caplog.at_level(logging.WARNING, logger="mht_slam"):
        assert list(ordered_map(pool, function, range(20))) == [k * k for k in range(20)]
        # The pool is broken for good: it takes no more work, which is done here.
        assert list(ordered_map(pool, squared, range(3))) == [0, 1, 4]
    assert (tmp_path / "killed").exists()
    assert len([r for r in caplog.records if "goes on in this process" in r.message]) == 2


def test_a_pool_whose_workers_are_killed_refines_to_the_same_bits() -> None:
    run = a_run()
    candidates = all_associations()
    with a_pool() as pool:
        worker = pool.submit(os.getpid).result()
        os.kill(worker, signal.SIGKILL)
        survived = refine(run, candidates, sigma=SIGMA, evidence="laplace", executor=pool)
    assert bits(survived) == bits(refine(run, candidates, sigma=SIGMA, evidence="laplace"))


def test_what_the_work_itself_raises_is_passed_on(sound_pool: ProcessPoolExecutor) -> None:
    with pytest.raises(OptionError, match="0 is refused"):
        list(ordered_map(sound_pool, refused, range(3)))


class Unfinished(Executor):
    """Never does anything."""

    def __init__(self) -> None:
        self.futures: list[Future[Any]] = []

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        if not self.futures:
            future.set_result(fn(*args, **kwargs))
        self.futures.append(future)
        return future


def test_whoever_stops_listening_leaves_no_work_behind() -> None:
    executor = Unfinished()
    results = ordered_map(executor, squared, range(5))
    assert next(results) == 0
    assert isinstance(results, Iterator)
    results.close()  # type: ignore[attr-defined]
    assert all(future.cancelled() for future in executor.futures[1:])


def test_an_executor_that_breaks_while_it_is_given_work_is_survived() -> None:
    class Breaking(Unfinished):
        def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
            if self.futures:
                raise BrokenExecutor("gone")
            return super().submit(fn, *args, **kwargs)

    assert list(ordered_map(Breaking(), squared, range(4))) == [0, 1, 4, 9]


def test_exact_evidence_is_the_same_bits_with_a_pool(
    monkeypatch: pytest.MonkeyPatch, sound_pool: ProcessPoolExecutor
) -> None:
    monkeypatch.setattr(cluster_table, "CHUNK", 200)  # several chunks in a small scene
    run = a_run(4)
    serial = rank_by_evidence(run, sigma=SIGMA)
    pooled = rank_by_evidence(run, sigma=SIGMA, executor=sound_pool)
    weighed = evidence_by_quadrature(run, serial, sigma=SIGMA, executor=sound_pool)
    assert bits(pooled) == bits(serial)
    assert (pooled.covered, pooled.complete) == (serial.covered, serial.complete)
    assert bits(weighed) == bits(evidence_by_quadrature(run, serial, sigma=SIGMA))


def test_dask_workers_give_the_same_bits_and_may_be_killed(
    tmp_path: Path, start_dask: Callable[[int], Any]
) -> None:
    run = a_run()
    candidates = all_associations()
    with start_dask(2) as cluster, cluster.get_client() as client:
        executor = client.get_executor()
        refined = refine(run, candidates, sigma=SIGMA, evidence="laplace", executor=executor)
        ranked = rank_by_evidence(run, sigma=SIGMA, executor=executor)
        function = partial(squared_unless_first, marker=tmp_path / "killed")
        assert list(ordered_map(executor, function, range(6))) == [k * k for k in range(6)]
    assert (tmp_path / "killed").exists()
    assert bits(refined) == bits(refine(run, candidates, sigma=SIGMA, evidence="laplace"))
    assert bits(ranked) == bits(rank_by_evidence(run, sigma=SIGMA))
