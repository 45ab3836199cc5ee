"""The steps of a run that bounds on ratios of its distances leave, by linear programming.

A landmark's cones meet exactly when every three of them do (Helly's theorem in the plane), so all
that landmarks ask of the steps g_1, g_2, ... are, for scans a < b < c, bounds on the ratio of
|O_b O_c| to |O_a O_b|: linear and homogeneous in the steps.

Traps of the solver, HiGHS: coefficients below 1e-9 are dropped, so bounds are kept within
`EXTREME_RATIO`; a zero objective may be reported infeasible where the set is unbounded, so the
length of the run is minimised instead; presolve may say "infeasible or unbounded" without deciding
which, so such problems are solved once more without it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import linprog

from mht_slam.arrays import FloatArray

STEP_SLACK = 1e-9
"""Share by which bounds move outward for the solver's tolerance."""

SOLVER_TOLERANCE = 1e-10

EXTREME_RATIO = 1e8
"""Bounds above it, or below its inverse, are relaxed to it."""

_SOLVED, _INFEASIBLE, _TROUBLE = 0, 2, 4


@dataclass(frozen=True)
class RatioBounds:
    """Bounds on |O_b O_c| / |O_a O_b| for every three scans a < b < c, in the order of `triples`.

    Attributes
    ----------
    n_scans : number of scans.
    lowest, highest : (number of triples,) what all landmarks together allow.
    """

    n_scans: int
    lowest: FloatArray
    highest: FloatArray

    @property
    def steps_exist(self) -> bool:
        """Whether some positive steps keep all bounds.

        Exact for three scans. For more the solver is given bounds widened by `STEP_SLACK`, and
        whatever it cannot decide counts as possible: nothing possible is ever refused.
        """
        if (self.lowest > self.highest).any():
            return False
        if self.n_scans == 3:
            return True
        n_steps = self.n_scans - 1
        # Where steps exist, they exist at every scale: none needs to be shorter than 1.
        outcome = _solve(self._rows(), np.ones(n_steps), [(1.0, None)] * n_steps)
        return outcome[0] != _INFEASIBLE

    def step_intervals(self) -> FloatArray:
        """(n_scans - 2, 2) smallest and largest |O_k O_k+1|, k >= 2, in first baselines.

        Meaningful where steps exist. Ends that do not exist are 0 and inf.
        """
        if self.n_scans == 3:
            return np.array([[self.lowest[0], self.highest[0]]])
        rows, n_steps = self._rows(), self.n_scans - 1
        unit = [(1.0, 1.0), *[(0.0, None)] * (n_steps - 1)]
        intervals = np.tile([0.0, np.inf], (n_steps - 1, 1))
        for step in range(1, n_steps):
            for end, sign in enumerate((1.0, -1.0)):
                objective = np.zeros(n_steps)
                objective[step] = sign
                status, value = _solve(rows, objective, unit)
                if status == _SOLVED:
                    outward = sign * value - sign * STEP_SLACK * (1.0 + abs(value))
                    intervals[step - 1, end] = max(0.0, outward)
        return intervals

    def _rows(self) -> FloatArray:
        """Rows A of A g <= 0, coefficients at most 1."""
        before, after = gaps(self.n_scans)
        low = np.minimum(self.lowest * (1.0 - STEP_SLACK), EXTREME_RATIO)[:, None]
        high = np.maximum(self.highest * (1.0 + STEP_SLACK), 1.0 / EXTREME_RATIO)[:, None]
        at_least = (low * before - after) / np.maximum(1.0, low)
        inverse = 1.0 / high
        at_most = (after * inverse - before) / np.maximum(1.0, inverse)
        useful = [low[:, 0] > 1.0 / EXTREME_RATIO, high[:, 0] < EXTREME_RATIO]
        return np.vstack([at_least[useful[0]], at_most[useful[1]]])


def triples(n_scans: int) -> list[tuple[int, int, int]]:
    """Every three scans a < b < c; those with the last scan come last."""
    return sorted(combinations(range(n_scans), 3), key=lambda abc: abc[::-1])


def gaps(n_scans: int) -> tuple[FloatArray, FloatArray]:
    """For each of `triples`, which steps make up |O_a O_b| and which |O_b O_c|: (K, m - 1) 0/1."""
    step = np.arange(n_scans - 1)
    a, b, c = np.array(triples(n_scans)).T[:, :, None]
    before = (a <= step) & (step < b)
    after = (b <= step) & (step < c)
    return before.astype(np.float64), after.astype(np.float64)


def _solve(
    rows: FloatArray, objective: FloatArray, bounds: list[tuple[float, float | None]]
) -> tuple[int, float]:
    """Status and smallest value of the objective where rows times steps are not positive."""
    for presolve in (True, False):
        outcome = linprog(
            objective,
            A_ub=rows,
            b_ub=np.zeros(len(rows)),
            bounds=bounds,
            method="highs",
            options={
                "presolve": presolve,
                "primal_feasibility_tolerance": SOLVER_TOLERANCE,
                "dual_feasibility_tolerance": SOLVER_TOLERANCE,
            },
        )
        if outcome.status != _TROUBLE:
            break
    return int(outcome.status), np.nan if outcome.fun is None else float(outcome.fun)
