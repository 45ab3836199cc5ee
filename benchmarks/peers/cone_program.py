"""Peer: one linear program per association; those with most slack in their cones come first."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from peer_graphs import full_tables
from peer_registry import peer
from scipy.optimize import linprog

from mht_slam import Association, StraightRun
from mht_slam.arrays import FloatArray
from mht_slam.evaluation.bench.case import Assumptions

SHORTEST_STEP = 1e-6
"""Steps are positive, and a linear program has closed bounds: baselines."""
HALVINGS = 12
"""Of the vision error; the slack is known to so many binary digits."""
FEASIBLE, INFEASIBLE = 0, 2


@peer("cone feasibility, linear program")
def cone_program(run: StraightRun, assumptions: Assumptions) -> Iterator[tuple[Association, float]]:
    """List the associations that one path and one map explain within epsilon, by their slack.

    The slack is how far all cones can close, radians, until nothing is left inside: bisection over
    the vision error, a linear program each time. Unknowns are the step from O2 to O3 and 2 n
    coordinates, constraints the 6 n edges of the cones (docs/method.md, section 2).
    """
    epsilon = assumptions.epsilon
    for table in full_tables(len(run.scans[0])):
        bearings = np.stack([run.scans[k].bearings[table[:, k]] for k in range(3)], axis=1)
        if feasible(bearings, epsilon):
            yield Association(table, run.n_detections), epsilon - _tightest(bearings, epsilon)


def feasible(bearings: FloatArray, epsilon: float) -> bool:
    """Whether one step and n points lie in all cones of the (n, 3) bearings, radians.

    A point p lies between the directions d1 and d2 from o when cross(d1, p - o) >= 0 and
    cross(d2, p - o) <= 0; with o on the x axis both are linear in p and o. The objective is zero:
    over open cones any other one might be unbounded. Raises `RuntimeError` where the solver does
    not decide.
    """
    n = len(bearings)
    rows, right = [], []
    for landmark in range(n):
        for scan in range(3):
            for outward in (-1.0, 1.0):
                edge = bearings[landmark, scan] + outward * epsilon
                dx, dy = np.cos(edge), np.sin(edge)
                row = np.zeros(1 + 2 * n)
                row[1 + 2 * landmark : 3 + 2 * landmark] = -outward * dy, outward * dx
                row[0] = outward * dy if scan == 2 else 0.0
                rows.append(row)
                right.append(0.0 if scan == 0 else -outward * dy)
    bounds = [(SHORTEST_STEP, None)] + [(None, None)] * (2 * n)
    answer = linprog(np.zeros(1 + 2 * n), A_ub=rows, b_ub=right, bounds=bounds, method="highs")
    if answer.status not in (FEASIBLE, INFEASIBLE):
        raise RuntimeError(f"the linear program was not decided: {answer.message}")
    return bool(answer.status == FEASIBLE)


def _tightest(bearings: FloatArray, epsilon: float) -> float:
    """Smallest vision error found feasible, given that `epsilon` is."""
    low, high = 0.0, epsilon
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if feasible(bearings, middle) else (middle, high)
    return high
