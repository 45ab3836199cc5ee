"""What all branches of a tree share: the scans, their model, and factors made once."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from mht_slam.arrays import FloatArray, finite_number
from mht_slam.evidence.visibility import log_visibility
from mht_slam.graph.build import FactorPool
from mht_slam.graph.problem import Problem


@dataclass(frozen=True)
class Setting:
    """The problem over all scans of the run, and a pool of its factors.

    A landmark is known by the number of its first detection, counted over all scans: so branches
    that agree on it share its key and its factors. `NonlinearFactorGraph` keeps pointers, and a
    branch's graph is its parent's with a few factors more.
    """

    problem: Problem
    _lonely: dict[int, FloatArray] = field(default_factory=dict)

    @cached_property
    def pool(self) -> FactorPool:
        """Factors by landmark, scan and detection."""
        return FactorPool(self.problem)

    @property
    def detection_probability(self) -> float:
        """P_D; trees have a model that compares sizes."""
        return finite_number(self.problem.model.detection_probability, "detection_probability")

    @property
    def log_landmarks(self) -> float:
        """Log of the expected number of landmarks."""
        expected = self.problem.model.expected_landmarks
        return math.log(finite_number(expected, "expected_landmarks"))

    @property
    def log_false_alarm(self) -> float:
        """Log of the rate of false alarms, -inf where there are none."""
        rate = finite_number(self.problem.model.false_alarm_rate, "false_alarm_rate")
        return math.log(rate) if rate > 0.0 else -math.inf

    @cached_property
    def offsets(self) -> tuple[int, ...]:
        """Number of the first detection of each scan."""
        counts = [len(scan) for scan in self.problem.scans]
        return tuple(np.concatenate([[0], np.cumsum(counts)]).tolist())

    def number(self, scan: int, detection: int) -> int:
        """Return the number of a detection, counted over all scans."""
        return self.offsets[scan] + detection

    def lonely(self, n_scans: int) -> FloatArray:
        """Return (n_scans,) log chances of a detection in one scan and none in the others."""
        if n_scans not in self._lonely:
            self._lonely[n_scans] = log_visibility(
                np.eye(n_scans, dtype=np.bool_),
                self.detection_probability,
                self.problem.model.stay_probability,
            )
        return self._lonely[n_scans]
