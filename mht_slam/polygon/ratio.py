"""Intersection ratios of regions in F_L."""

from __future__ import annotations

import numpy as np
import shapely

from mht_slam.arrays import BoolArray, FloatArray
from mht_slam.polygon.cones import ObjectArray

RATIOS = ("iou", "overlap")


def ratio_table(
    first: ObjectArray, second: ObjectArray, ratio: str, wanted: BoolArray
) -> FloatArray:
    """Intersection ratio of every region in `first` (a,) with every one in `second` (b,).

    Returns (a, b) in [0, 1]: ``"iou"`` is intersection over union, ``"overlap"`` intersection over
    the smaller area. Entries outside the (a, b) mask `wanted`, and those of regions without area,
    are 0. Source: docs/method.md, section 3.
    """
    table = np.zeros((len(first), len(second)))
    i, j = np.nonzero(wanted & _boxes_meet(first, second))
    if len(i):
        table[i, j] = intersection_ratios(first[i], second[j], ratio)
    return table


def intersection_ratios(first: ObjectArray, second: ObjectArray, ratio: str) -> FloatArray:
    """Intersection ratio of each region in `first` (n,) with its partner in `second` (n,)."""
    shared = shapely.area(shapely.intersection(first, second))
    area_first, area_second = shapely.area(first), shapely.area(second)
    if ratio == "iou":
        whole = area_first + area_second - shared
    else:
        whole = np.minimum(area_first, area_second)
    with_area = np.minimum(area_first, area_second) > 0.0
    ratios: FloatArray = np.where(with_area, shared / np.where(with_area, whole, 1.0), 0.0)
    return np.minimum(ratios, 1.0)


def _boxes_meet(first: ObjectArray, second: ObjectArray) -> BoolArray:
    a = shapely.bounds(first).reshape(-1, 1, 4)
    b = shapely.bounds(second).reshape(1, -1, 4)
    meet: BoolArray = (a[..., :2] <= b[..., 2:]).all(-1) & (b[..., :2] <= a[..., 2:]).all(-1)
    return meet
