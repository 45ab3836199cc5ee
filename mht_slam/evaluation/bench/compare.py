"""`compare`: every method on every scene of a sweep, kept on disk, on any executor."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from mht_slam.errors import OptionError
from mht_slam.evaluation.bench.case import CaseSource
from mht_slam.evaluation.bench.jobs import Job, JobResult, JobTimes, run_job
from mht_slam.evaluation.bench.methods import (
    CEILINGS,
    METHODS,
    Method,
    MethodFunction,
    as_method,
    known_methods,
)
from mht_slam.evaluation.bench.store import JobStore, job_store
from mht_slam.evaluation.bench.sweep import Sweep
from mht_slam.evaluation.bench.work import finished_results
from mht_slam.progress import Progress


@dataclass(frozen=True)
class Outcome:
    """What a comparison found.

    Attributes
    ----------
    sources : the cells of the sweep, or the sets of recorded runs, in their order.
    methods : names of the methods and then of the ceilings, in the order of the tables.
    results : sorted by source and scene; the same on any executor, to the last bit.
    times : in the same order; differ from run to run.
    """

    sources: tuple[CaseSource, ...]
    methods: tuple[str, ...]
    results: tuple[JobResult, ...]
    times: tuple[JobTimes, ...]


def compare(
    sweep: Sweep | Sequence[tuple[CaseSource, int]],
    methods: Mapping[str, MethodFunction | Method] | None = None,
    *,
    ours: Sequence[str] | None = None,
    store: Path | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Outcome:
    """Let all methods associate the same scenes, and judge them alike.

    Parameters
    ----------
    sweep : a `Sweep`, or pairs (source, number of the scene), each pair once.
    methods : the caller's own methods by name, beside ours in every table: functions
        ``function(run, assumptions)`` that return pairs (association, score), or `Method`.
    ours : names of our methods (`METHODS`) that take part; None means all.
    store : folder that keeps finished jobs. A comparison that was killed goes on where it was, and
        one with more cells or scenes runs only these. None keeps nothing.
    executor : any `concurrent.futures.Executor`; None works in this process. The results do not
        depend on it, nor on workers that get killed.
    progress : called as ``progress(done, total)``, of scenes.

    A method that raises, or returns nothing, has failed the scene, and that counts as a miss.

    Raises `OptionError` for methods that are none or have a name of ours, and for a store that
    holds results of other code or methods.

    Source: docs/bench.md.
    """
    jobs = [Job(source, scene) for source, scene in _pairs(sweep)]
    chosen = _chosen(ours, methods or {})
    work = partial(run_job, chosen)
    with ExitStack() as stack:
        kept = None if store is None else stack.enter_context(job_store(store, chosen))
        results, times = _done_before(jobs, kept)
        missing = [job for job in jobs if job.key not in results]
        if progress is not None:
            progress(len(results), len(jobs))
        for result, taken in finished_results(executor, work, missing):
            if kept is not None:
                kept.add(result, taken)
            results[result.key], times[result.key] = result, taken
            if progress is not None:
                progress(len(results), len(jobs))
    return Outcome(
        sources=tuple({job.source.key: job.source for job in jobs}.values()),
        methods=(*chosen, *CEILINGS),
        results=tuple(results[job.key] for job in jobs),
        times=tuple(times[job.key] for job in jobs if job.key in times),
    )


def _pairs(
    sweep: Sweep | Sequence[tuple[CaseSource, int]],
) -> Iterable[tuple[CaseSource, int]]:
    pairs: Sequence[tuple[CaseSource, int]] = sweep.jobs if isinstance(sweep, Sweep) else sweep
    if not pairs:
        raise OptionError("the comparison has no scenes: give some")
    if len({(source.key, scene) for source, scene in pairs}) < len(pairs):
        raise OptionError("the comparison has a scene twice: give every one once")
    return pairs


def _chosen(
    ours: Sequence[str] | None, own: Mapping[str, MethodFunction | Method]
) -> dict[str, Method]:
    chosen = known_methods(ours)
    for name, found in own.items():
        if name in METHODS or name in CEILINGS:
            raise OptionError(f"method {name!r} has the name of one of ours: give another name")
        chosen[name] = as_method(found, name)
    if not chosen:
        raise OptionError("no method takes part: name one")
    return chosen


def _done_before(
    jobs: Sequence[Job], kept: JobStore | None
) -> tuple[dict[tuple[str, int], JobResult], dict[tuple[str, int], JobTimes]]:
    """Results and times of the wanted jobs that the store has."""
    if kept is None:
        return {}, {}
    keys = [job.key for job in jobs if job.key in kept.results]
    times = {key: kept.times[key] for key in keys if key in kept.times}
    return {key: kept.results[key] for key in keys}, times
