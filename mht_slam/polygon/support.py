"""How far a region in F_L reaches in a direction: branch and bound over the cells' boundaries.

A *piece* is a straight stretch of a base cell's boundary, or a lone corner. A *box* is what a
piece for p1 and a piece for p2 span; z = (p3 - p1) / (p2 - p1) with p3 at any corner of the third
cell. For fixed p2 and p3, and p1 on a piece of length L, z lies within
L^2 / 4 |p3 - p2| / |p2 - p1|^3 of the chord, because that is an eighth of L^2 times its second
derivative; likewise for p2. So a box's corners bound the whole box.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.compiled import compiled
from mht_slam.polygon.cones import ComplexArray

SUPPORT_TOLERANCE = 5e-4
"""How much too far a support line may stand, as a share of the region's width there."""

MAX_BOXES = 256
"""Boxes that may be open at once before a search is given up."""

_MAX_ROUNDS = 60
_LEVEL = 1e-11


class Boxes(NamedTuple):
    """Boxes that cover the boundaries of both base cells, for one third cell.

    Attributes
    ----------
    ends : (N, 4) both ends of the piece for p1, both ends of that for p2.
    images : (N, 4, n3) z at the corners of each box, p2 changing faster, for every p3.
    bulges : (N, 4) longest p3 - p2, longest p3 - p1, and the bulges along either piece.
    """

    ends: ComplexArray
    images: ComplexArray
    bulges: FloatArray


@compiled
def boundary_pieces(cell: ComplexArray, other: ComplexArray) -> ComplexArray:
    """(K, 2) edges of `cell` that some point of `other` sees from outside, then lone corners.

    1 / (p2 - p1) maps an edge to an arc of a circle through 0. The image of the cell lies inside
    that circle only where the edge is seen from outside; all other edges bend inwards, and only
    their ends can be extreme.
    """
    n = len(cell)
    pieces = np.empty((n, 2), dtype=np.complex128)
    seen = np.zeros(n, dtype=np.bool_)
    for i in range(n):
        along = (cell[(i + 1) % n] - cell[i]).conjugate()
        for point in other:
            seen[i] |= (along * (point - cell[i])).imag < 0.0
    count = 0
    for i in range(n):
        if seen[i]:
            pieces[count, 0], pieces[count, 1] = cell[i], cell[(i + 1) % n]
            count += 1
    for i in range(n):
        if not seen[i] and not seen[i - 1]:
            pieces[count] = cell[i]
            count += 1
    return pieces[:count]


@compiled
def all_boxes(first: ComplexArray, second: ComplexArray, third: ComplexArray) -> Boxes:
    """Boxes that cover the boundaries of both base cells."""
    pieces_1, pieces_2 = boundary_pieces(first, second), boundary_pieces(second, first)
    n = len(pieces_1) * len(pieces_2)
    ends = np.empty((n, 4), dtype=np.complex128)
    images = np.empty((n, 4, len(third)), dtype=np.complex128)
    bulges = np.empty((n, 4))
    for i in range(len(pieces_1)):
        for j in range(len(pieces_2)):
            k = i * len(pieces_2) + j
            ends[k, :2] = pieces_1[i]
            ends[k, 2:] = pieces_2[j]
            box_images(ends[k], third, images[k])
            arm_1, arm_2 = longest_arms(ends[k], third)
            bulge_1, bulge_2 = box_bulges(ends[k], arm_1, arm_2)
            bulges[k] = (arm_1, arm_2, bulge_1, bulge_2)
    return Boxes(ends, images, bulges)


