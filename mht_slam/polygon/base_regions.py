"""Regions in F_L of one pair of scans and one base: first their bounds, then as they are needed.

A *slot* is one region that can occur: a choice of both base cells with a third cell. All slots get
their first support lines at once, which bound every intersection ratio from above; the region
itself is enclosed when a search asks for it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.compiled import compiled
from mht_slam.errors import OptionError
from mht_slam.polygon.cones import ComplexArray, corners
from mht_slam.polygon.convex import polygon_area
from mht_slam.polygon.landmark_frame import (
    FIRST_DIRECTIONS,
    MAX_CORNERS,
    corner_combinations,
    disc_that_holds,
    enclose,
    first_lines,
)
from mht_slam.polygon.ratio import Outlines
from mht_slam.polygon.support import all_boxes
from mht_slam.polygon.tables import PairOfScans, base_options

MAX_SLOTS = 1_000_000
"""The most combinations of base cells, third landmark and its option that exist in one pair."""

MAX_COMBINATIONS = 200_000_000
"""The most combinations of base cells, third landmark and its option, whether they exist or not."""

_AXES = FIRST_DIRECTIONS // 2


class BaseRegions(NamedTuple):
    """Slots of one pair of scans for one base.

    Attributes
    ----------
    options : (B, 2) options of the base landmarks whose cells exist and are disjoint.
    slot : (B, T, O) slot of base options, third landmark and its option; -1 where there is none.
    cells : (S, 3) cells of both base landmarks and of the third one.
    corners, n_corners : (C, W) corners of the pair's cells, and how many each has.
    height : (S, directions) how far no point of a region exceeds; infinite where it was given up.
    point : (S, directions, 2) where it reaches farthest.
    least_area : (S,) area between those points: the region's is no smaller.
    outline : (S,) row of the region in the next three; -1 where it was not needed yet.
    outlines, outline_count, outline_area : regions enclosed so far.
    n_outlines : (1,) how many there are.
    """

    options: IntArray
    slot: IntArray
    cells: IntArray
    corners: ComplexArray
    n_corners: IntArray
    height: FloatArray
    point: ComplexArray
    least_area: FloatArray
    outline: IntArray
    outlines: ComplexArray
    outline_count: IntArray
    outline_area: FloatArray
    n_outlines: IntArray


def base_regions(
    pair: PairOfScans, base: tuple[int, int], thirds: tuple[int, ...], region: str
) -> BaseRegions:
    """Lay out the slots of a pair for one base, and bound their regions.

    `thirds` are the detections of the middle scan that may be third landmarks. Raises
    `OptionError` beyond `MAX_SLOTS`.
    """
    options = base_options(pair, base)
    n_cells = len(pair.filled)
    if len(options) * len(thirds) * len(pair.clash) > MAX_COMBINATIONS:
        raise _too_many(MAX_COMBINATIONS, "combinations of cells")
    third_cell = pair.cell_of[list(thirds)]
    free = ~(pair.clash[options[:, 0]] | pair.clash[options[:, 1]])
    exists = free[:, None, :] & pair.filled[third_cell]
    if np.count_nonzero(exists) > MAX_SLOTS:
        raise _too_many(MAX_SLOTS, "regions")
    slot = np.full(exists.shape, -1, dtype=np.int64)
    b, t, o = np.nonzero(exists)
    key, slot[b, t, o] = np.unique(b * n_cells + third_cell[t, o], return_inverse=True)
    owner, third = np.divmod(key, n_cells)
    first, second = (pair.cell_of[base[i], options[owner, i]] for i in range(2))
    polygons = pair.cells.polygons.ravel()
    outlines = Outlines.of(
        [corners(polygons[c]) if pair.filled[c] else np.empty(0, complex) for c in range(n_cells)]
    )
    n_slots = len(key)
    regions = BaseRegions(
        options=options,
        slot=slot,
        cells=np.column_stack([first, second, third]),
        corners=outlines.corners,
        n_corners=outlines.count,
        height=np.full((n_slots, FIRST_DIRECTIONS), np.inf),
        point=np.zeros((n_slots, FIRST_DIRECTIONS, 2), dtype=np.complex128),
        least_area=np.zeros(n_slots),
        outline=np.full(n_slots, -1, dtype=np.int64),
        outlines=np.empty((0, MAX_CORNERS + 1), dtype=np.complex128),
        outline_count=np.empty(0, dtype=np.int64),
        outline_area=np.empty(0),
        n_outlines=np.zeros(1, dtype=np.int64),
    )
    if region == "vertices":
        return _with_vertices(regions)
    _find_first_lines(regions)
    return regions


def _too_many(limit: int, what: str) -> OptionError:
    return OptionError(
        f"ranking would take more than {limit:,} {what}: rank fewer detections, or take a smaller "
        "epsilon"
    )


def with_room(regions: BaseRegions, allowed: BoolArray) -> BaseRegions:
    """The same regions with room for the outlines of one more base pair."""
    room, needed = len(regions.outline_count), int(regions.n_outlines[0])
    needed += room_for(regions, allowed)
    if needed <= room:
        return regions
    size = max(needed, min(2 * room, len(regions.outline)))
    return regions._replace(
        outlines=_extended(regions.outlines, size),
        outline_count=_extended(regions.outline_count, size),
        outline_area=_extended(regions.outline_area, size),
    )


@compiled
def room_for(regions: BaseRegions, allowed: BoolArray) -> int:
    """The most outlines that one base pair asks for; `allowed` is (third landmarks, options)."""
    return min(allowed.size, len(regions.outline) - int(regions.n_outlines[0]))


@compiled
def ratio_bound(
    first: BaseRegions, slot_1: int, second: BaseRegions, slot_2: int, of_union: bool
) -> float:
    """What the intersection ratio of two regions does not exceed, from their first lines."""
    shared = np.inf
    for axis in range(_AXES // 2):
        area = 1.0
        for side in (axis, axis + _AXES // 2):
            highest = min(first.height[slot_1, side], second.height[slot_2, side])
            lowest = max(-first.height[slot_1, side + _AXES], -second.height[slot_2, side + _AXES])
            if highest <= lowest:
                return 0.0
            area *= highest - lowest
        shared = min(shared, area)
    area_1, area_2 = first.least_area[slot_1], second.least_area[slot_2]
    whole = max(area_1 + area_2 - shared, max(area_1, area_2)) if of_union else min(area_1, area_2)
    return min(shared / whole, 1.0) if whole > 0.0 else 1.0


@compiled
def outline_row(regions: BaseRegions, slot: int) -> int:
    """Row of a region's outline, which is enclosed now if it was not before."""
    row = int(regions.outline[slot])
    if row >= 0:
        return row
    row = int(regions.n_outlines[0])
    first, second, third = _cells_of(regions, slot)
    if regions.height[slot, 0] < np.inf:
        boxes = all_boxes(first, second, third)
        count = enclose(boxes, regions.point[slot], regions.height[slot], regions.outlines[row])
    else:
        count = disc_that_holds(first, second, third, regions.outlines[row])
    regions.outline_count[row] = count
    regions.outline_area[row] = polygon_area(regions.outlines[row], count)
    regions.outline[slot] = row
    regions.n_outlines[0] = row + 1
    return row


