"""Work on an executor, in order, that a killed worker slows down and never changes."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from typing import TypeVar

Chunk = TypeVar("Chunk")
Result = TypeVar("Result")

LOST = (BrokenExecutor, CancelledError)
"""What a future raises whose worker is gone; anything else is the work's own."""

_logger = logging.getLogger("mht_slam")


def ordered_map(
    executor: Executor | None, function: Callable[[Chunk], Result], chunks: Sequence[Chunk]
) -> Iterator[Result]:
    """Yield ``function(chunk)`` for every chunk, in their order.

    Parameters
    ----------
    executor : any `concurrent.futures.Executor`: a process pool, that of a
        `dask.distributed.Client`; None works in this process, chunk by chunk as results are asked
        for.
    function, chunks : picklable where the executor's workers are other processes. The function
        must give the same result wherever it runs.

    A `ProcessPoolExecutor` is of no use any more once one of its workers was killed. What it still
    owes is then done in this process, and the logger ``mht_slam`` gets a warning. Executors that
    try again by themselves, as dask does, are left to it. What the function itself raises is passed
    on.
    """
    if executor is None:
        yield from map(function, chunks)
        return
    futures = _submitted(executor, function, chunks)
    told = False
    try:
        for chunk, future in zip(chunks, futures, strict=True):
            try:
                if future is None:
                    raise BrokenExecutor("the executor took no more work")
                result = future.result()
            except LOST as cause:
                if not told:
                    told = True
                    _logger.warning("work goes on in this process: %s", cause)
                result = function(chunk)
            yield result
    finally:
        for future in futures:
            if future is not None:
                future.cancel()


def _submitted(
    executor: Executor, function: Callable[[Chunk], Result], chunks: Sequence[Chunk]
) -> list[Future[Result] | None]:
    """Futures of all chunks, None for those that a broken executor no longer takes."""
    futures: list[Future[Result] | None] = []
    for chunk in chunks:
        try:
            futures.append(executor.submit(function, chunk))
        except BrokenExecutor:
            break
    return futures + [None] * (len(chunks) - len(futures))
