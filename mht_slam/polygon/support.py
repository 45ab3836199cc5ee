"""How far a region in F_L reaches in a direction: branch and bound over the cells' boundaries.

A *piece* is a straight stretch of a base cell's boundary, or a lone corner. A *box* is what a
piece for p1 and a piece for p2 span; z = (p3 - p1) / (p2 - p1) with p3 at any corner of the third
cell. For fixed p1, 1 / (p2 - p1) runs over an arc of a circle as p2 runs along its piece, so the
best p2 is known in closed form, and likewise p1 for a fixed p2. Only one piece is divided, the
shorter one. On a length L of it z lies within L^2 / 4 |p3 - p2| / |p2 - p1|^3 of the chord, which
is an eighth of L^2 times its second derivative.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.compiled import compiled
from mht_slam.polygon.cones import ComplexArray

SUPPORT_TOLERANCE = 5e-4
"""How much too far a support line may stand, as a share of the region's width there."""

MAX_BOXES = 512
"""Boxes that may be open at once before a search is given up."""

_MAX_ROUNDS = 60
_TIE = 1e-11
_IN_LINE = 1e-12


class Boxes(NamedTuple):
    """What the search for one region starts from.

    Attributes
    ----------
    third : corners of the third cell.
    images : (n1, n2, n3) z at all combinations of corners.
    pieces : (N, 4) corners at both ends of p1's piece and at both ends of p2's, for each box.
    ends : (N, 4) ends of the piece to divide, then of the other one, along which p moves freely.
    exchanged : (N,) whether the piece to divide is p2's.
    bulges : (N, 2) how far z strays from its chord along the piece to divide, and along the other.
    open_ends, open_bounds, open_exchanged : room for the open boxes of two rounds.
    """

    third: ComplexArray
    images: ComplexArray
    pieces: IntArray
    ends: ComplexArray
    exchanged: BoolArray
    bulges: FloatArray
    open_ends: ComplexArray
    open_bounds: FloatArray
    open_exchanged: BoolArray


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
    pieces, ends = np.empty((n, 4), dtype=np.int64), np.empty((n, 4), dtype=np.complex128)
    exchanged, bulges = np.empty(n, dtype=np.bool_), np.empty((n, 2))
    for i in range(len(pieces_1)):
        for j in range(len(pieces_2)):
            a, b = pieces_1[i, 0], pieces_1[i, 1]
            c, d = pieces_2[j, 0], pieces_2[j, 1]
            box = i * len(pieces_2) + j
            pieces[box, 0], pieces[box, 1], pieces[box, 2], pieces[box, 3] = a, b, c, d
            other = _square(first[b] - first[a]) > _square(second[d] - second[c])
            exchanged[box] = other
            if other:
                _store(ends[box], second[c], second[d], first[a], first[b])
            else:
                _store(ends[box], first[a], first[b], second[c], second[d])
            own = ends[box]
            bulges[box, 0] = _bulge(own[0], own[1], own[2], own[3], third)
            bulges[box, 1] = _bulge(own[2], own[3], own[0], own[1], third)
    open_ends = np.empty((2, MAX_BOXES, 4), dtype=np.complex128)
    open_bounds = np.empty((2, MAX_BOXES))
    open_exchanged = np.empty((2, MAX_BOXES), dtype=np.bool_)
    return Boxes(
        third, images, pieces, ends, exchanged, bulges, open_ends, open_bounds, open_exchanged
    )


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
    count = _open_boxes(boxes, farthest, touch.height + tolerance)
    for number in range(_MAX_ROUNDS):
        if count == 0:
            return Touch(touch.begin, touch.end, touch.height + tolerance, True)
        touch, count = _divide(turned, boxes, number % 2, count, touch, tolerance, tie)
        if count < 0:
            break
    return Touch(begin, end, np.inf, False)


@compiled
def _open_boxes(boxes: Boxes, farthest: FloatArray, needed: float) -> int:
    """List the boxes that may reach beyond `needed` for the first round; return how many."""
    count = 0
    for i in range(len(boxes.pieces)):
        a, b = boxes.pieces[i, 0], boxes.pieces[i, 1]
        c, d = boxes.pieces[i, 2], boxes.pieces[i, 3]
        top = max(farthest[a, c], farthest[a, d], farthest[b, c], farthest[b, d])
        bound = top + boxes.bulges[i, 0] + boxes.bulges[i, 1]
        if bound > needed:
            if count == MAX_BOXES:
                return -1
            own = boxes.ends[i]
            _store(boxes.open_ends[0, count], own[0], own[1], own[2], own[3])
            boxes.open_exchanged[0, count] = boxes.exchanged[i]
            boxes.open_bounds[0, count] = bound
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
    """Look into all open boxes of a round, and divide those that may still reach farther.

    Returns the touch so far and how many remain open, -1 if too many.
    """
    needed = touch.height + tolerance
    later = 1 - now
    kept = 0
    for i in range(count):
        if boxes.open_bounds[now, i] <= needed:
            continue
        ends, exchanged = boxes.open_ends[now, i], boxes.open_exchanged[now, i]
        a, b, c, d = ends[0], ends[1], ends[2], ends[3]
        reach_a, z_a = _reach_from(turned, a, c, d, boxes.third, exchanged)
        reach_b, z_b = _reach_from(turned, b, c, d, boxes.third, exchanged)
        touch = _farther(_farther(touch, z_a, turned, tie), z_b, turned, tie)
        bound = _top(reach_a, reach_b, _bulge(a, b, c, d, boxes.third))
        if bound <= needed or a == b:
            continue
        if kept + 2 > MAX_BOXES:
            return touch, -1
        cut = _cut(a, b, c, d)
        _store(boxes.open_ends[later, kept], a, cut, c, d)
        _store(boxes.open_ends[later, kept + 1], cut, b, c, d)
        for half in range(2):
            boxes.open_exchanged[later, kept + half] = exchanged
            boxes.open_bounds[later, kept + half] = bound
        kept += 2
    return touch, kept


