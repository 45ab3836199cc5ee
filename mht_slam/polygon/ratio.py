"""Intersection ratios of regions in F_L."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.compiled import compiled
from mht_slam.polygon.cones import ComplexArray
from mht_slam.polygon.convex import polygon_area, shared_area

RATIOS = ("iou", "overlap")

NEGLIGIBLE = 1e-12
"""Regions that share less of the smaller one only touch, as far as rounding tells."""


@dataclass(frozen=True)
class Outlines:
    """Convex polygons side by side.

    Attributes
    ----------
    corners : (N, W) complex, counter-clockwise; row i means its first ``count[i]`` entries.
    count : (N,) number of corners.
    """

    corners: ComplexArray
    count: IntArray

    @classmethod
    def of(cls, outlines: Sequence[ComplexArray]) -> Outlines:
        """Copy polygons of different numbers of corners into one array."""
        count = np.array([len(outline) for outline in outlines], dtype=np.int64)
        corners = np.zeros((len(outlines), count.max(initial=1)), dtype=np.complex128)
        for row, outline in zip(corners, outlines, strict=True):
            row[: len(outline)] = outline
        return cls(corners, count)

    def __len__(self) -> int:
        return len(self.count)

    def __getitem__(self, chosen: IntArray) -> Outlines:
        return Outlines(self.corners[chosen], self.count[chosen])


def ratio_table(first: Outlines, second: Outlines, ratio: str) -> FloatArray:
    """Intersection ratio of every region in `first` (a,) with every one in `second` (b,).

    Returns (a, b) in [0, 1]: ``"iou"`` is intersection over union, ``"overlap"`` intersection over
    the smaller area. Those of regions without area are 0. Source: docs/method.md, section 3.
    """
    table = np.zeros((len(first), len(second)))
    _fill(first.corners, first.count, second.corners, second.count, ratio == "iou", table)
    return table


@compiled
def intersection_ratio(
    first: ComplexArray,
    second: ComplexArray,
    area_first: float,
    area_second: float,
    of_union: bool,
) -> float:
    """Area that two convex polygons share, over their union or over the smaller one."""
    smaller = min(area_first, area_second)
    if smaller <= 0.0:
        return 0.0
    shared = shared_area(first, len(first), second, len(second))
    if shared <= NEGLIGIBLE * smaller:
        return 0.0
    return min(shared / (area_first + area_second - shared if of_union else smaller), 1.0)


@compiled
def _fill(
    first: ComplexArray,
    n_first: IntArray,
    second: ComplexArray,
    n_second: IntArray,
    of_union: bool,
    table: FloatArray,
) -> None:
    boxes_1, areas_1 = _boxes_and_areas(first, n_first)
    boxes_2, areas_2 = _boxes_and_areas(second, n_second)
    for i in range(len(first)):
        a = boxes_1[i]
        for j in range(len(second)):
            b = boxes_2[j]
            if a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]:
                table[i, j] = intersection_ratio(
                    first[i][: n_first[i]],
                    second[j][: n_second[j]],
                    areas_1[i],
                    areas_2[j],
                    of_union,
                )


@compiled
def _boxes_and_areas(corners: ComplexArray, count: IntArray) -> tuple[FloatArray, FloatArray]:
    """(N, 4) least x, least y, largest x, largest y; and (N,) areas."""
    boxes, areas = np.empty((len(count), 4)), np.empty(len(count))
    for i in range(len(count)):
        own = corners[i][: count[i]]
        boxes[i] = (own.real.min(), own.imag.min(), own.real.max(), own.imag.max())
        areas[i] = polygon_area(own, count[i])
    return boxes, areas
