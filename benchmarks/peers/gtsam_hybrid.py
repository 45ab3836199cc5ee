"""Peer: GTSAM's hybrid elimination, all associations at once at one shared linearisation point."""

from __future__ import annotations

import gtsam
from peer_graphs import DiscreteGraph, full_tables, problem_of
from peer_registry import peer

from mht_slam import Association, StraightRun
from mht_slam.errors import OptionError
from mht_slam.evaluation.bench.case import Assumptions
from mht_slam.graph.build import FactorPool

RELINEARISATIONS = 10
STILL = 1e-6
"""A smaller step of the estimate is none: more relinearisations would change nothing."""
MOST_LANDMARKS = 4
"""With five the tree of choices has 5^10 leaves."""


@peer("GTSAM hybrid, ten relinearisations")
def gtsam_hybrid(run: StraightRun, assumptions: Assumptions) -> list[tuple[Association, float]]:
    """Eliminate the graph with one variable per landmark and later scan, ten times over.

    Each time the most probable association moves the linearisation point of all. Where an
    elimination fails, what the one before it said stands; where the first one fails the exception
    is passed on, and so is `OptionError` for more than four landmarks. Scores are probabilities.
    """
    n = len(run.scans[0])
    if n > MOST_LANDMARKS:
        raise OptionError(f"the scans have {n} detections: at most {MOST_LANDMARKS} fit in memory")
    graph = DiscreteGraph(FactorPool(problem_of(run, assumptions)), n)
    values = graph.start()
    net, best = _eliminated(graph, values)
    try:
        for _ in range(RELINEARISATIONS - 1):
            delta = best.continuous()
            if delta.norm() <= STILL:
                break
            values = values.retract(delta)
            net, best = _eliminated(graph, values)
    except RuntimeError:  # all that GTSAM raises
        pass
    return _probabilities(graph, net)


def _eliminated(
    graph: DiscreteGraph, values: gtsam.Values
) -> tuple[gtsam.HybridBayesNet, gtsam.HybridValues]:
    """Eliminate all variables; raises where no association has a probability left."""
    net = graph.graph(values).linearize(values).eliminateSequential()
    return net, net.optimize()


def _probabilities(
    graph: DiscreteGraph, net: gtsam.HybridBayesNet
) -> list[tuple[Association, float]]:
    choices = net.discreteMarginal()
    weights = [
        (graph.association_of(table), float(choices.evaluate(graph.values_of(table))))
        for table in full_tables(graph.n)
    ]
    total = sum(weight for _, weight in weights)
    return [(association, weight / total) for association, weight in weights]
