"""Regression gate: a small comparison held against the committed baseline of its key figures.

    python benchmarks/gate/check.py [--workers N] [--baseline FILE] [--write]

Scenes are the same every time, so figures move only with the code. It fails, with exit code 1 and
a line for each, when a figure is worse than its tolerance allows, when a method has disappeared,
and when the comparison itself crashes. --write makes the baseline of what is measured now: look at
the difference before committing it.
"""

from __future__ import annotations

import argparse
import math
import sys
import traceback
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from multiprocessing import get_context
from pathlib import Path

from mht_slam.errors import MhtSlamError
from mht_slam.evaluation.bench.compare import compare
from mht_slam.evaluation.bench.gate import (
    KeyFigure,
    key_figures,
    read_baseline,
    worse_figures,
    write_baseline,
)
from mht_slam.evaluation.bench.summary import summarise
from mht_slam.evaluation.bench.sweep import Sweep

BASELINE = Path(__file__).parents[1] / "baseline.json"
SWEEPS = (
    Sweep(
        kinds=("annulus", "model"),
        landmarks=(3,),
        noises=("gaussian",),
        epsilons=(math.radians(3), math.radians(6)),
        landmark_sigma=10.0,
        scenes=10,
    ),
    Sweep(
        kinds=("annulus",),
        landmarks=(3,),
        noises=("uniform",),
        epsilons=(math.radians(3),),
        heading_sigmas=(math.radians(2),),
        scenes=10,
    ),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, then compare with the baseline or write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--baseline", type=Path, default=BASELINE)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args(arguments)
    try:
        baseline = {} if options.write else read_baseline(options.baseline)
        now = measure(options.workers)
    except (MhtSlamError, OSError) as error:
        print(f"gate: {error}", file=sys.stderr)
        return 1
    except Exception:  # whatever it is, a workload that crashes holds the gate
        traceback.print_exc()
        return 1
    if options.write:
        write_baseline(options.baseline, now)
        print(f"{len(now)} figures in {options.baseline}")
        return 0
    complaints = worse_figures(now, baseline)
    for line in complaints:
        print(line)
    print(f"{len(baseline)} figures, {len(complaints)} worse or gone")
    return 1 if complaints else 0


def measure(workers: int) -> dict[str, KeyFigure]:
    """Return the key figures of the gate's scenes."""
    jobs = [job for sweep in SWEEPS for job in sweep.jobs]
    with ExitStack() as stack:
        executor = None
        if workers > 1:
            pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
            executor = stack.enter_context(pool)
        return key_figures(summarise(compare(jobs, executor=executor)))


if __name__ == "__main__":
    sys.exit(main())
