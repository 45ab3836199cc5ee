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

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.polygon.cones import ComplexArray, ObjectArray
from mht_slam.polygon.support import Boxes, support_points

REGIONS = ("edges", "vertices")

AREA_TOLERANCE = 0.0045
"""Largest share of a region's area that lies between its inner and its outer polygon."""

TOUCHING = 1e-9
"""Base cells closer than this share of their size count as touching."""

_FIRST_DIRECTIONS = 8
_MAX_ROUNDS = 8
_DISC_SIDES = 16
_MIN_TURN = 1e-6


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


def landmark_frame_regions(triples: Sequence[Triple], region: str = "edges") -> ObjectArray:
    """Regions of the third cells in F_L, as (n,) convex polygons.

    The base cells of a triple must be disjoint.

    ``region="edges"`` is an outer bound of the convex hull of all z, its area at most half a per
    cent too large. Edges of the base cells become circular arcs, so the hull is closed in between
    an inner polygon of extreme points and an outer one of the lines that support it; directions
    are added until both agree to `AREA_TOLERANCE`. No point of a cell is lost to sampling. Only
    where base cells nearly touch along an edge, and the region is huge, it is a disc that holds it.
    ``region="vertices"`` is the hull of the combinations of corners, which is no outer bound.

    Source: the paper's Uncertainty Analysis Method; docs/method.md, section 3.
    """
    if region == "vertices":
        combined = [_combinations(triple) for triple in triples]
        owner = np.repeat(np.arange(len(triples)), [len(images) for images in combined])
        return _hulls(np.concatenate([np.empty(0, np.complex128), *combined]), owner)
    boxes = _boxes(triples)
    regions = np.empty(len(triples), dtype=np.object_)
    angles = np.arange(_FIRST_DIRECTIONS) * (2.0 * np.pi / _FIRST_DIRECTIONS)
    new_owner = np.repeat(np.arange(len(triples)), _FIRST_DIRECTIONS)
    new_angle = np.tile(angles, len(triples))
    owner, angle = new_owner[:0], new_angle[:0]
    point, height = np.empty(0, np.complex128), np.empty(0)
    in_disc = np.zeros(len(triples), dtype=np.bool_)
    for _ in range(_MAX_ROUNDS):
        if not len(new_owner):
            break
        new_point, new_height, given_up = support_points(boxes, new_owner, np.exp(1j * new_angle))
        for hopeless in np.unique(new_owner[given_up]).tolist():
            regions[hopeless] = _disc_that_holds(triples[hopeless])
            in_disc[hopeless] = True
        owner, angle = np.concatenate([owner, new_owner]), np.concatenate([angle, new_angle])
        point, height = np.concatenate([point, new_point]), np.concatenate([height, new_height])
        order = np.lexsort((angle, owner))
        order = order[~in_disc[owner[order]]]
        if not len(order):
            break
        owner, angle, point, height = owner[order], angle[order], point[order], height[order]
        loose = _enclose(owner, angle, point, height, regions)
        unfinished = loose.any_of_owner[owner]
        new_owner, new_angle = owner[loose.corner], loose.direction[loose.corner]
        owner, angle = owner[unfinished], angle[unfinished]
        point, height = point[unfinished], height[unfinished]
    return regions


class _Loose(NamedTuple):
    """Where the outer polygons still stand too far off the inner ones."""

    corner: BoolArray  # (N,) outer corners, each after its support line
    direction: FloatArray  # (N,) the direction that would cut it off
    any_of_owner: BoolArray  # (regions,)