@compiled
def _cells_of(regions: BaseRegions, slot: int) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    first, second, third = regions.cells[slot]
    return (
        regions.corners[first][: regions.n_corners[first]],
        regions.corners[second][: regions.n_corners[second]],
        regions.corners[third][: regions.n_corners[third]],
    )


@compiled
def _find_first_lines(regions: BaseRegions) -> None:
    for slot in range(len(regions.cells)):
        first, second, third = _cells_of(regions, slot)
        boxes = all_boxes(first, second, third)
        if first_lines(boxes, regions.point[slot], regions.height[slot]):
            regions.least_area[slot] = polygon_area(
                regions.point[slot].ravel(), 2 * FIRST_DIRECTIONS
            )
        else:
            regions.height[slot] = np.inf


def _with_vertices(regions: BaseRegions) -> BaseRegions:
    """Regions that are hulls of corner combinations: all at once, for each is a mere hull."""
    outlines = Outlines.of(
        [corner_combinations(*_cells_of(regions, slot)) for slot in range(len(regions.cells))]
    )
    n_slots = len(outlines)
    directions = np.exp(1j * np.arange(FIRST_DIRECTIONS) * (2.0 * np.pi / FIRST_DIRECTIONS))
    for slot in range(n_slots):
        own = outlines.corners[slot][: outlines.count[slot]]
        regions.height[slot] = (own[:, None] * directions.conj()).real.max(axis=0)
        regions.least_area[slot] = polygon_area(own, len(own))
    return regions._replace(
        outline=np.arange(n_slots),
        outlines=outlines.corners,
        outline_count=outlines.count,
        outline_area=regions.least_area,
        n_outlines=np.array([n_slots]),
    )


def _extended(array: FloatArray | IntArray | ComplexArray, size: int) -> Any:
    longer = np.empty((size, *array.shape[1:]), dtype=array.dtype)
    longer[: len(array)] = array
    return longer
