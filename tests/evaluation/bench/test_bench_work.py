"""Results come as they are finished, all of them once, whatever happens to the workers."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from typing import Any

import pytest

from mht_slam.evaluation.bench import work
from mht_slam.evaluation.bench.work import finished_results


def squared(number: int) -> int:
    return number * number


class Shaky(Executor):
    """Does work at once, loses every third task, and breaks after a while."""

    def __init__(self, breaks_after: int) -> None:
        self.given = 0
        self.breaks_after = breaks_after

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.given += 1
        if self.given > self.breaks_after:
            raise BrokenExecutor("gone")
        future: Future[Any] = Future()
        if self.given % 3 == 0:
            future.set_exception(BrokenExecutor("lost"))
        else:
            future.set_result(fn(*args, **kwargs))
        return future


@pytest.mark.parametrize("breaks_after", [0, 1, 10, 1000])
@pytest.mark.parametrize("in_flight", [1, 7, 256])
def test_every_task_is_done_once_however_shaky_the_executor(
    breaks_after: int, in_flight: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(work, "IN_FLIGHT", in_flight)
    found = list(finished_results(Shaky(breaks_after), squared, range(40)))
    assert sorted(found) == [k * k for k in range(40)]


def test_tasks_are_taken_as_there_is_room_for_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(work, "IN_FLIGHT", 4)
    taken: list[int] = []

    def tasks() -> Iterator[int]:
        for number in range(100):
            taken.append(number)
            yield number

    results = finished_results(Shaky(1000), squared, tasks())
    next(results)
    assert len(taken) <= 5


def test_what_the_work_raises_is_passed_on_and_the_rest_is_cancelled() -> None:
    class Waiting(Shaky):
        futures: list[Future[Any]] = []  # noqa: RUF012 - of one test

        def submit(self, _fn: Any, /, *_args: Any, **_kwargs: Any) -> Future[Any]:
            future: Future[Any] = Future()
            if not self.futures:
                future.set_exception(ZeroDivisionError("of its own"))
            self.futures.append(future)
            return future

    executor = Waiting(1000)
    with pytest.raises(ZeroDivisionError, match="of its own"):
        list(finished_results(executor, squared, range(5)))
    assert all(future.cancelled() for future in executor.futures[1:])
