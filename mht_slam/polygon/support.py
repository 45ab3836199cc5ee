"""How far a region in F_L reaches in a direction: branch and bound over the cells' boundaries."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.polygon.cones import ComplexArray

SUPPORT_TOLERANCE = 5e-4
"""How much too far a support line may stand, as a share of the region's width there."""

_MAX_ROUNDS = 100
_MAX_BOXES = 200
_LONGER = 4.0
_IN_LINE = 1e-12


class Boxes(NamedTuple):
    """Products of a straight boundary piece of each base cell with a corner of the third cell.

    Attributes
    ----------
    region : (N,) sorted indices of the regions, each of which has at least one box.
    ends : (N, 5) both ends of the piece for p1, both ends of that for p2, and p3.
    """

    region: IntArray
    ends: ComplexArray


def support_points(
    boxes: Boxes, region: IntArray, direction: ComplexArray
) -> tuple[ComplexArray, FloatArray, BoolArray]:
    """Extreme points of regions of z = (p3 - p1) / (p2 - p1), and lines that support them.

    A query q asks how far region ``region[q]`` reaches along the unit number ``direction[q]``.
    Returns a point of each region; a height that no point of the region exceeds, above that point
    by `SUPPORT_TOLERANCE` of the region's width; and whether the search was given up because base
    cells nearly touch along an edge: then the height means nothing.

    The best p2 on its piece is known in closed form for each p1, so only p1's piece is divided.
    """
    starts = np.searchsorted(boxes.region, np.arange(boxes.region[-1] + 2))
    count = starts[region + 1] - starts[region]
    query = np.repeat(np.arange(len(region)), count)
    offset = np.cumsum(count) - count
    box = np.arange(len(query)) + (starts[region] - offset)[query]
    ends, swapped = _shorter_first(boxes.ends)
    ends, swapped = ends[box], swapped[box]
    reach, image = _farthest(ends, swapped, direction[query])
    tolerance = SUPPORT_TOLERANCE * _widths(boxes.ends, box, direction[query], offset)
    best = np.full(len(region), -np.inf)
    point = np.zeros(len(region), dtype=np.complex128)
    given_up = np.zeros(len(region), dtype=np.bool_)
    for _ in range(_MAX_ROUNDS):
        _keep_best(query, reach, image, best, point)
        bound = _bound(reach, _bulge(ends))
        unsettled = bound > (best + tolerance)[query]
        given_up |= np.bincount(query[unsettled], minlength=len(region)) > _MAX_BOXES
        unsettled &= ~given_up[query]
        if not unsettled.any():
            break
        query, swapped = np.repeat(query[unsettled], 2), np.repeat(swapped[unsettled], 2)
        ends = _bisect(ends[unsettled])
        reach, image = _farthest(ends, swapped, direction[query])
    else:
        given_up[query] = True
    return point, best + tolerance, given_up


def _widths(
    ends: ComplexArray, box: IntArray, direction: ComplexArray, offset: IntArray
) -> FloatArray:
    """Width of each query's region along its direction, from the corners of its boxes."""
    p1, p2, p3 = ends[:, [0, 0, 1, 1]], ends[:, [2, 3, 2, 3]], ends[:, 4, None]
    corners = ((p3 - p1) / (p2 - p1))[box]
    reach = corners.real * direction.real[:, None] + corners.imag * direction.imag[:, None]
    width: FloatArray = np.maximum.reduceat(reach.max(axis=1), offset) - np.minimum.reduceat(
        reach.min(axis=1), offset
    )
    return width


def _shorter_first(ends: ComplexArray) -> tuple[ComplexArray, BoolArray]:
    """Exchange p1 and p2, which turns z into 1 - z, where p1's piece is the longer one."""
    swapped = np.abs(ends[:, 1] - ends[:, 0]) > np.abs(ends[:, 3] - ends[:, 2])
    return np.where(swapped[:, None], ends[:, [2, 3, 0, 1, 4]], ends), swapped


