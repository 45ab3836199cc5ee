"""How far a region in F_L reaches in a direction: branch and bound over the cells' boundaries.

A *piece* is a straight stretch of a base cell's boundary, or a lone corner. A *box* is what a
piece for p1 and a piece for p2 span; z = (p3 - p1) / (p2 - p1) with p3 at any corner of the third
cell. For fixed p2 and p3, and p1 on a piece of length L, z lies within
L^2 / 4 |p3 - p2| / |p2 - p1|^3 of the chord, because that is an eighth of L^2 times its second
derivative; likewise for p2. So a box's corners bound the whole box.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.compiled import compiled
from mht_slam.polygon.cones import ComplexArray

SUPPORT_TOLERANCE = 5e-4
"""How much too far a support line may stand, as a share of the region's width there."""

MAX_BOXES = 256
"""Boxes that may be open at once before a search is given up."""

_MAX_ROUNDS = 60
_TIE = 1e-11


class Boxes(NamedTuple):
    """What the search for one region starts from.

    Attributes
    ----------
    first, second, third : corners of the cells.
    images : (n1, n2, n3) z at all combinations of corners.
    pieces : (N, 4) corners at both ends of p1's piece and at both ends of p2's, for each box.
    bulges : (N, 4) longest p3 - p2, longest p3 - p1, and the bulges along either piece.
    open_ends, open_bulges : room for the open boxes of two rounds.
    """

    first: ComplexArray
    second: ComplexArray
    third: ComplexArray
    images: ComplexArray
    pieces: IntArray
    bulges: FloatArray
    open_ends: ComplexArray
    open_bulges: FloatArray


class Touch(NamedTuple):
    """Where a region reaches farthest along a direction.

    Attributes
    ----------
    begin, end : points of the region at the greatest reach found, the first and the last one
        counter-clockwise where several tie.
    height : what no point of the region exceeds, above those points by `SUPPORT_TOLERANCE` of the
        region's width.
    found : False where the search was given up because base cells nearly touch along an edge; then
        the height means nothing.
    """

    begin: complex
    end: complex
    height: float
    found: bool


@compiled
def boundary_pieces(cell: ComplexArray, other: ComplexArray) -> IntArray:
    """(K, 2) corners at the ends of the pieces of a base cell's boundary that matter.

    They are the edges of `cell` that some point of `other` sees from outside, then lone corners.
    1 / (p2 - p1) maps an edge to an arc of a circle through 0. The image of the cell lies inside
    that circle only where the edge is seen from outside; all other edges bend inwards, and only
    their ends can be extreme.
    """
    n = len(cell)
    pieces = np.empty((n, 2), dtype=np.int64)
    seen = np.zeros(n, dtype=np.bool_)
    for i in range(n):
        along = (cell[(i + 1) % n] - cell[i]).conjugate()
        for point in other:
            seen[i] |= (along * (point - cell[i])).imag < 0.0
    count = 0
    for i in range(n):
        if seen[i]:
            pieces[count, 0], pieces[count, 1] = i, (i + 1) % n
            count += 1
    for i in range(n):
        if not seen[i] and not seen[i - 1]:
            pieces[count] = i
            count += 1
    return pieces[:count]


@compiled
def all_boxes(first: ComplexArray, second: ComplexArray, third: ComplexArray) -> Boxes:
    """Boxes that cover the boundaries of both base cells."""
    images = np.empty((len(first), len(second), len(third)), dtype=np.complex128)
    for i in range(len(first)):
        for j in range(len(second)):
            inverse = _inverse(second[j] - first[i])
            for k in range(len(third)):
                images[i, j, k] = (third[k] - first[i]) * inverse
    pieces_1, pieces_2 = boundary_pieces(first, second), boundary_pieces(second, first)
    n = len(pieces_1) * len(pieces_2)
    pieces, bulges = np.empty((n, 4), dtype=np.int64), np.empty((n, 4))
    for i in range(len(pieces_1)):
        for j in range(len(pieces_2)):
            a, b = pieces_1[i, 0], pieces_1[i, 1]
            c, d = pieces_2[j, 0], pieces_2[j, 1]
            arm_1, arm_2 = 0.0, 0.0
            for p3 in third:
                arm_1 = max(arm_1, _square(p3 - second[c]), _square(p3 - second[d]))
                arm_2 = max(arm_2, _square(p3 - first[a]), _square(p3 - first[b]))
            arm_1, arm_2 = np.sqrt(arm_1), np.sqrt(arm_2)
            bulge_1, bulge_2 = _bulges(first[a], first[b], second[c], second[d], arm_1, arm_2)
            box = i * len(pieces_2) + j
            pieces[box, 0], pieces[box, 1], pieces[box, 2], pieces[box, 3] = a, b, c, d
            bulges[box, 0], bulges[box, 1] = arm_1, arm_2
            bulges[box, 2], bulges[box, 3] = bulge_1, bulge_2
    open_ends = np.empty((2, MAX_BOXES, 4), dtype=np.complex128)
    open_bulges = np.empty((2, MAX_BOXES, 5))
    return Boxes(first, second, third, images, pieces, bulges, open_ends, open_bulges)


