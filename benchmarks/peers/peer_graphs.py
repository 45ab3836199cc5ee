"""What the GTSAM peers share: all full tables, our graph's priors, and where to start."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations, product

import gtsam
import numpy as np
from gtsam.symbol_shorthand import D

from mht_slam import Association, StraightRun, factors
from mht_slam.arrays import FloatArray, IntArray
from mht_slam.evaluation.bench.case import Assumptions
from mht_slam.graph.build import FactorPool, build_graph
from mht_slam.graph.motion import motion_factors
from mht_slam.graph.problem import Problem, make_problem

LATER_SCANS = (1, 2)
_SCANS = (0, 1, 2)
_SHORTEST_STEP = 1e-6


def full_tables(n: int) -> Iterator[IntArray]:
    """Yield all (n!)^2 tables (n, 3) in which row l has detection l of the first scan."""
    orders = [np.array(order, dtype=np.int64) for order in permutations(range(n))]
    for second, third in product(orders, orders):
        yield np.stack([np.arange(n), second, third], axis=1)


def problem_of(run: StraightRun, assumptions: Assumptions) -> Problem:
    """Return the scans with the model, priors included, that our own graph has."""
    return make_problem(run, _SCANS, assumptions.model)


def poses_with_step(step: float) -> FloatArray:
    """(3, 3) poses of a straight run whose second step has this length, baselines."""
    return np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0 + step, 0.0, 0.0]])


def extracted_poses(values: gtsam.Values) -> FloatArray:
    """(m, 3) poses in the values."""
    return np.ascontiguousarray(gtsam.utilities.extractPose2(values))


def log_density(problem: Problem, table: IntArray, values: gtsam.Values) -> float:
    """Log density of bearings, landmarks and poses of an association, all normalisers kept."""
    graph = build_graph(problem, table, extracted_poses(values))
    return float(factors.log_density(graph, values))


START_RANGE = 3.0
"""Baselines from O1 at which all landmarks start: with 1 or 10 fewer of other scenes come right."""
START_STEP = 1.0
"""Baselines; the median of the prior."""


@dataclass(frozen=True)
class DiscreteGraph:
    """One graph over all associations: which detection of scan k is landmark l's is a variable.

    Landmark l is detection l of the first scan. Every branch of such a variable must have the same
    continuous keys in GTSAM, so a landmark chooses its detection, not a detection its landmark;
    that no two choose the same one is a factor of zeros and ones.
    """

    pool: FactorPool
    n: int

    def key(self, scan: int, landmark: int) -> tuple[int, int]:
        """Discrete key, and how many values it has."""
        return D(scan * self.n + landmark), self.n

    def graph(self, values: gtsam.Values) -> gtsam.HybridNonlinearFactorGraph:
        """Return all factors, the step prior linearised at `values`."""
        problem, keys = self.pool.problem, self.pool.keys(self.n)
        graph = gtsam.HybridNonlinearFactorGraph()
        for factor in motion_factors(problem, keys.scans, extracted_poses(values)):
            graph.push_back(factor)
        for landmark in range(self.n):
            graph.push_back(self.pool.prior(landmark)[0])
            graph.push_back(self.pool.bearing(landmark, 0, landmark)[0])
            for scan in LATER_SCANS:
                choices = [self.pool.bearing(landmark, scan, d)[0] for d in range(self.n)]
                graph.push_back(gtsam.HybridNonlinearFactor(self.key(scan, landmark), choices))
        for scan in LATER_SCANS:
            graph.push_back(self._exclusive(scan))
        return graph

    def start(
        self, ranges: FloatArray | float = START_RANGE, step: float = START_STEP
    ) -> gtsam.Values:
        """Put the landmarks on the rays of the first scan, at one range or (n,) `ranges`."""
        bearings = self.pool.problem.scans[0].bearings
        rays = np.stack([np.cos(bearings), np.sin(bearings)])
        return self.pool.values(poses_with_step(step), (ranges * rays).T)

    def values_of(self, table: IntArray) -> gtsam.DiscreteValues:
        """Return a full table as discrete values."""
        values = gtsam.DiscreteValues()
        for landmark, row in enumerate(table.tolist()):
            for scan in LATER_SCANS:
                values[self.key(scan, landmark)[0]] = row[scan]
        return values

    def table_of(self, values: gtsam.DiscreteValues) -> IntArray:
        """(n, 3) table that discrete values stand for."""
        rows = [
            [landmark, *(values[self.key(scan, landmark)[0]] for scan in LATER_SCANS)]
            for landmark in range(self.n)
        ]
        return np.array(rows, dtype=np.int64)

    def association_of(self, table: IntArray) -> Association:
        """Return a full table as an association."""
        return Association(table, (self.n,) * len(_SCANS))

    def _exclusive(self, scan: int) -> gtsam.DecisionTreeFactor:
        keys = gtsam.DiscreteKeys()
        for landmark in range(self.n):
            keys.push_back(self.key(scan, landmark))
        choices = product(range(self.n), repeat=self.n)
        return gtsam.DecisionTreeFactor(keys, [float(len(set(c)) == self.n) for c in choices])


def step_of(values: gtsam.Values) -> float:
    """Distance from O2 to O3, baselines; raises `ArithmeticError` where it is none."""
    poses = extracted_poses(values)
    step = float(poses[2, 0] - poses[1, 0])
    if not step > _SHORTEST_STEP:  # also where it is no number
        raise ArithmeticError(f"the second step is {step:g} baselines")
    return step
