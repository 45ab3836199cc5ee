"""The steps of a run that bounds on ratios of its distances leave, by linear programming.

A landmark's cones meet exactly when every three of them do (Helly's theorem in the plane), so all
that landmarks ask of the steps g_1, g_2, ... are, for scans a < b < c, bounds on the ratio of
|O_b O_c| to |O_a O_b|: linear and homogeneous in the steps.

Traps of the solver, HiGHS: it reports thin but true sets as infeasible, although they keep every
row by more than its tolerance, and unbounded ones with a zero objective too. Its verdict is
therefore never asked for: the program is to violate the bounds as little as possible, which always
has a solution. Coefficients below 1e-9 are dropped, so bounds are kept within `EXTREME_RATIO`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import linprog

from mht_slam.arrays import FloatArray

VIOLATION = 1e-8
"""Shares of the shortest step by which bounds may be violated, well above the solver's errors."""

RELAXATIONS = (VIOLATION, 1e-6)
"""Violations, in first baselines, that are allowed where steps are measured, one after another."""

SOLVER_TOLERANCE = 1e-10

EXTREME_RATIO = 1e8
"""Bounds above it, or below its inverse, are relaxed to it."""

_SOLVED, _INFEASIBLE = 0, 2


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

        Exact for three scans. For more, bounds may be violated by `VIOLATION`, and whatever the
        solver cannot decide counts as possible: nothing possible is ever refused.
        """
        if (self.lowest > self.highest).any():
            return False
        rows, n_steps = self._rows(), self.n_scans - 1
        if self.n_scans == 3 or len(rows) == 0:
            return True
        # Where steps exist, they exist at every scale: none needs to be shorter than 1.
        violable = np.column_stack([rows, -np.ones(len(rows))])
        objective = np.append(np.zeros(n_steps), 1.0)
        bounds = [(1.0, None)] * n_steps + [(0.0, None)]
        status, violation = _least(objective, violable, 0.0, bounds)
        return status != _SOLVED or violation <= VIOLATION

    def step_intervals(self) -> FloatArray:
        """(n_scans - 2, 2) smallest and largest |O_k O_k+1|, k >= 2, in first baselines.

        Meaningful where steps exist. Ends that do not exist are 0 and inf.
        """
        if self.n_scans == 3:
            return np.array([[self.lowest[0], self.highest[0]]])
        rows, n_steps = self._rows(), self.n_scans - 1
        first_is_unit = [(1.0, 1.0), *[(0.0, None)] * (n_steps - 1)]
        intervals = np.tile([0.0, np.inf], (n_steps - 1, 1))
        for step in range(1, n_steps):
            for end, sign in enumerate((1.0, -1.0)):
                objective = np.zeros(n_steps)
                objective[step] = sign
                for violation in RELAXATIONS:
                    status, value = _least(objective, rows, violation, first_is_unit)
                    if status != _INFEASIBLE:
                        break
                if status == _SOLVED:
                    outward = sign * (value - VIOLATION * (1.0 + abs(value)))
                    intervals[step - 1, end] = max(0.0, outward)
        return intervals

    def _rows(self) -> FloatArray:
        """Rows A of A g <= 0, coefficients at most 1."""
        before, after = gaps(self.n_scans)
        at_least = self.lowest > 1.0 / EXTREME_RATIO
        at_most = self.highest < EXTREME_RATIO
        low = np.minimum(self.lowest, EXTREME_RATIO)[at_least, None]
        high = np.maximum(self.highest, 1.0 / EXTREME_RATIO)[at_most, None]
        return np.vstack(
            [
                (low * before[at_least] - after[at_least]) / np.maximum(1.0, low),
                (after[at_most] - high * before[at_most]) / np.maximum(1.0, high),
            ]
        )


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


def _least(
    objective: FloatArray,
    rows: FloatArray,
    violation: float,
    bounds: Sequence[tuple[float, float | None]],
) -> tuple[int, float]:
    """The solver's status and the least value of the objective; no row exceeds `violation`."""
    outcome = linprog(
        objective,
        A_ub=rows,
        b_ub=np.full(len(rows), violation),
        bounds=bounds,
        method="highs",
        options={
            "primal_feasibility_tolerance": SOLVER_TOLERANCE,
            "dual_feasibility_tolerance": SOLVER_TOLERANCE,
        },
    )
    return int(outcome.status), np.nan if outcome.fun is None else float(outcome.fun)