def _enclose(
    owner: IntArray,
    angle: FloatArray,
    point: ComplexArray,
    height: FloatArray,
    regions: ObjectArray,
) -> _Loose:
    """Write the outer polygons into `regions`; all arrays sorted by owner, then angle."""
    start = np.flatnonzero(np.diff(owner, prepend=-1))
    following = np.arange(1, len(owner) + 1)
    following[np.append(start[1:], len(owner)) - 1] = start
    turn = np.mod(angle[following] - angle, 2.0 * np.pi)
    # Where two neighbouring support lines cross, in the first one's own axes.
    along = (height[following] - height * np.cos(turn)) / np.sin(turn)
    corner = np.exp(1j * angle) * (height + 1j * along)
    chord = point[following] - point
    gap = 0.5 * np.abs(((corner - point).conj() * chord).imag)
    members = owner[start]
    regions[members] = _hulls(corner, owner)
    n_regions = len(regions)
    whole = np.zeros(n_regions)
    whole[members] = shapely.area(regions[members])
    total_gap = np.bincount(owner, gap, n_regions)
    n_corners = np.maximum(np.bincount(owner, minlength=n_regions), 1)
    unfinished = total_gap > AREA_TOLERANCE * whole
    limit = AREA_TOLERANCE * whole / n_corners
    direction = np.angle(-1j * chord)
    inside = np.mod(direction - angle, 2.0 * np.pi)
    usable = (inside > _MIN_TURN) & (inside < turn - _MIN_TURN)
    chosen = unfinished[owner] & (gap > limit[owner]) & usable
    unfinished &= np.bincount(owner[chosen], minlength=n_regions) > 0
    return _Loose(chosen, np.mod(direction, 2.0 * np.pi), unfinished)


def _boxes(triples: Sequence[Triple]) -> Boxes:
    """Products of the pieces of both base cells that matter with the third cell's corners."""
    grids = []
    pieces: dict[tuple[int, int], tuple[ComplexArray, ComplexArray]] = {}
    for first, second, third in triples:
        key = (id(first), id(second))
        if key not in pieces:
            pieces[key] = (_bulging_pieces(first, second), _bulging_pieces(second, first))
        p1, p2 = pieces[key]
        i, j, k = np.indices((len(p1), len(p2), len(third))).reshape(3, -1)
        grids.append(np.column_stack([p1[i], p2[j], third[k]]))
    owner = np.repeat(np.arange(len(triples)), [len(grid) for grid in grids])
    return Boxes(owner, np.concatenate([np.empty((0, 5), np.complex128), *grids]))


def _disc_that_holds(triple: Triple) -> object:
    """A polygon about 0.5, the middle of the base, that every z is in: from distances alone."""
    first, second = (
        shapely.Polygon(np.column_stack([cell.real, cell.imag])) for cell in triple[:2]
    )
    middle = 0.5 * (triple.first[:, None] + triple.second)
    farthest = np.abs(triple.third[:, None, None] - middle).max()
    radius = farthest / shapely.distance(first, second) / np.cos(np.pi / _DISC_SIDES)
    angles = (np.arange(_DISC_SIDES) + 0.5) * (2.0 * np.pi / _DISC_SIDES)
    return shapely.Polygon(
        np.column_stack([0.5 + radius * np.cos(angles), radius * np.sin(angles)])
    )


def _bulging_pieces(cell: ComplexArray, other: ComplexArray) -> ComplexArray:
    """(K, 2) edges of `cell` that some point of `other` sees from outside, then lone corners.

    1 / (p2 - p1) maps an edge to an arc of a circle through 0. The image of the cell lies inside
    that circle only where the edge is seen from outside; all other edges bend inwards, and only
    their ends can be extreme.
    """
    ends = np.roll(cell, -1)
    seen = ((ends - cell).conj()[:, None] * (other[None, :] - cell[:, None])).imag.min(axis=1) < 0.0
    lone = cell[~(seen | np.roll(seen, 1))]
    return np.concatenate([np.column_stack([cell, ends])[seen], np.column_stack([lone, lone])])


def _combinations(triple: Triple) -> ComplexArray:
    p1, p2, p3 = (
        triple.first[:, None, None],
        triple.second[None, :, None],
        triple.third[None, None, :],
    )
    images: ComplexArray = ((p3 - p1) / (p2 - p1)).ravel()
    return images


def _hulls(images: ComplexArray, owner: IntArray) -> ObjectArray:
    """Convex hull of the complex points of each owner; `owner` is sorted."""
    # A line string through the points is their cheapest container; only its hull is wanted.
    _, index = np.unique(owner, return_inverse=True)
    strings = shapely.linestrings(np.column_stack([images.real, images.imag]), indices=index)
    return np.asarray(shapely.convex_hull(strings), dtype=np.object_)
