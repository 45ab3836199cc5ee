"""The map of a run: landmarks, how often each was seen, and how sure its place is."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L

from mht_slam.arrays import BoolArray, FloatArray, IntArray, freeze
from mht_slam.incremental.whole_run import WholeRun

CONFIRMED = 5
"""Detections that confirm a landmark: what false alarms and mistakes at a run's start leave behind
was seen less often."""


@dataclass(frozen=True, eq=False)
class SlamMap:
    """Landmarks in the frame of the first pose; ``np.asarray(map)`` is `points`.

    Attributes
    ----------
    numbers : (n,) names of the landmarks, the same as long as no loop renames them.
    points : (n, 2), row i that of row i of the estimator's `association`.
    sightings : (n,) detections of each.
    """

    numbers: IntArray
    points: FloatArray
    sightings: IntArray
    _at: IntArray = field(repr=False)
    _whole_run: WholeRun = field(repr=False)

    def __len__(self) -> int:
        return len(self.points)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> FloatArray:
        return np.array(self.points, dtype=dtype)

    @property
    def confirmed(self) -> BoolArray:
        """(n,) whether a landmark was seen often enough to be more than two false alarms."""
        return np.asarray(self.sightings >= CONFIRMED)

    @cached_property
    def covariances(self) -> FloatArray:
        """(n, 2, 2) marginal covariances in the smoothed graph, on demand."""
        marginals = gtsam.Marginals(self._whole_run.graph, self._whole_run.values)
        found = [marginals.marginalCovariance(L(i)) for i in self._at.tolist()]
        return freeze(np.array(found).reshape(-1, 2, 2))
