"""One job of the ranking study: a scene, ranked exactly and by its peers, with times and memory."""

from __future__ import annotations

import hashlib
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar
from unittest.mock import patch

import numpy as np
from feasible_pairs import feasible_pairs
from lp_feasibility import count_consistent, is_consistent

import mht_slam as ms
from mht_slam.polygon import exhaustive as exhaustive_module
from mht_slam.simulation import Scene, simulate_scene
from mht_slam.simulation.scenes import SceneKind

KINDS: tuple[SceneKind, ...] = ("one_sided", "annulus", "clusters")
TOP_K = 10
LARGEST_LP = 4

_LARGEST_EXHAUSTIVE = 7
_LARGEST_EXHAUSTIVE_NARROW = 8
"""At epsilon 1 degree few halves of hypotheses survive, so that more can be waited for."""
_NARROW_DEG = 1.0

T = TypeVar("T")

_MEGABYTES = 2.0**-20 if sys.platform == "darwin" else 2.0**-10


@dataclass(frozen=True)
class Job:
    """What is measured: one scene, under one limit on the work."""

    kind: SceneKind
    n: int
    epsilon_deg: float
    seed: int
    work_limit: int


@dataclass(frozen=True)
class Row:
    """What was measured; None: not done.

    Times are seconds that one call kept one core busy: what it takes on an idle machine, however
    many other scenes are measured meanwhile. Memory is in megabytes.

    Attributes
    ----------
    code : `code_version` of the searches that were timed.
    memory_mb : peak of the process after the exact ranking.
    memory_growth_mb : how much of that the exact ranking added.
    same_list : whether both rankings list the same associations in the same order.
    largest_difference : of their scores.
    lp_truth_seconds : one linear program, that of the truth; `lp_all_seconds`: all (n!)^2.
    lp_consistent, consistent : associations found consistent by linear programs, and by
        `consistent_associations`.
    """

    kind: SceneKind
    n: int
    epsilon_deg: float
    seed: int
    work_limit: int
    code: str
    exact_seconds: float
    n_steps: int
    n_scored: int
    n_listed: int
    complete: bool
    gap: float
    memory_mb: float
    memory_growth_mb: float
    feasible_pairs: int | None
    exhaustive_seconds: float | None
    same_list: bool | None
    largest_difference: float | None
    lp_truth_seconds: float
    lp_truth_consistent: bool
    lp_all_seconds: float | None
    lp_consistent: int | None
    consistent: int | None

    @property
    def job(self) -> Job:
        """The job this is the result of."""
        return Job(self.kind, self.n, self.epsilon_deg, self.seed, self.work_limit)


def measure(job: Job, code: str) -> Row:
    """Rank one scene exactly, then by its peers. Memory means something in a fresh process only."""
    _touch()
    scene, epsilon = simulate(job), math.radians(job.epsilon_deg)
    run = scene.run
    memory_before = _peak_memory()
    exact_seconds, exact = _timed(
        lambda: ms.rank(run, epsilon=epsilon, top_k=TOP_K, work_limit=job.work_limit)
    )
    memory = _peak_memory()
    exhaustive_seconds = same_list = difference = None
    if job.n <= largest_exhaustive(job.epsilon_deg):
        # (8!)^2 hypotheses are more than it agrees to go through; here it shall take its time.
        with patch.object(exhaustive_module, "MAX_HYPOTHESES", sys.maxsize):
            exhaustive_seconds, exhaustive = _timed(
                lambda: ms.rank(run, epsilon=epsilon, top_k=TOP_K, method="exhaustive")
            )
        same_list = [h.association for h in exact] == [h.association for h in exhaustive]
        if len(exact) == len(exhaustive):
            both = zip(exact, exhaustive, strict=True)
            difference = max((abs(a.score - b.score) for a, b in both), default=0.0)
    lp_truth_seconds, truth_consistent = _timed(
        lambda: is_consistent(run, scene.truth, epsilon=epsilon)
    )
    lp_all_seconds = lp_consistent = consistent = None
    if job.n <= LARGEST_LP:
        lp_all_seconds, lp_consistent = _timed(lambda: count_consistent(run, epsilon=epsilon))
        consistent = len(ms.consistent_associations(run, epsilon=epsilon))
    return Row(
        kind=job.kind,
        n=job.n,
        epsilon_deg=job.epsilon_deg,
        seed=job.seed,
        work_limit=job.work_limit,
        code=code,
        exact_seconds=exact_seconds,
        n_steps=exact.n_steps,
        n_scored=exact.n_scored,
        n_listed=len(exact),
        complete=exact.complete,
        gap=exact.gap,
        memory_mb=memory,
        memory_growth_mb=memory - memory_before,
        feasible_pairs=feasible_pairs(run, epsilon=epsilon),
        exhaustive_seconds=exhaustive_seconds,
        same_list=same_list,
        largest_difference=difference,
        lp_truth_seconds=lp_truth_seconds,
        lp_truth_consistent=truth_consistent,
        lp_all_seconds=lp_all_seconds,
        lp_consistent=lp_consistent,
        consistent=consistent,
    )


def largest_exhaustive(epsilon_deg: float) -> int:
    """Most landmarks for which all hypotheses are gone through."""
    return _LARGEST_EXHAUSTIVE_NARROW if epsilon_deg <= _NARROW_DEG else _LARGEST_EXHAUSTIVE


def _touch() -> None:
    """Go through both methods once: a forked process copies pages on their first use."""
    run = simulate(Job("one_sided", 5, 1.0, 0, 0)).run
    for method in ("exact", "exhaustive"):
        ms.rank(run, epsilon=math.radians(1.0), top_k=TOP_K, method=method)


def simulate(job: Job) -> Scene:
    """Simulate the scene of a job: noise uniform inside epsilon, every landmark seen thrice."""
    rng = np.random.default_rng([job.seed, job.n])
    return simulate_scene(job.kind, job.n, rng, epsilon=math.radians(job.epsilon_deg))


def warm_up() -> float:
    """Compile, or load, everything that a job calls; return the seconds this took."""
    start = time.perf_counter()
    measure(Job("annulus", 3, 1.0, 0, 1000), code="")
    measure(Job("one_sided", 5, 3.0, 0, 1000), code="")
    return time.perf_counter() - start


def compile_seconds() -> tuple[float, float]:
    """Seconds of `warm_up` in a new process: with nothing compiled yet, and with all compiled."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        command = [sys.executable, str(Path(__file__).resolve())]
        cold, warm = (
            float(
                subprocess.run(  # noqa: S603 - this very file
                    command, env=environment, check=True, capture_output=True, text=True
                ).stdout
            )
            for _ in range(2)
        )
    return cold, warm


def code_version() -> str:
    """Short digest of the sources of the ranking: rows of different code are not comparable."""
    package = Path(ms.__file__).parent / "polygon"
    digest = hashlib.sha256()
    for source in sorted(package.glob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:8]


def _timed(call: Callable[[], T]) -> tuple[float, T]:
    start = time.process_time()
    result = call()
    return time.process_time() - start, result


def _peak_memory() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _MEGABYTES


if __name__ == "__main__":
    print(warm_up())
