"""From F_R to F_L: regions of third landmarks and observation points (uncertainty analysis).

With points as complex numbers, the similarity that puts the base landmarks p1 and p2 at 0 and 1
takes p3 to z = (p3 - p1) / (p2 - p1). The base landmarks become certain; all uncertainty moves to
the others and to the observation points.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import shapely

from mht_slam.arrays import BoolArray, FloatArray
from mht_slam.compiled import compiled
from mht_slam.polygon.cones import ComplexArray, ObjectArray
from mht_slam.polygon.convex import clip, convex_hull, cross, polygon_area
from mht_slam.polygon.support import Boxes, Touch, all_boxes, distance_from, support

REGIONS = ("edges", "vertices")

AREA_TOLERANCE = 0.0045
"""Largest share of a region's area that lies between its inner and its outer polygon."""

TOUCHING = 1e-9
"""Base cells closer than this share of their size count as touching."""

MAX_CORNERS = 128
"""The most support lines, hence corners, of one region."""

FIRST_DIRECTIONS = 8
"""Directions that every region starts from: both axes, and the lines half-way between them."""

_MAX_ROUNDS = 8
_DISC_SIDES = 16
_MIN_TURN = 1e-6
_NONE = -1.0


class Triple(NamedTuple):
    """Cells of the two base landmarks and of a third one, as corners in one F_R.

    Complex, counter-clockwise; a third of a single corner is a point, such as an observation point.
    """

    first: ComplexArray
    second: ComplexArray
    third: ComplexArray


def base_cells_meet(first: ObjectArray, second: ObjectArray) -> BoolArray:
    """Whether two base cells overlap or touch, so that p1 = p2 is possible (elementwise)."""
    box_first, box_second = shapely.bounds(first), shapely.bounds(second)
    size = np.maximum(
        (box_first[..., 2:] - box_first[..., :2]).max(axis=-1),
        (box_second[..., 2:] - box_second[..., :2]).max(axis=-1),
    )
    return np.asarray(shapely.distance(first, second) <= TOUCHING * size, dtype=np.bool_)


def landmark_frame_region(triple: Triple, region: str = "edges") -> ComplexArray:
    """Region of the third cell in F_L, as the corners of a convex polygon.

    The base cells must be disjoint.

    ``region="edges"`` is an outer bound of the convex hull of all z, its area at most half a per
    cent too large. Edges of the base cells become circular arcs, so the hull is closed in between
    an inner polygon of extreme points and an outer one of the lines that support it; directions
    are added until both agree to `AREA_TOLERANCE`. No point of a cell is lost to sampling. Only
    where base cells nearly touch along an edge, and the region is huge, it stays coarser, if need
    be a disc that holds it.
    ``region="vertices"`` is the hull of the combinations of corners, which is no outer bound.

    Source: the paper's Uncertainty Analysis Method; docs/method.md, section 3.
    """
    if region == "vertices":
        return corner_combinations(*triple)
    corners = np.empty(MAX_CORNERS + 1, dtype=np.complex128)
    return corners[: outline(*triple, corners)]


def landmark_frame_regions(triples: Sequence[Triple], region: str = "edges") -> ObjectArray:
    """Regions as shapely polygons: see `landmark_frame_region`."""
    polygons = np.empty(len(triples), dtype=np.object_)
    for i, triple in enumerate(triples):
        corners = landmark_frame_region(triple, region)
        polygons[i] = shapely.Polygon(np.column_stack([corners.real, corners.imag]))
    return polygons


@compiled
def corner_combinations(
    first: ComplexArray, second: ComplexArray, third: ComplexArray
) -> ComplexArray:
    """Corners of the hull of z over all combinations of the cells' corners."""
    images = np.empty(len(first) * len(second) * len(third), dtype=np.complex128)
    n = 0
    for p1 in first:
        for p2 in second:
            for p3 in third:
                images[n] = (p3 - p1) / (p2 - p1)
                n += 1
    hull = np.empty(n + 1, dtype=np.complex128)
    return hull[: convex_hull(images, hull)]


@compiled
def outline(
    first: ComplexArray, second: ComplexArray, third: ComplexArray, corners: ComplexArray
) -> int:
    """Write the corners of the ``"edges"`` region into `corners`; return how many.

    `corners` has room for `MAX_CORNERS` + 1.
    """
    boxes = all_boxes(first, second, third)
    point = np.empty((FIRST_DIRECTIONS, 2), dtype=np.complex128)
    height = np.empty(FIRST_DIRECTIONS)
    if first_lines(boxes, point, height):
        return enclose(boxes, point, height, corners)
    return disc_that_holds(first, second, third, corners)


@compiled
def first_lines(boxes: Boxes, point: ComplexArray, height: FloatArray) -> bool:
    """Support lines in `FIRST_DIRECTIONS` directions; False if one was given up.

    Writes the heights, and in `point` (directions, 2) where each line begins and ends to touch.
    """
    start = boxes.images[0, 0, 0]
    for i in range(FIRST_DIRECTIONS):
        direction = np.exp(1j * (i * (2.0 * np.pi / FIRST_DIRECTIONS)))
        touch = support(direction, boxes, start, start)
        if not touch.found:
            return False
        point[i], height[i] = (touch.begin, touch.end), touch.height
    return True