def _farthest(
    ends: ComplexArray, swapped: BoolArray, direction: ComplexArray
) -> tuple[FloatArray, ComplexArray]:
    """(N, 2) farthest reach, and the z there, with p1 at either end and p2 anywhere on its piece.

    On p2's whole line 1 / (p2 - p1) runs over a circle through 0 with the diameter 1 / foot, the
    foot of the perpendicular seen from p1; its point farthest along a direction is known. Between
    the ends of the piece only that point or an end can be farthest.
    """
    p1 = ends[:, :2]
    p2_a, p2_b, p3 = ends[:, 2, None], ends[:, 3, None], ends[:, 4, None]
    turned = np.where(swapped, -direction, direction).conj()[:, None]
    along = p2_b - p2_a
    length = np.abs(along)
    unit = np.where(length > 0.0, along, 1.0) / np.where(length > 0.0, length, 1.0)
    start, end = p2_a - p1, p2_b - p1
    arm = p3 - p1
    pull = turned * arm
    inverse_a, inverse_b = 1.0 / start, 1.0 / end
    image = np.where((pull * inverse_a).real >= (pull * inverse_b).real, inverse_a, inverse_b)
    # The foot's vector is at a right angle to the line: 1j * unit times its signed length.
    height = (unit.conj() * start).imag
    strength = np.abs(pull)
    inner = (
        (np.abs(height) > _IN_LINE * (length + np.abs(start))) & (strength > 0.0) & (length > 0.0)
    )
    centre = 0.5 / (1j * unit * np.where(inner, height, 1.0))
    top = centre + np.abs(centre) * pull.conj() / np.where(inner, strength, 1.0)
    inner &= top != 0.0
    place = (unit.conj() * (1.0 / np.where(inner, top, 1.0) - start)).real
    inner &= (place > 0.0) & (place < length)
    image = np.where(inner, top, image)
    reach = (pull * image).real
    z = arm * image
    return (
        np.where(swapped[:, None], direction.real[:, None] + reach, reach),
        np.where(swapped[:, None], 1.0 - z, z),
    )


def _keep_best(
    query: IntArray,
    reach: FloatArray,
    image: ComplexArray,
    best: FloatArray,
    point: ComplexArray,
) -> None:
    """Replace the best point of each query (sorted) where a box reaches farther."""
    second = reach[:, 1] > reach[:, 0]
    farthest = np.where(second, reach[:, 1], reach[:, 0])
    start = np.flatnonzero(np.diff(query, prepend=-1))
    highest = np.maximum.reduceat(farthest, start)
    improved = highest > best[query[start]]
    best[query[start[improved]]] = highest[improved]
    winner = np.flatnonzero(farthest == best[query])
    point[query[winner]] = np.where(second[winner], image[winner, 1], image[winner, 0])


def _bound(reach: FloatArray, bulge: FloatArray) -> FloatArray:
    """(N,) what z cannot exceed: the top of the line between p1's ends plus a parabola."""
    apart = np.abs(reach[:, 0] - reach[:, 1])
    level = apart >= 4.0 * bulge  # so steep that an end is highest
    safe = np.where(level, 1.0, bulge)
    top = 0.5 * (reach[:, 0] + reach[:, 1]) + bulge + apart**2 / (16.0 * safe)
    bound: FloatArray = np.where(level, reach.max(axis=1), top)
    return bound


def _bulge(ends: ComplexArray) -> FloatArray:
    """(N,) how much farther than at p1's ends z can reach with p1 between them.

    The error of linear interpolation is at most an eighth of the squared length times the second
    derivative, 2 (p3 - p2) / (p2 - p1)^3, whatever p2 is. All p2 - p1 of a box lie in a
    parallelogram, so its corners' components along its middle bound the distance from below.
    """
    p1_a, p1_b, p2_a, p2_b, p3 = ends.T
    apart = np.stack([p2_a - p1_a, p2_b - p1_a, p2_a - p1_b, p2_b - p1_b], axis=1)
    middle = apart.sum(axis=1)
    length = np.abs(middle)
    axis = (middle / np.where(length > 0.0, length, 1.0))[:, None]
    nearest = (apart.real * axis.real + apart.imag * axis.imag).min(axis=1)
    piece = np.abs(p1_b - p1_a)
    arm = np.maximum(np.abs(p3 - p2_a), np.abs(p3 - p2_b))
    clear = nearest > 0.0
    bulge = 0.25 * piece**2 * arm / np.where(clear, nearest, 1.0) ** 3
    return np.where(clear | (piece == 0.0), bulge, np.inf)


def _bisect(ends: ComplexArray) -> ComplexArray:
    """Divide each box across p1's piece, or p2's where that is so long that it hides distances.

    Returns (2N, 5), side by side. A piece is cut where its ends' distances from the other one
    divide it, as a bisector of the angle would: far parts of it matter less than near ones.
    """
    rows = np.arange(len(ends))
    piece_1, piece_2 = np.abs(ends[:, 1] - ends[:, 0]), np.abs(ends[:, 3] - ends[:, 2])
    start = np.where(piece_2 > _LONGER * piece_1, 2, 0)
    low, high = ends[rows, start], ends[rows, start + 1]
    other = 0.5 * (ends[rows, 2 - start] + ends[rows, 3 - start])
    near, far = np.abs(low - other), np.abs(high - other)
    cut = low + (high - low) * np.clip(near / (near + far), 0.1, 0.9)
    halves = np.repeat(ends, 2, axis=0)
    halves[2 * rows, start + 1] = cut
    halves[2 * rows + 1, start] = cut
    return halves
