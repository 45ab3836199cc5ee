"""What all branches of a tree share: the scans, their model, and factors made once."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from mht_slam import factors
from mht_slam.arrays import FloatArray, finite_number
from mht_slam.evidence.visibility import log_visibility
from mht_slam.graph.problem import Problem


@dataclass(frozen=True)
class Setting:
    """The problem over all scans of the run, and a pool of its factors.

    A landmark is known by the number of its first detection, counted over all scans: so branches
    that agree on it share its key and its factors. `NonlinearFactorGraph` keeps pointers, and a
    branch's graph is its parent's with a few factors more.
    """

    problem: Problem
    _pool: dict[tuple[int, ...], tuple[gtsam.NonlinearFactor, float]] = field(default_factory=dict)
    _lonely: dict[int, FloatArray] = field(default_factory=dict)

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

    def sighting(
        self, scan: int, detection: int, landmark: int
    ) -> tuple[gtsam.NonlinearFactor, float]:
        """Return the bearing factor of a detection of a landmark, and its log normaliser."""
        key = (scan, detection, landmark)
        if key not in self._pool:
            factor = factors.bearing(
                X(scan),
                L(landmark),
                float(self.problem.scans[scan].bearings[detection]),
                float(self.problem.sigmas[scan][detection]),
                self.problem.model.bearing_dof,
            )
            self._pool[key] = factor, factors.log_normaliser(factor)
        return self._pool[key]

    def prior(self, landmark: int) -> tuple[gtsam.NonlinearFactor, float]:
        """Return the prior of a landmark, and its log normaliser."""
        key = (landmark,)
        if key not in self._pool:
            model = self.problem.model
            factor = factors.landmark_prior(
                L(landmark), model.landmark_centre, model.landmark_sigma
            )
            self._pool[key] = factor, factors.log_normaliser(factor)
        return self._pool[key]

    def lonely(self, n_scans: int) -> FloatArray:
        """Return (n_scans,) log chances of a detection in one scan and none in the others."""
        if n_scans not in self._lonely:
            self._lonely[n_scans] = log_visibility(
                np.eye(n_scans, dtype=np.bool_),
                self.detection_probability,
                self.problem.model.stay_probability,
            )
        return self._lonely[n_scans]
