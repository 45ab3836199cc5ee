"""Scans taken at the same place: the robot stood still where no bearing changed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from mht_slam.arrays import FloatArray
from mht_slam.measurements import BearingScan, wrap_angle

MOVED = 5.0
"""How far bearings turn where the robot moves, in standard deviations of a difference.

Farther landmarks turn less, nearer ones more; a wrong value costs little.
"""
WORST = -1.0
"""Nats that one pair of bearings says against a standstill at most: detections may be false."""
ENOUGH = 4.0
"""Nats in favour that make a standstill."""


def standstills(scans: Sequence[BearingScan], sigmas: Sequence[FloatArray]) -> tuple[bool, ...]:
    """Return for each step whether the robot stood still: m - 1 values for m scans.

    Every scan is compared with the first of those taken at the same place, so that creeping away
    shows. Bearings are paired by least squares of their differences d in standard deviations; a
    pair speaks for a standstill by

        ln N(d; 0, 1) - ln N(d; 0, 1 + MOVED^2),

    and the robot stood still where all pairs together say so clearly. Bearings with two partners
    within `MOVED` are left out: among many, some partner is near by chance.
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
    if not (len(one) and len(other)):
        return False
    turned = wrap_angle(one.bearings[:, None] - other.bearings)
    squares = turned**2 / (one_sigmas[:, None] ** 2 + other_sigmas**2)
    broad = 1.0 + MOVED**2
    nats = np.maximum(0.5 * np.log(broad) - 0.5 * squares * (1.0 - 1.0 / broad), WORST)
    rows, columns = linear_sum_assignment(nats, maximize=True)
    near = squares <= MOVED**2
    alone = (near.sum(axis=1)[rows] <= 1) & (near.sum(axis=0)[columns] <= 1)
    return float(nats[rows, columns][alone].sum()) >= ENOUGH
