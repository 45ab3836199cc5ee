"""The peer: is an association consistent, decided by one linear program over the whole scene.

It answers another question than the ranking: whether one robot path and one set of landmarks
explain every bearing within epsilon, not how well the regions of two pairs of scans agree.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog

from mht_slam import Association, StraightRun

SHORTEST_STEP = 1e-6
"""Steps are positive, and a linear program has closed bounds: baselines."""

FEASIBLE, INFEASIBLE = 0, 2


def is_consistent(run: StraightRun, association: Association, *, epsilon: float) -> bool:
    """Decide with a zero objective: one to be minimised may be unbounded over open cones.

    Unknowns are the step from O2 to O3 and every landmark's point, in the run's frame. A landmark
    p lies in the cone between the directions d1 and d2 from an observation point o when
    cross(d1, p - o) >= 0 >= cross(d2, p - o), which is linear in both. Raises `RuntimeError` where
    the solver does not decide. Source: docs/method.md, section 2.
    """
    rows, right = _cone_edges(run, association.table, epsilon)
    n_points = rows.shape[1] - 1
    answer = linprog(
        np.zeros(1 + n_points),
        A_ub=rows,
        b_ub=right,
        bounds=[(SHORTEST_STEP, None)] + [(None, None)] * n_points,
        method="highs",
    )
    if answer.status not in (FEASIBLE, INFEASIBLE):
        raise RuntimeError(f"the linear program was not decided: {answer.message}")
    return bool(answer.status == FEASIBLE)


def count_consistent(run: StraightRun, *, epsilon: float) -> int:
    """Go through all (n!)^2 full associations of three scans, one linear program each."""
    n = len(run.scans[1])
    orders = [np.array(order) for order in permutations(range(n))]
    tables = (np.stack([a, np.arange(n), b], axis=1) for a in orders for b in orders)
    return sum(
        is_consistent(run, Association(table, (n, n, n)), epsilon=epsilon) for table in tables
    )


def _cone_edges(
    run: StraightRun, table: npt.NDArray[np.int64], epsilon: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Rows and right-hand sides of all cones' two edges, as ``rows @ unknowns <= right``."""
    n = len(table)
    bearings = np.stack(
        [scan.bearings[table[:, column]] for column, scan in enumerate(run.scans[:3])], axis=1
    )
    rows = np.zeros((n, 3, 2, 1 + 2 * n))
    right = np.zeros((n, 3, 2))
    for edge, outward in enumerate((-1.0, 1.0)):
        dx, dy = np.cos(bearings + outward * epsilon), np.sin(bearings + outward * epsilon)
        for landmark in range(n):
            # cross(d, p - o) = dx p_y - dy p_x + dy o_x, and o_x is 0, 1 and 1 + step.
            rows[landmark, :, edge, 1 + 2 * landmark] = -outward * dy[landmark]
            rows[landmark, :, edge, 2 + 2 * landmark] = outward * dx[landmark]
        rows[:, 2, edge, 0] = outward * dy[:, 2]
        right[:, 1:, edge] = -outward * dy[:, 1:]
    return rows.reshape(-1, 1 + 2 * n), right.ravel()
