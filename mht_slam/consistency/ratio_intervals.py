"""Intervals of the step ratio that cones of bounded error leave to a landmark, rounded outward.

Everything here is docs/method.md, section 2: with u = 1/y and v = x/y a landmark's cotangents are
v - X u, so on the left of the line of travel they fall from scan to scan, and the right is its
mirror image. An interval is empty where its lowest ratio lies above its highest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import EllipsisType

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray

ANGLE_SLACK = 4e-15
"""Radians added to epsilon: what rounding may do to a bearing of a few radians."""

ROUNDING = float(np.finfo(np.float64).eps)

RELATIVE_SLACK = 4.0 * ROUNDING
"""Share by which a computed bound moves outward: it comes from at most four roundings."""

Index = slice | None | int | IntArray | BoolArray | EllipsisType
Interval = tuple[float, float]


@dataclass(frozen=True)
class Cones:
    """Cotangents that the cones of some detections hold, on either side of the line of travel.

    Attributes
    ----------
    lowest, highest : (2, ...) on the left and, mirrored, on the right. Where a cone contains the
        line of travel, inf is the highest ahead and -inf the lowest behind. A cone that has no
        part on a side has lowest inf and highest -inf there.
    """

    lowest: FloatArray
    highest: FloatArray

    @classmethod
    def of(cls, bearings: FloatArray, epsilon: float) -> Cones:
        """Cones of half-opening `epsilon` < pi/2 around `bearings`, radians in (-pi, pi]."""
        centre = np.stack([bearings, -bearings])
        reach = epsilon + ANGLE_SLACK
        first, last = centre - reach, centre + reach
        ahead = (first < 0.0) & (last > 0.0)
        behind = (last > np.pi) | (first < -np.pi)
        absent = (centre < 0.0) & ~ahead & ~behind
        with np.errstate(divide="ignore"):
            highest = np.cos(first) / np.sin(first)
            lowest = np.cos(last) / np.sin(last)
        highest += RELATIVE_SLACK * np.abs(highest)
        lowest -= RELATIVE_SLACK * np.abs(lowest)
        highest[ahead], lowest[behind] = np.inf, -np.inf
        highest[absent], lowest[absent] = -np.inf, np.inf
        return cls(lowest, highest)

    def at(self, *index: Index) -> Cones:
        """The cones that `index` chooses or broadcasts, on both sides."""
        return Cones(self.lowest[:, *index], self.highest[:, *index])

    @property
    def present(self) -> BoolArray:
        """(2, ...) whether a cone has a part on the side."""
        return np.asarray(self.lowest <= self.highest)


def pair_meets(earlier: Cones, later: Cones) -> BoolArray:
    """Whether two cones can hold one landmark: its cotangent must fall. The arrays broadcast."""
    return np.asarray((earlier.highest > later.lowest).any(axis=0))


def ratio_intervals(first: Cones, second: Cones, third: Cones) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest ratio, second step over first, that three cones leave to one landmark.

    The arrays broadcast. Both ends belong to the interval unless they are 0 and inf. The two sides
    of the line of travel together leave one interval, because the points and steps that three
    cones allow form a convex set.
    """
    possible = (
        (first.highest > second.lowest)
        & (second.highest > third.lowest)
        & (first.highest > third.lowest)
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        lowest = (second.lowest - third.highest) / (first.highest - second.lowest)
        highest = (second.highest - third.lowest) / (first.lowest - second.highest)
    above_zero = second.lowest > third.highest
    bounded = first.lowest > second.highest
    lowest = np.where(above_zero, lowest * (1.0 - RELATIVE_SLACK), 0.0)
    highest = np.where(bounded, highest * (1.0 + RELATIVE_SLACK), np.inf)
    lowest = np.where(possible, lowest, np.inf).min(axis=0)
    highest = np.where(possible, highest, -np.inf).max(axis=0)
    return lowest, highest


def shared_ratios(cones: Sequence[Cones]) -> Interval:
    """Ratios that three scans leave if they see the same landmarks, whatever the association.

    The cotangents of all landmarks of one side add up to those of one landmark. That needs every
    cone on one side of the line of travel; where one contains it, every ratio is left.
    """
    if any(scan.present.all(axis=0).any() for scan in cones):
        return (0.0, np.inf)
    interval = (0.0, np.inf)
    for side in range(2):
        members = [scan.present[side] for scan in cones]
        counts = {int(seen.sum()) for seen in members}
        if counts == {0}:
            continue
        if len(counts) > 1:
            return (np.inf, -np.inf)
        sums = [_sum(scan, side, seen) for scan, seen in zip(cones, members, strict=True)]
        lowest, highest = ratio_intervals(*sums)
        interval = (max(interval[0], float(lowest)), min(interval[1], float(highest)))
    return interval


def _sum(scan: Cones, side: int, members: BoolArray) -> Cones:
    """The sum of the cotangents of some cones, as if it were the cone of one landmark."""
    lowest, highest = scan.lowest[side, members], scan.highest[side, members]
    rounding = len(lowest) * ROUNDING
    return Cones(
        np.array([lowest.sum() - rounding * np.abs(lowest).sum()]),
        np.array([highest.sum() + rounding * np.abs(highest).sum()]),
    )
