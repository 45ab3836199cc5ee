"""Scans taken at the same place: the robot stood still where no bearing changed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from mht_slam.arrays import FloatArray
from mht_slam.measurements import BearingScan, wrap_angle

FARTHEST = 2.0
"""Standard deviations of a difference within which two bearings count as unchanged."""
MEAN_SQUARE = 1.5
"""Largest mean of their squares: 1 at a standstill, more where landmarks move a little."""
MIN_PAIRS = 4
MIN_SHARE = 0.75
"""Of the smaller scan's detections, the share that must be unchanged."""


def standstills(scans: Sequence[BearingScan], sigmas: Sequence[FloatArray]) -> tuple[bool, ...]:
    """Return for each step whether the robot stood still: m - 1 values for m scans.

    Every scan is compared with the first of those taken at the same place, so that creeping away
    shows. Bearings are paired by least squares of their differences in standard deviations.
    """
    still = []
    anchor = 0
    for k in range(1, len(scans)):
        still.append(_same_place(scans[anchor], sigmas[anchor], scans[k], sigmas[k]))
        if not still[-1]:
            anchor = k
    return tuple(still)


def _same_place(
    one: BearingScan, one_sigmas: FloatArray, other: BearingScan, other_sigmas: FloatArray
) -> bool:
    if min(len(one), len(other)) < MIN_PAIRS:
        return False
    turned = wrap_angle(one.bearings[:, None] - other.bearings)
    squares = turned**2 / (one_sigmas[:, None] ** 2 + other_sigmas**2)
    pairs = linear_sum_assignment(np.minimum(squares, 2.0 * FARTHEST**2))
    unchanged = squares[pairs]
    unchanged = unchanged[unchanged <= FARTHEST**2]
    enough = max(MIN_PAIRS, MIN_SHARE * min(len(one), len(other)))
    return len(unchanged) >= enough and float(unchanged.mean()) <= MEAN_SQUARE