@compiled
def _store(ends: ComplexArray, a: complex, b: complex, c: complex, d: complex) -> None:
    ends[0], ends[1], ends[2], ends[3] = a, b, c, d


@compiled
def _cut(start: complex, end: complex, other_start: complex, other_end: complex) -> complex:
    """Where to cut a piece: as its ends' distances from the other one divide it.

    A bisector of the angle would do so: far parts of a piece matter less than near ones.
    """
    near = distance_from(start, other_start, other_end)
    far = distance_from(end, other_start, other_end)
    share = min(max(near / (near + far), 0.1), 0.9)
    return start + share * (end - start)


@compiled
def _bulge(a: complex, b: complex, c: complex, d: complex, third: ComplexArray) -> float:
    """How far z strays from its chord as p runs from a to b, wherever q is between c and d.

    With D the least |q - p| there, |p3 - q| / |q - p|^3 is at most the largest |p3 - q| / D^3, and
    also at most |p3 - p| / D^3 + 1 / D^2, whichever is less.
    """
    length = _square(b - a)
    if length == 0.0:
        return 0.0
    nearest = min(
        min(distance_from(a, c, d), distance_from(b, c, d)),
        min(distance_from(c, a, b), distance_from(d, a, b)),
    )
    if nearest <= 0.0:
        return np.inf
    to_q, to_p = 0.0, 0.0
    for p3 in third:
        to_q = max(to_q, _square(p3 - c), _square(p3 - d))
        to_p = max(to_p, _square(p3 - a), _square(p3 - b))
    arm = min(math.sqrt(to_q), math.sqrt(to_p) + nearest)
    return 0.25 * length * arm / nearest**3


@compiled
def distance_from(point: complex, start: complex, end: complex) -> float:
    """Distance of a point from a stretch between two others."""
    along, away = end - start, point - start
    length = _square(along)
    share = (away * along.conjugate()).real / length if length > 0.0 else 0.0
    return math.sqrt(_square(away - min(max(share, 0.0), 1.0) * along))


@compiled
def _reach_from(
    turned: complex, p: complex, c: complex, d: complex, third: ComplexArray, exchanged: bool
) -> tuple[float, complex]:
    """How far z reaches with p fixed and q anywhere between c and d, and the z there.

    On q's whole line 1 / (q - p) runs over a circle through 0 with the diameter 1 / foot, the foot
    of the perpendicular seen from p; its point farthest along a direction is known. Between the
    ends only that point or an end can be farthest. With p1 and p2 exchanged z is 1 - z.
    """
    start, end, along = c - p, d - p, d - c
    inverse_start, inverse_end = _inverse(start), _inverse(end)
    # The foot's vector is at a right angle to the line: 1j * along times its signed length.
    square = _square(along)
    height = (along.conjugate() * start).imag
    bends = abs(height) > _IN_LINE * (square + _square(start))
    centre, radius = 0j, 0.0
    if bends:
        centre = 0.5 * _inverse(1j * along * (height / square))
        radius = math.sqrt(_square(centre))
    best, farthest = -np.inf, 0j
    for p3 in third:
        arm = p - p3 if exchanged else p3 - p
        pull = turned * arm
        image = inverse_start
        if _reach(pull, inverse_end) > _reach(pull, image):
            image = inverse_end
        if bends:
            strength = math.sqrt(_square(pull))
            if strength > 0.0:
                top = centre + radius * pull.conjugate() / strength
                if _square(top) > 0.0:
                    place = (along.conjugate() * (_inverse(top) - start)).real
                    if 0.0 < place < square:
                        image = top
        reach = _reach(pull, image)
        if reach > best:
            best, farthest = reach, arm * image
    if exchanged:
        return turned.real + best, 1.0 + farthest
    return best, farthest


@compiled
def _top(start: float, end: float, bulge: float) -> float:
    """Top of the line between two heights plus a parabola that is `bulge` high in its middle."""
    if bulge == np.inf:
        return np.inf
    apart = abs(start - end)
    if apart >= 4.0 * bulge:  # so steep that an end is highest
        return max(start, end)
    return 0.5 * (start + end) + bulge + apart**2 / (16.0 * bulge)


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
