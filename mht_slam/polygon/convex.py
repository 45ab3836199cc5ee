"""Convex polygons as arrays of complex corners: hull, area, and the area two of them share.

A polygon is a row of corners, counter-clockwise, of which the first `count` mean something.
"""

from __future__ import annotations

import numpy as np

from mht_slam.arrays import IntArray
from mht_slam.compiled import compiled
from mht_slam.polygon.cones import ComplexArray

_ROUNDING = 1e-15


@compiled
def cross(a: complex, b: complex) -> float:
    """Signed area of the parallelogram that two vectors span."""
    return a.real * b.imag - a.imag * b.real


@compiled
def polygon_area(corners: ComplexArray, count: int) -> float:
    """Area of a counter-clockwise polygon."""
    total = 0.0
    for i in range(1, count - 1):
        total += cross(corners[i] - corners[0], corners[i + 1] - corners[0])
    return 0.5 * total


@compiled
def convex_hull(points: ComplexArray, hull: ComplexArray) -> int:
    """Write the corners of the convex hull of `points` into `hull`; return how many.

    Andrew's monotone chain. `hull` has room for one corner more than there are points. Points in
    one place leave one corner, points on one line two.
    """
    order = _by_place(points)
    count = 0
    for half in range(2):
        floor = count + 1
        for i in range(len(order)):
            point = points[order[i] if half == 0 else order[-1 - i]]
            while count >= floor and (
                hull[count - 1] == point
                or (
                    count > floor
                    and cross(hull[count - 1] - hull[count - 2], point - hull[count - 2]) <= 0.0
                )
            ):
                count -= 1
            hull[count] = point
            count += 1
        count -= 1  # where one half ends the other begins
    return max(count, 1)


@compiled
def _by_place(points: ComplexArray) -> IntArray:
    """Order of the points from left to right, upwards where they are level."""
    order = np.argsort(points.real)
    for i in range(1, len(order)):
        entry = order[i]
        j = i
        while (
            j > 0
            and points[order[j - 1]].real == points[entry].real
            and points[order[j - 1]].imag > points[entry].imag
        ):
            order[j] = order[j - 1]
            j -= 1
        order[j] = entry
    return order


@compiled
def shared_area(first: ComplexArray, n_first: int, second: ComplexArray, n_second: int) -> float:
    """Area of the intersection of two convex polygons.

    Sutherland and Hodgman's clipping: one polygon is cut with the half-plane of every side of the
    other. Corners outside by rounding alone count as inside, or a side as short as rounding, whose
    direction means nothing, would cut off real area.
    """
    if min(n_first, n_second) < 3:
        return 0.0
    rounding = _ROUNDING * _rounding_scale(first[:n_first], second[:n_second])
    here = np.empty(n_first + n_second + 1, dtype=np.complex128)
    there = np.empty_like(here)
    count = n_first
    here[:count] = first[:count]
    for side in range(n_second):
        start = second[side]
        along = second[(side + 1) % n_second] - start
        count = clip(here[:count], start, along, rounding, there)
        if count < 3:
            return 0.0
        here, there = there, here
    return max(polygon_area(here, count), 0.0)


@compiled
def clip(
    polygon: ComplexArray, start: complex, along: complex, rounding: float, clipped: ComplexArray
) -> int:
    """Write the part of a convex polygon on the left of a line into `clipped`; return its corners.

    Corners count as on the left up to an area of `rounding` beside `along`. A line cuts a convex
    polygon twice at most; `clipped` is never written beyond its end, should rounding have it
    otherwise.
    """
    if len(polygon) == 0:
        return 0
    kept = 0
    previous = polygon[-1]
    height = cross(along, previous - start)
    for corner in polygon:
        own = cross(along, corner - start)
        if kept + 2 > len(clipped):
            break
        if (own >= -rounding) != (height >= -rounding):
            share = abs(height) / (abs(height) + abs(own))
            clipped[kept] = previous + (corner - previous) * share
            kept += 1
        if own >= -rounding:
            clipped[kept] = corner
            kept += 1
        previous, height = corner, own
    return kept


@compiled
def _rounding_scale(first: ComplexArray, second: ComplexArray) -> float:
    """Largest coordinate times largest extent, which rounding errors of areas go with."""
    largest = extent = 0.0
    for corners in (first, second):
        for corner in corners:
            from_start = corner - second[0]
            largest = max(largest, abs(corner.real), abs(corner.imag))
            extent = max(extent, abs(from_start.real), abs(from_start.imag))
    return largest * extent