@compiled
def enclose(
    boxes: Boxes, first_point: ComplexArray, first_height: FloatArray, corners: ComplexArray
) -> int:
    """Add support lines to the first ones until they close the region in.

    Writes the corners of the polygon between all lines, and returns how many. Where the search for
    a line is given up, the polygon stays as it is.
    """
    angle, height = np.empty(MAX_CORNERS), np.empty(MAX_CORNERS)
    begin, end = np.empty((2, MAX_CORNERS), dtype=np.complex128)
    count = FIRST_DIRECTIONS
    angle[:count] = np.arange(count) * (2.0 * np.pi / count)
    height[:count] = first_height
    begin[:count], end[:count] = first_point.T
    polygon, clipped = corners, np.empty_like(corners)
    n_corners = first_polygon(first_height, polygon, clipped)
    gaps, chosen = np.empty(MAX_CORNERS), np.empty(MAX_CORNERS)
    touches = [Touch(0j, 0j, 0.0, False)] * MAX_CORNERS
    for _ in range(_MAX_ROUNDS):
        whole = polygon_area(polygon, n_corners)
        for i in range(count):
            j = (i + 1) % count
            crossing = _crossing(angle[i], height[i], angle[j], height[j])
            gaps[i] = 0.5 * abs(cross(crossing - end[i], begin[j] - end[i]))
        if gaps[:count].sum() <= AREA_TOLERANCE * whole:
            break
        limit = AREA_TOLERANCE * whole / count
        added, given_up = 0, False
        for i in range(count):
            j = (i + 1) % count
            chosen[i] = _NONE
            if gaps[i] > limit:
                chosen[i] = _direction_between(angle[i], end[i], angle[j], begin[j])
            if chosen[i] != _NONE:
                touches[i] = support(np.exp(1j * chosen[i]), boxes, end[i], begin[j])
                given_up |= not touches[i].found
                added += 1
        if added == 0 or given_up or count + added > MAX_CORNERS:
            break
        place = count + added
        for i in range(count - 1, -1, -1):
            if chosen[i] != _NONE:
                place -= 1
                touch = touches[i]
                angle[place], height[place] = chosen[i], touch.height
                begin[place], end[place] = touch.begin, touch.end
                direction = np.exp(1j * chosen[i])
                n_corners = _clip_by_line(polygon[:n_corners], direction, touch.height, clipped)
                polygon, clipped = clipped, polygon
            place -= 1
            angle[place], height[place] = angle[i], height[i]
            begin[place], end[place] = begin[i], end[i]
        count += added
    corners[:n_corners] = polygon[:n_corners]
    return n_corners


@compiled
def first_polygon(height: FloatArray, polygon: ComplexArray, clipped: ComplexArray) -> int:
    """Write the polygon between the first support lines into `polygon`; return its corners."""
    polygon[0] = complex(-height[4], -height[6])
    polygon[1] = complex(height[0], -height[6])
    polygon[2] = complex(height[0], height[2])
    polygon[3] = complex(-height[4], height[2])
    inside = polygon[:4]
    for i in range(1, FIRST_DIRECTIONS, 2):
        direction = np.exp(1j * (i * (2.0 * np.pi / FIRST_DIRECTIONS)))
        count = _clip_by_line(inside, direction, height[i], clipped)
        inside = polygon[:count]
        inside[:] = clipped[:count]
    return len(inside)


@compiled
def _clip_by_line(
    polygon: ComplexArray, direction: complex, height: float, clipped: ComplexArray
) -> int:
    return clip(polygon, direction * height, 1j * direction, 0.0, clipped)


@compiled
def _crossing(angle_1: float, height_1: float, angle_2: float, height_2: float) -> complex:
    """Where two support lines cross, found in the first one's own axes."""
    turn = angle_2 - angle_1
    along = (height_2 - height_1 * np.cos(turn)) / np.sin(turn)
    return complex(np.exp(1j * angle_1) * complex(height_1, along))


@compiled
def _direction_between(angle_1: float, point_1: complex, angle_2: float, point_2: complex) -> float:
    """The direction at a right angle to a chord, if it lies between those of its two lines."""
    chord = point_2 - point_1
    if chord == 0.0:
        return _NONE
    direction = np.angle(-1j * chord) % (2.0 * np.pi)
    turn = (angle_2 - angle_1) % (2.0 * np.pi)
    inside = (direction - angle_1) % (2.0 * np.pi)
    return direction if _MIN_TURN < inside < turn - _MIN_TURN else _NONE


@compiled
def disc_that_holds(
    first: ComplexArray, second: ComplexArray, third: ComplexArray, corners: ComplexArray
) -> int:
    """A polygon about 0.5, the middle of the base, that every z is in: from distances alone."""
    farthest = 0.0
    for p1 in first:
        for p2 in second:
            for p3 in third:
                farthest = max(farthest, abs(p3 - 0.5 * (p1 + p2)))
    nearest = np.inf
    for cell, other in ((first, second), (second, first)):
        for point in cell:
            for i in range(len(other)):
                nearest = min(nearest, distance_from(point, other[i - 1], other[i]))
    radius = farthest / nearest / np.cos(np.pi / _DISC_SIDES)
    for i in range(_DISC_SIDES):
        corners[i] = 0.5 + radius * np.exp(1j * (i + 0.5) * (2.0 * np.pi / _DISC_SIDES))
    return _DISC_SIDES
