"""Peer: Levenberg-Marquardt on the graph of every association, the densest optimum first."""

from __future__ import annotations

from collections.abc import Iterator

import gtsam
import numpy as np
from peer_graphs import (
    extracted_poses,
    full_tables,
    log_density,
    poses_with_step,
    problem_of,
    step_of,
)
from peer_registry import peer

from mht_slam import Association, StraightRun
from mht_slam.arrays import FloatArray, IntArray
from mht_slam.evaluation.bench.case import Assumptions
from mht_slam.graph.build import build_graph, graph_keys, make_values
from mht_slam.graph.problem import Problem

START_STEPS = (0.5, 1.0, 2.0)
"""Second steps to start from, baselines."""
FARTHEST_START = 10.0
"""Range of a landmark whose first two rays do not meet closer, baselines."""
MOST_ROUNDS = 5
"""The step prior is log-normal: it is linearised anew until the step stands still."""
STILL = 1e-3
PARAMETERS = gtsam.LevenbergMarquardtParams.CeresDefaults()


@peer("exhaustive LM over (n!)^2")
def exhaustive_lm(
    run: StraightRun, assumptions: Assumptions
) -> Iterator[tuple[Association, float]]:
    """Optimise all (n!)^2 graphs with our graph's own factors and priors; score by log density.

    Every graph is started from triangulated landmarks and three steps, and the best optimum counts.
    No evidence: all graphs have the same unknowns, and the density at the optimum is the score.
    An association whose every start fails is not listed.
    """
    problem = problem_of(run, assumptions)
    for table in full_tables(len(run.scans[0])):
        found = [_optimum(problem, table, step) for step in START_STEPS]
        densities = [density for density in found if density is not None]
        if densities:
            yield Association(table, run.n_detections), max(densities)


def _optimum(problem: Problem, table: IntArray, step: float) -> float | None:
    """Log density where the optimiser stops, None where it goes astray."""
    keys = graph_keys(len(problem.scans), len(table))
    values = make_values(keys, poses_with_step(step), _triangulated(problem, table))
    try:
        for _ in range(MOST_ROUNDS):
            graph = build_graph(problem, table, extracted_poses(values))
            values = gtsam.LevenbergMarquardtOptimizer(graph, values, PARAMETERS).optimize()
            before, step = step, step_of(values)
            if abs(step / before - 1.0) <= STILL:
                break
    except (RuntimeError, ArithmeticError):  # GTSAM's own errors are RuntimeErrors
        return None
    density = log_density(problem, table, values)
    return density if np.isfinite(density) else None


def _triangulated(problem: Problem, table: IntArray) -> FloatArray:
    """(n, 2) places where the first two rays meet; far out on the first one where they do not."""
    first, second = (problem.scans[k].bearings[table[:, k]] for k in (0, 1))
    with np.errstate(divide="ignore"):
        ranges = np.sin(second) / np.sin(second - first)
    ranges = np.where((ranges > 0.0) & (ranges < FARTHEST_START), ranges, FARTHEST_START)
    return ranges[:, None] * np.column_stack([np.cos(first), np.sin(first)])
