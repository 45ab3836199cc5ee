"""Peer: GTSAM's DCSAM, which alternates between choosing detections and moving the estimate."""

from __future__ import annotations

import gtsam
import numpy as np
from peer_graphs import START_RANGE, START_STEP, DiscreteGraph, log_density, problem_of
from peer_registry import peer

from mht_slam import Association, StraightRun
from mht_slam.errors import AssociationError
from mht_slam.evaluation.bench.case import Assumptions
from mht_slam.graph.build import FactorPool

STARTS = 20
UPDATES = 10
"""Alternations after the first one."""
RANGE_SPREAD, STEP_SPREAD = 0.6, 0.5
"""Standard deviations of the logarithms of the other starts' ranges and steps."""


@peer("GTSAM DCSAM, 1 start")
def dcsam_once(run: StraightRun, assumptions: Assumptions) -> list[tuple[Association, float]]:
    """Start once, the landmarks on the first scan's rays; whatever is raised is passed on."""
    graph = DiscreteGraph(FactorPool(problem_of(run, assumptions)), len(run.scans[0]))
    return [_answer(graph, graph.start())]


@peer(f"GTSAM DCSAM, best of {STARTS}")
def dcsam_best(run: StraightRun, assumptions: Assumptions) -> list[tuple[Association, float]]:
    """Start twenty times, and score what comes out by log density.

    The first start is that of `dcsam_once`, the others have random ranges and steps about it. One
    that raises is left out; where all do, the last exception is passed on. The draws hang on
    nothing but the run.
    """
    graph = DiscreteGraph(FactorPool(problem_of(run, assumptions)), len(run.scans[0]))
    rng = np.random.default_rng(np.frombuffer(run.scans[0].bearings.tobytes(), dtype=np.uint32))
    starts = [graph.start()]
    for _ in range(STARTS - 1):
        ranges = START_RANGE * rng.lognormal(0.0, RANGE_SPREAD, graph.n)
        starts.append(graph.start(ranges, START_STEP * rng.lognormal(0.0, STEP_SPREAD)))
    answers: list[tuple[Association, float]] = []
    failures: list[Exception] = []
    for start in starts:
        try:
            answers.append(_answer(graph, start))
        except (RuntimeError, AssociationError) as cause:  # GTSAM's own errors are RuntimeErrors
            failures.append(cause)
    if not answers:
        raise failures[-1]
    return answers


def _answer(graph: DiscreteGraph, values: gtsam.Values) -> tuple[Association, float]:
    """Alternate from a start; return the association and the log density at the estimate.

    What comes out may give two landmarks one detection, which is an `AssociationError`.
    """
    solver = gtsam.DCSAM()
    table = np.repeat(np.arange(graph.n)[:, None], 3, axis=1)
    solver.update(graph.graph(values), gtsam.HybridValues(graph.values_of(table), values))
    for _ in range(UPDATES):
        solver.update()
    estimate = solver.calculateEstimate()
    table = graph.table_of(estimate.discrete())
    density = log_density(graph.pool.problem, table, estimate.nonlinear())
    return graph.association_of(table), density
