"""Jobs on an executor, as they finish: what a killed worker owes is done again."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from itertools import islice
from typing import TypeVar

from mht_slam.parallel import LOST

Task = TypeVar("Task")
Result = TypeVar("Result")

IN_FLIGHT = 256
"""Tasks that an executor is given at a time: enough for many workers, few enough for memory."""

_logger = logging.getLogger("mht_slam")


def finished_results(
    executor: Executor | None, function: Callable[[Task], Result], tasks: Iterable[Task]
) -> Iterator[Result]:
    """Yield ``function(task)`` for every task as soon as it is there, in any order.

    Parameters
    ----------
    executor : as in `mht_slam.parallel.ordered_map`; None works in this process, task by task.
        What a broken pool owes is done in this process, with a warning of the logger ``mht_slam``.
    function, tasks : picklable where the workers are other processes. Tasks are taken from the
        iterable as workers need them.

    What the function itself raises is passed on.
    """
    if executor is None:
        yield from map(function, tasks)
        return
    waiting = iter(tasks)
    running: dict[Future[Result], Task] = {}
    lost: list[Task] = []
    told = False
    try:
        while True:
            _fill(executor, function, waiting, running, lost)
            if lost:
                if not told:
                    told = True
                    _logger.warning("work goes on in this process: the executor lost its workers")
                yield from map(function, lost)
                lost.clear()
            if not running:
                break
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                task = running.pop(future)
                try:
                    result = future.result()
                except LOST:
                    lost.append(task)
                else:
                    yield result
        yield from map(function, waiting)  # nothing is left, unless the executor broke
    finally:
        for future in running:
            future.cancel()


def _fill(
    executor: Executor,
    function: Callable[[Task], Result],
    waiting: Iterator[Task],
    running: dict[Future[Result], Task],
    lost: list[Task],
) -> None:
    """Give the executor what it has room for; a task that it refuses is lost."""
    for task in islice(waiting, IN_FLIGHT - len(running)):
        try:
            running[executor.submit(function, task)] = task
        except BrokenExecutor:
            lost.append(task)
            return