@compiled
def support(direction: complex, boxes: Boxes, begin: complex, end: complex) -> Touch:
    """Farthest points of a region along a unit direction, and the line that supports it there.

    `begin` and `end` are points of the region to start from. All open boxes are divided at once
    and ties are kept, so the outcome does not hang on the order of corners.
    """
    turned = direction.conjugate()
    best = max(_reach(turned, begin), _reach(turned, end))
    least = best
    n1, n2, n3 = boxes.images.shape
    farthest = np.empty((n1, n2))
    for i in range(n1):
        for j in range(n2):
            here = -np.inf
            for k in range(n3):
                reach = _reach(turned, boxes.images[i, j, k])
                here, least = max(here, reach), min(least, reach)
            farthest[i, j] = here
            best = max(best, here)
    tolerance, tie = SUPPORT_TOLERANCE * (best - least), _TIE * (best - least)
    touch = _farther(Touch(begin, begin, _reach(turned, begin), True), end, turned, tie)
    for i in range(n1):
        for j in range(n2):
            if farthest[i, j] >= best - tie:
                for k in range(n3):
                    touch = _farther(touch, boxes.images[i, j, k], turned, tie)
    count = _open_boxes(turned, boxes, farthest, touch.height + tolerance)
    for number in range(_MAX_ROUNDS):
        if count == 0:
            return Touch(touch.begin, touch.end, touch.height + tolerance, True)
        touch, count = _divide(turned, boxes, number % 2, count, touch, tolerance, tie)
        if count < 0:
            break
    return Touch(begin, end, np.inf, False)


@compiled
def _open_boxes(turned: complex, boxes: Boxes, farthest: FloatArray, needed: float) -> int:
    """List the boxes that may reach beyond `needed` for the first round; return how many."""
    count = 0
    for i in range(len(boxes.pieces)):
        a, b = boxes.pieces[i, 0], boxes.pieces[i, 1]
        c, d = boxes.pieces[i, 2], boxes.pieces[i, 3]
        bulge_1, bulge_2 = boxes.bulges[i, 2], boxes.bulges[i, 3]
        top = max(farthest[a, c], farthest[a, d], farthest[b, c], farthest[b, d])
        if top + bulge_1 + bulge_2 <= needed:
            continue
        p1_a, p1_b, p2_a, p2_b = (
            boxes.first[a],
            boxes.first[b],
            boxes.second[c],
            boxes.second[d],
        )
        bound, _ = _bound(turned, p1_a, p1_b, p2_a, p2_b, boxes.third, bulge_1, bulge_2)
        if bound > needed:
            if count == MAX_BOXES:
                return -1
            _store(boxes.open_ends[0, count], p1_a, p1_b, p2_a, p2_b)
            own = boxes.open_bulges[0, count]
            for k in range(4):
                own[k] = boxes.bulges[i, k]
            own[4] = bound
            count += 1
    return count


@compiled
def _divide(
    turned: complex,
    boxes: Boxes,
    now: int,
    count: int,
    touch: Touch,
    tolerance: float,
    tie: float,
) -> tuple[Touch, int]:
    """Divide all open boxes of a round; return the touch so far and how many remain, -1 if many."""
    needed = touch.height + tolerance
    third = boxes.third
    later = 1 - now
    kept = 0
    for i in range(count):
        own = boxes.open_bulges[now, i]
        if own[4] <= needed:
            continue
        ends = boxes.open_ends[now, i]
        p1_a, p1_b, p2_a, p2_b = ends[0], ends[1], ends[2], ends[3]
        arm_1, arm_2, bulge_1, bulge_2 = own[0], own[1], own[2], own[3]
        across_1 = bulge_1 > bulge_2
        if bulge_1 == bulge_2:
            across_1 = _square(p1_b - p1_a) >= _square(p2_b - p2_a)
        cut = _cut(p1_a, p1_b, p2_a, p2_b) if across_1 else _cut(p2_a, p2_b, p1_a, p1_b)
        for half in range(2):
            a, b, c, d = p1_a, p1_b, p2_a, p2_b
            if across_1:
                a, b = (cut, b) if half else (a, cut)
            else:
                c, d = (cut, d) if half else (c, cut)
            half_1, half_2 = _bulges(a, b, c, d, arm_1, arm_2)
            bound, reach = _bound(turned, a, b, c, d, third, half_1, half_2)
            if reach >= touch.height - tie:
                touch = _touch_at(touch, a, c, third, turned, tie)
                touch = _touch_at(touch, a, d, third, turned, tie)
                touch = _touch_at(touch, b, c, third, turned, tie)
                touch = _touch_at(touch, b, d, third, turned, tie)
            if bound > needed:
                if kept == MAX_BOXES:
                    return touch, -1
                _store(boxes.open_ends[later, kept], a, b, c, d)
                part = boxes.open_bulges[later, kept]
                part[0], part[1], part[2], part[3], part[4] = arm_1, arm_2, half_1, half_2, bound
                kept += 1
    return touch, kept