@compiled
def box_images(box: ComplexArray, third: ComplexArray, images: ComplexArray) -> None:
    """Write z at the corners of a box, p2 changing faster, for every p3: `images` is (4, n3)."""
    for corner in range(4):
        p1, p2 = box[corner // 2], box[2 + corner % 2]
        inverse = (p2 - p1).conjugate() / _square(p2 - p1)
        for k in range(len(third)):
            images[corner, k] = (third[k] - p1) * inverse


@compiled
def longest_arms(box: ComplexArray, third: ComplexArray) -> tuple[float, float]:
    """Longest p3 - p2 and longest p3 - p1 of a box."""
    arm_1, arm_2 = 0.0, 0.0
    for p3 in third:
        arm_1 = max(arm_1, _square(p3 - box[2]), _square(p3 - box[3]))
        arm_2 = max(arm_2, _square(p3 - box[0]), _square(p3 - box[1]))
    return np.sqrt(arm_1), np.sqrt(arm_2)


@compiled
def box_bulges(box: ComplexArray, arm_1: float, arm_2: float) -> tuple[float, float]:
    """How far z strays from its chord as p1 runs along its piece, and as p2 does.

    `arm_1` and `arm_2` bound the lengths of p3 - p2 and p3 - p1. All p2 - p1 of a box lie in a
    parallelogram; its corners' components along its middle bound the distance from below.
    """
    middle = box[2] + box[3] - box[0] - box[1]
    axis = middle.conjugate()
    nearest = min(
        min(((box[2] - box[0]) * axis).real, ((box[3] - box[0]) * axis).real),
        min(((box[2] - box[1]) * axis).real, ((box[3] - box[1]) * axis).real),
    )
    piece_1, piece_2 = _square(box[1] - box[0]), _square(box[3] - box[2])
    if nearest <= 0.0:
        return (np.inf if piece_1 > 0.0 else 0.0), (np.inf if piece_2 > 0.0 else 0.0)
    nearest /= np.sqrt(_square(middle))
    scale = 0.25 / nearest**3
    return scale * piece_1 * arm_1, scale * piece_2 * arm_2


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
def support(
    direction: complex, boxes: Boxes, third: ComplexArray, begin: complex, end: complex
) -> Touch:
    """Farthest points of a region along a unit direction, and the line that supports it there.

    `begin` and `end` are points of the region to start from. All open boxes are divided at once
    and ties are kept, so the outcome does not hang on the order of corners.
    """
    turned = direction.conjugate()
    ends, images, bulges = boxes
    best = least = (turned * begin).real
    for z in images.flat:
        reach = turned.real * z.real - turned.imag * z.imag
        best, least = max(best, reach), min(least, reach)
    tolerance = SUPPORT_TOLERANCE * (best - least)
    level = _LEVEL * (best - least)
    touch = Touch(begin, begin, (turned * begin).real, True)
    touch = _farther(touch, end, turned, level)
    for z in images.flat:
        touch = _farther(touch, z, turned, level)
    here, there = np.empty((MAX_BOXES, 4), dtype=np.complex128), ends[:0]
    here_bulges, there_bulges = np.empty((MAX_BOXES, 4)), bulges[:0]
    here_bound, there_bound = np.empty(MAX_BOXES), np.empty(0)
    count = 0
    for i in range(len(ends)):
        bound = _bound(turned, images[i], bulges[i, 2], bulges[i, 3])
        if bound > touch.height + tolerance:
            if count == MAX_BOXES:
                return Touch(begin, end, np.inf, False)
            here[count], here_bulges[count], here_bound[count] = ends[i], bulges[i], bound
            count += 1
    if count == 0:
        return Touch(touch.begin, touch.end, touch.height + tolerance, True)
    there, there_bulges, there_bound = (
        np.empty_like(here),
        np.empty_like(here_bulges),
        np.empty_like(here_bound),
    )
    corner_images = np.empty((4, len(third)), dtype=np.complex128)
    for _ in range(_MAX_ROUNDS):
        needed = touch.height + tolerance
        kept = 0
        for i in range(count):
            if here_bound[i] <= needed:
                continue
            piece, cut = _division(here[i], here_bulges[i])
            for half in range(2):
                if kept == MAX_BOXES:
                    return Touch(begin, end, np.inf, False)
                box, bulge = there[kept], there_bulges[kept]
                box[:], bulge[:] = here[i], here_bulges[i]
                box[piece + half] = cut
                box_images(box, third, corner_images)
                for z in corner_images.flat:
                    touch = _farther(touch, z, turned, level)
                bulge[2], bulge[3] = box_bulges(box, bulge[0], bulge[1])
                there_bound[kept] = _bound(turned, corner_images, bulge[2], bulge[3])
                if there_bound[kept] > needed:
                    kept += 1
        if kept == 0:
            return Touch(touch.begin, touch.end, touch.height + tolerance, True)
        here, there = there, here
        here_bulges, there_bulges = there_bulges, here_bulges
        here_bound, there_bound = there_bound, here_bound
        count = kept
    return Touch(begin, end, np.inf, False)


@compiled
def _farther(touch: Touch, z: complex, turned: complex, level: float) -> Touch:
    """The touch after one more point, which ties with those within `level` of it."""
    reach = turned.real * z.real - turned.imag * z.imag
    if reach < touch.height - level:
        return touch
    if reach > touch.height + level:
        return Touch(z, z, reach, True)
    along = turned.real * z.imag + turned.imag * z.real
    begin = z if along < (turned * touch.begin).imag else touch.begin
    end = z if along > (turned * touch.end).imag else touch.end
    return Touch(begin, end, max(reach, touch.height), True)


@compiled
def _division(box: ComplexArray, bulges: FloatArray) -> tuple[int, complex]:
    """Which piece of a box to cut, the one that bulges more, and where.

    The piece is cut where its ends' distances from the other one divide it, as a bisector of the
    angle would: far parts of it matter less than near ones.
    """
    bulge_1, bulge_2 = bulges[2], bulges[3]
    if bulge_1 == bulge_2:
        bulge_1, bulge_2 = _square(box[1] - box[0]), _square(box[3] - box[2])
    piece = 0 if bulge_1 >= bulge_2 else 2
    other = 0.5 * (box[2 - piece] + box[3 - piece])
    near, far = np.sqrt(_square(box[piece] - other)), np.sqrt(_square(box[piece + 1] - other))
    share = min(max(near / (near + far), 0.1), 0.9)
    return piece, box[piece] + share * (box[piece + 1] - box[piece])


@compiled
def _square(z: complex) -> float:
    return z.real**2 + z.imag**2


@compiled
def _bound(turned: complex, images: ComplexArray, bulge_1: float, bulge_2: float) -> float:
    """What no point of a box exceeds: over its corners, first along one piece, then the other."""
    if bulge_1 == np.inf or bulge_2 == np.inf:
        return np.inf
    at_p1_a, at_p1_b, at_p2_a, at_p2_b = -np.inf, -np.inf, -np.inf, -np.inf
    for k in range(images.shape[1]):
        aa, ab = (turned * images[0, k]).real, (turned * images[1, k]).real
        ba, bb = (turned * images[2, k]).real, (turned * images[3, k]).real
        at_p1_a, at_p1_b = max(at_p1_a, _top(aa, ab, bulge_2)), max(at_p1_b, _top(ba, bb, bulge_2))
        at_p2_a, at_p2_b = max(at_p2_a, _top(aa, ba, bulge_1)), max(at_p2_b, _top(ab, bb, bulge_1))
    return min(_top(at_p1_a, at_p1_b, bulge_1), _top(at_p2_a, at_p2_b, bulge_2))


@compiled
def _top(start: float, end: float, bulge: float) -> float:
    """Top of the line between two heights plus a parabola that is `bulge` high in its middle."""
    apart = abs(start - end)
    if apart >= 4.0 * bulge:  # so steep that an end is highest
        return max(start, end)
    return 0.5 * (start + end) + bulge + apart**2 / (16.0 * bulge)
