"""The slow oracle: one linear program over all landmarks and observation points at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pytest
from scipy.optimize import linprog

Floats = npt.NDArray[np.float64]
Explains: TypeAlias = Callable[..., bool]
StepRange: TypeAlias = Callable[..., tuple[float, float]]
Table: TypeAlias = Sequence[Sequence[int]]

TOLERANCE = 1e-9
"""Baselines by which a landmark may lie outside a cone."""


@pytest.fixture(scope="session")
def explains() -> Explains:
    """See `least_violation`."""
    return lambda *args, **options: least_violation(*args, **options) <= TOLERANCE


@pytest.fixture(scope="session")
def step_range() -> StepRange:
    """See `ends_of_step`."""
    return ends_of_step


def least_violation(
    bearings: Sequence[Floats],
    table: Table,
    epsilon: float,
    *,
    within: tuple[float, float] = (0.02, 50.0),
) -> float:
    """How far a landmark has to lie outside a cone, at best, with steps `within` these bounds.

    Asking for the violation instead of a feasible point: the solver leaves degenerate feasibility
    problems undecided, and this one always has a solution.
    """
    rows, right = cone_edges(bearings, table, epsilon)
    n_steps, n_points = len(bearings) - 2, 2 * len(table)
    return solved(
        np.append(np.zeros(n_steps + n_points), 1.0),
        np.column_stack([rows, -np.ones(len(rows))]),
        right,
        [within] * n_steps + [(None, None)] * n_points + [(0.0, None)],
    )


def ends_of_step(
    bearings: Sequence[Floats], table: Table, epsilon: float, *, step: int
) -> tuple[float, float]:
    """Smallest and largest step of a table that is explained."""
    rows, right = cone_edges(bearings, table, epsilon)
    objective = np.zeros(rows.shape[1])
    objective[step] = 1.0
    bounds = [(0.01, 100.0)] * (len(bearings) - 2) + [(None, None)] * (2 * len(table))
    return solved(objective, rows, right, bounds), -solved(-objective, rows, right, bounds)


def cone_edges(bearings: Sequence[Floats], table: Table, epsilon: float) -> tuple[Floats, Floats]:
    """Rows and right-hand sides: cross(d, p - (X, 0)) >= 0 of both edges of every cone.

    Unknowns: the steps after the first, then every landmark's point.
    """
    n_steps = len(bearings) - 2
    rows, right = [], []
    for landmark, row in enumerate(table):
        for scan, detection in enumerate(row):
            if detection < 0:
                continue
            bearing = bearings[scan][detection]
            for edge, sign in ((bearing - epsilon, 1.0), (bearing + epsilon, -1.0)):
                dx, dy = np.cos(edge), np.sin(edge)
                at_most = np.zeros(n_steps + 2 * len(table))
                at_most[n_steps + 2 * landmark] = sign * dy
                at_most[n_steps + 2 * landmark + 1] = -sign * dx
                at_most[: max(0, scan - 1)] = -sign * dy
                rows.append(at_most)
                right.append(sign * dy if scan >= 1 else 0.0)
    return np.array(rows), np.array(right)


def solved(objective: Floats, rows: Floats, right: Floats, bounds: list[Any]) -> float:
    options = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    outcome = linprog(objective, A_ub=rows, b_ub=right, bounds=bounds, options=options)
    assert outcome.status == 0, outcome.message
    return float(outcome.fun)
