"""The optimum over bearings and log ranges, where no landmark can hide on an observation point."""

from __future__ import annotations

import math
from collections.abc import Sequence

import gtsam

from mht_slam import factors

MAX_ROUNDS = 40
SETTLED = 1e-4
"""Change of a log range below which the linearised volumes are taken as exact."""
NEAREST = 1e-9
"""Ranges are not taken for less, in the graph's unit."""


def optimise_in_log_range(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    anchors: Sequence[tuple[int, int]],
    parameters: gtsam.LevenbergMarquardtParams,
    *,
    settled: float = SETTLED,
    max_rounds: int = MAX_ROUNDS,
) -> tuple[gtsam.Values, gtsam.NonlinearFactorGraph]:
    """Optimise a graph's density over each landmark's bearing and log range from its anchor.

    With wandering headings the optimum over positions may lie on an observation point, where a
    landmark explains any bearing in a volume of nothing. In these coordinates that point is
    infinitely far away. The change of coordinates multiplies the density by d^2, a factor that is
    linearised at the range d (`mht_slam.factors.log_range_volume`) and renewed until it stands
    still.

    Parameters
    ----------
    anchors : (pose key, landmark key) of each landmark.

    Returns
    -------
    values : the optimum.
    graph : with the volumes added. Laplace's approximation in these coordinates is that of `graph`
        with this Hessian, because the Jacobians of the coordinates cancel at the optimum.
    """
    ranges = _ranges(values, anchors)
    for _ in range(max_rounds):
        with_volumes = gtsam.NonlinearFactorGraph(graph)
        for (pose, landmark), around in zip(anchors, ranges, strict=True):
            with_volumes.push_back(factors.log_range_volume(pose, landmark, around))
        values = gtsam.LevenbergMarquardtOptimizer(with_volumes, values, parameters).optimize()
        before, ranges = ranges, _ranges(values, anchors)
        if all(abs(math.log(a / b)) <= settled for a, b in zip(ranges, before, strict=True)):
            break
    return values, with_volumes


def _ranges(values: gtsam.Values, anchors: Sequence[tuple[int, int]]) -> list[float]:
    return [
        max(float(values.atPose2(pose).range(values.atPoint2(landmark))), NEAREST)
        for pose, landmark in anchors
    ]
