"""Hypotheses refined per second, against the bare optimiser on the graphs that refining builds.

    python benchmarks/throughput/refinement.py                # overhead: two minutes on one core
    python benchmarks/throughput/refinement.py --processes 2  # and how two processes speed it up

For every scene the calls of GTSAM's optimiser are recorded once: graph, starting values and
parameters. Then `refine` and the recorded calls alone are timed in turns; the overhead is what
refining takes more than the calls, as a share of the calls. Times are processor time, so that
others on the machine matter less; those with several processes are wall time and need a quiet
machine. Candidates are the polygon ranking's (*ranked*), and those filled up with random
associations, which are wrong (*filled*). Beyond three scans each goes on as its landmarks of the
first scan truly do.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import astuple, dataclass, fields
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import gtsam
import numpy as np

from mht_slam import Association, ObservationModel, rank, refine
from mht_slam.graph.solve import EvidenceMethod
from mht_slam.simulation import Scene, simulate_scene
from mht_slam.simulation.scenes import SceneKind

SIGMA = math.radians(1.0)
EPSILON = math.radians(3.0)
KINDS: tuple[SceneKind, ...] = ("one_sided", "annulus")
LANDMARKS = (3, 4, 5, 6)
SCANS = (3, 8)
TOP_K = 50
WORK_LIMIT = 300_000
PARALLEL_JOB = ("one_sided", 6, 8)
"""Kind, landmarks and scans of the job that several processes share."""
PARALLEL_CANDIDATES = 600


@dataclass(frozen=True)
class Row:
    """One scene, times in seconds."""

    evidence: str
    candidates: str
    kind: str
    landmarks: int
    scans: int
    hypotheses: int
    optimiser_calls: int
    refine: float
    bare: float

    @property
    def overhead(self) -> float:
        """What refining takes more than the calls, as a share of the calls."""
        return self.refine / self.bare - 1.0


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print, and write rows.csv and summary.md."""
    options = _parse(arguments)
    rows = []
    for evidence, groups in (("laplace", ("ranked", "filled")), ("marginal", ("ranked",))):
        for group in groups:
            for kind in KINDS:
                for n in LANDMARKS:
                    for m in SCANS:
                        row = _measure(evidence, group, kind, n, m, options)  # type: ignore[arg-type]
                        rows.append(row)
                        print(_line(row), file=sys.stderr, flush=True)
    lines = _summary(rows, options.repeats)
    if options.processes > 1:
        lines += _parallel(options.processes, options.repeats, options.seed)
    options.output.mkdir(parents=True, exist_ok=True)
    with (options.output / "rows.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*(entry.name for entry in fields(Row)), "overhead"])
        writer.writerows([*astuple(row), row.overhead] for row in rows)
    (options.output / "summary.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))


def _measure(
    evidence: EvidenceMethod,
    group: str,
    kind: SceneKind,
    n: int,
    m: int,
    options: argparse.Namespace,
) -> Row:
    scene = simulate_scene(
        kind, n, np.random.default_rng([options.seed, n, m]), sigma=SIGMA, n_scans=m
    )
    candidates = _candidates(scene, TOP_K if group == "filled" else 0, options.seed)
    model = ObservationModel(sigma=SIGMA)

    def work() -> None:
        refine(scene.run, candidates, model=model, evidence=evidence)

    work()  # compiles on a machine's first run
    calls = _recorded(work)
    times: list[list[float]] = [[], []]
    for _ in range(options.repeats):
        for job, kept in zip((work, lambda: _replay(calls)), times, strict=True):
            kept.append(_seconds(job))
    whole, bare = (statistics.median(kept) for kept in times)
    return Row(evidence, group, kind, n, m, len(candidates), len(calls), whole, bare)


def _candidates(scene: Scene, at_least: int, seed: int) -> list[Association]:
    """The polygon ranking's, and random ones until there are so many or no others."""
    ranking = rank(scene.run, epsilon=EPSILON, top_k=TOP_K, scans=(0, 1, 2), work_limit=WORK_LIMIT)
    n, truth = scene.truth.n_landmarks, scene.truth
    later = {row[0]: row[3:] for row in truth.table.tolist()}
    tables = [h.association.table for h in ranking]
    rng = np.random.default_rng([seed, n])
    found: dict[Association, None] = {}
    while True:
        for table in tables:
            rows = [[*row, *later[row[0]]] for row in table.tolist()]
            found.setdefault(Association(rows, truth.n_detections))
        if len(found) >= min(at_least, math.factorial(n) ** 2):
            return list(found)
        tables = [np.column_stack([np.arange(n), rng.permutation(n), rng.permutation(n)])]


Call = tuple[gtsam.NonlinearFactorGraph, gtsam.Values, gtsam.LevenbergMarquardtParams]


def _recorded(work: Callable[[], None]) -> list[Call]:
    """The calls of the optimiser that some work makes."""
    calls: list[Call] = []
    original = gtsam.LevenbergMarquardtOptimizer

    def optimiser(*call: Any) -> Any:
        calls.append(call)  # type: ignore[arg-type]
        return original(*call)

    gtsam.LevenbergMarquardtOptimizer = optimiser  # type: ignore[assignment, misc]
    try:
        work()
    finally:
        gtsam.LevenbergMarquardtOptimizer = original  # type: ignore[misc]
    return calls


def _replay(calls: list[Call]) -> None:
    for call in calls:
        try:
            gtsam.LevenbergMarquardtOptimizer(*call).optimize()
        except RuntimeError:  # as it did when it was recorded
            continue


def _seconds(job: Callable[[], None]) -> float:
    """Processor time of a job, repeated until it is long enough to be measured."""
    repeats = 0
    start = time.process_time()
    while (passed := time.process_time() - start) < 0.02:
        job()
        repeats += 1
    return passed / repeats


def _summary(rows: list[Row], repeats: int) -> list[str]:
    lines = [
        f"Medians of {repeats}; sigma {math.degrees(SIGMA):g} deg.",
        "",
        "| evidence | candidates | scene | n | scans | hypotheses | optimiser calls | refined per "
        "second | overhead |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        *(_line(row) for row in rows),
    ]
    for evidence, group in (("laplace", "ranked"), ("laplace", "filled"), ("marginal", "ranked")):
        of_group = [r for r in rows if (r.evidence, r.candidates) == (evidence, group)]
        whole, bare = sum(r.refine for r in of_group), sum(r.bare for r in of_group)
        middle = statistics.median(r.overhead for r in of_group)
        within = sum(r.overhead <= 1.5 for r in of_group)
        lines += [
            "",
            f"{evidence}, {group}: overhead {whole / bare - 1.0:.2f} over all together, "
            f"{middle:.2f} at the median, at most 1.5 in {within} of {len(of_group)} scenes.",
        ]
    return lines


def _line(row: Row) -> str:
    cells = [row.evidence, row.candidates, row.kind, row.landmarks, row.scans, row.hypotheses]
    cells += [row.optimiser_calls, f"{row.hypotheses / row.refine:.0f}", f"{row.overhead:.2f}"]
    return f"| {' | '.join(map(str, cells))} |"


def _parallel(processes: int, repeats: int, seed: int) -> list[str]:
    """Wall time of one job with one process and with several, warmed up, in turns."""
    kind, n, m = PARALLEL_JOB
    scene = simulate_scene(kind, n, np.random.default_rng([seed, n, m]), sigma=SIGMA, n_scans=m)  # type: ignore[arg-type]
    candidates = _candidates(scene, PARALLEL_CANDIDATES, seed)
    ratios = []
    load = os.getloadavg()[0]
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        for number in range(repeats + 1):
            seconds = []
            for executor in (None, pool):
                start = time.perf_counter()
                refine(scene.run, candidates, sigma=SIGMA, evidence="laplace", executor=executor)
                seconds.append(time.perf_counter() - start)
            if number:  # the first round starts and compiles
                ratios.append(seconds[0] / seconds[1])
    return [
        "",
        f"{processes} processes against one: {statistics.median(ratios):.2f} times as fast, median "
        f"of {repeats} ({min(ratios):.2f} to {max(ratios):.2f}), {len(candidates)} hypotheses, "
        f"{kind}, n = {n}, {m} scans; load of the machine before {load:.1f}.",
    ]


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=1, help="more than 1: measure them too")
    parser.add_argument("--output", type=Path, default=Path("runs/throughput"))
    return parser.parse_args(arguments)


if __name__ == "__main__":
    main()
