"""Methods that tests of the comparison use; a module that worker processes can import."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from mht_slam.association import Association
from mht_slam.evaluation.baselines import order_keeping
from mht_slam.evaluation.bench.case import Assumptions
from mht_slam.evaluation.bench.methods import Answers, Method
from mht_slam.measurements import StraightRun


def mine(run: StraightRun, assumptions: Assumptions) -> Answers:
    """Keep the order, nearly sure of it."""
    assert assumptions.epsilon > 0.0
    return [(order_keeping(run), 0.75)]


def raises(run: StraightRun, assumptions: Assumptions) -> Answers:
    raise RuntimeError(f"no idea about {len(run)} scans <b>at all</b> {assumptions.epsilon}")


def returns_nothing(_run: StraightRun, _assumptions: Assumptions) -> Answers:
    return []


def of_other_scans(_run: StraightRun, _assumptions: Assumptions) -> Answers:
    return [(Association([[0, 0]], (1, 1)), 1.0)]


def kills_its_worker_once(run: StraightRun, assumptions: Assumptions) -> Answers:
    """Leave a mark, and on the first call of all kill the process."""
    marker = Path(os.environ["BENCH_TEST_MARKER"])
    try:
        marker.touch(exist_ok=False)
    except FileExistsError:
        return mine(run, assumptions)
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError("a killed process goes on")


def counted(run: StraightRun, assumptions: Assumptions) -> Answers:
    """Write down every call: which bearings, so that a scene done twice shows."""
    with Path(os.environ["BENCH_TEST_CALLS"]).open("a", encoding="utf-8") as file:
        file.write(run.scans[0].bearings.tobytes().hex() + "\n")
    return mine(run, assumptions)


CHEAP = Method(mine, weighs_candidates=False)
RAISES = Method(raises, weighs_candidates=False)
NOTHING = Method(returns_nothing, weighs_candidates=False)
OTHER_SCANS = Method(of_other_scans, weighs_candidates=False)
KILLS = Method(kills_its_worker_once, weighs_candidates=False)
COUNTED = Method(counted, weighs_candidates=False)