@compiled
def _store(ends: ComplexArray, p1_a: complex, p1_b: complex, p2_a: complex, p2_b: complex) -> None:
    ends[0], ends[1], ends[2], ends[3] = p1_a, p1_b, p2_a, p2_b


@compiled
def _cut(start: complex, end: complex, other_start: complex, other_end: complex) -> complex:
    """Where to cut a piece: as its ends' distances from the other one divide it.

    A bisector of the angle would do so: far parts of a piece matter less than near ones.
    """
    other = 0.5 * (other_start + other_end)
    near, far = math.sqrt(_square(start - other)), math.sqrt(_square(end - other))
    share = min(max(near / (near + far), 0.1), 0.9)
    return start + share * (end - start)


@compiled
def _bulges(
    p1_a: complex, p1_b: complex, p2_a: complex, p2_b: complex, arm_1: float, arm_2: float
) -> tuple[float, float]:
    """How far z strays from its chord as p1 runs along its piece, and as p2 does.

    `arm_1` and `arm_2` bound the lengths of p3 - p2 and p3 - p1. All p2 - p1 of a box lie in a
    parallelogram; its corners' components along its middle bound the distance from below.
    """
    axis = (p2_a + p2_b - p1_a - p1_b).conjugate()
    nearest = min(
        min(((p2_a - p1_a) * axis).real, ((p2_b - p1_a) * axis).real),
        min(((p2_a - p1_b) * axis).real, ((p2_b - p1_b) * axis).real),
    )
    piece_1, piece_2 = _square(p1_b - p1_a), _square(p2_b - p2_a)
    if nearest <= 0.0:
        return (np.inf if piece_1 > 0.0 else 0.0), (np.inf if piece_2 > 0.0 else 0.0)
    nearest /= np.sqrt(_square(axis))
    scale = 0.25 / nearest**3
    return scale * piece_1 * arm_1, scale * piece_2 * arm_2


@compiled
def _bound(
    turned: complex,
    p1_a: complex,
    p1_b: complex,
    p2_a: complex,
    p2_b: complex,
    third: ComplexArray,
    bulge_1: float,
    bulge_2: float,
) -> tuple[float, float]:
    """What no point of a box exceeds, and how far its corners reach.

    Along one piece at either end of the other, then along the other; whichever order bounds more.
    """
    turned_aa, turned_ab = turned * _inverse(p2_a - p1_a), turned * _inverse(p2_b - p1_a)
    turned_ba, turned_bb = turned * _inverse(p2_a - p1_b), turned * _inverse(p2_b - p1_b)
    at_p1_a, at_p1_b, at_p2_a, at_p2_b = -np.inf, -np.inf, -np.inf, -np.inf
    reach = -np.inf
    for p3 in third:
        aa, ab = _reach(turned_aa, p3 - p1_a), _reach(turned_ab, p3 - p1_a)
        ba, bb = _reach(turned_ba, p3 - p1_b), _reach(turned_bb, p3 - p1_b)
        reach = max(reach, aa, ab, ba, bb)
        at_p1_a, at_p1_b = max(at_p1_a, _top(aa, ab, bulge_2)), max(at_p1_b, _top(ba, bb, bulge_2))
        at_p2_a, at_p2_b = max(at_p2_a, _top(aa, ba, bulge_1)), max(at_p2_b, _top(ab, bb, bulge_1))
    if bulge_1 == np.inf or bulge_2 == np.inf:
        return np.inf, reach
    return min(_top(at_p1_a, at_p1_b, bulge_1), _top(at_p2_a, at_p2_b, bulge_2)), reach


@compiled
def _top(start: float, end: float, bulge: float) -> float:
    """Top of the line between two heights plus a parabola that is `bulge` high in its middle."""
    apart = abs(start - end)
    if apart >= 4.0 * bulge:  # so steep that an end is highest
        return max(start, end)
    return 0.5 * (start + end) + bulge + apart**2 / (16.0 * bulge)


@compiled
def _touch_at(
    touch: Touch, p1: complex, p2: complex, third: ComplexArray, turned: complex, tie: float
) -> Touch:
    inverse = _inverse(p2 - p1)
    for p3 in third:
        touch = _farther(touch, (p3 - p1) * inverse, turned, tie)
    return touch


@compiled
def _farther(touch: Touch, z: complex, turned: complex, tie: float) -> Touch:
    """The touch after one more point, which ties with those that reach as far within `tie`."""
    reach = _reach(turned, z)
    if reach < touch.height - tie:
        return touch
    if reach > touch.height + tie:
        return Touch(z, z, reach, True)
    along = (turned * z).imag
    begin = z if along < (turned * touch.begin).imag else touch.begin
    end = z if along > (turned * touch.end).imag else touch.end
    return Touch(begin, end, max(reach, touch.height), True)


@compiled
def _reach(turned: complex, z: complex) -> float:
    return turned.real * z.real - turned.imag * z.imag


@compiled
def _inverse(z: complex) -> complex:
    return z.conjugate() / _square(z)


@compiled
def _square(z: complex) -> float:
    return z.real**2 + z.imag**2
