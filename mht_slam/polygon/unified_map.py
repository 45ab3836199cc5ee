"""The unified map of one hypothesis in F_L, with the regions of every pair of scans."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.hypotheses import LandmarkFrameMap, MapRegion
from mht_slam.polygon.cones import cells, corners
from mht_slam.polygon.landmark_frame import Triple, base_cells_meet, landmark_frame_regions

_BASE_POINTS = ((0.0, 0.0), (1.0, 0.0))


@dataclass(frozen=True)
class MapRecipe:
    """What it takes to draw a hypothesis's map, as plain data.

    Attributes
    ----------
    bearings : (n,) radians of each column of the association's table.
    scans : the run's scan index of each column.
    pairs : columns of the pairs that must see a landmark, then of those that only refine.
    n_ranked : how many of the pairs were compared; the rest refine.
    """

    bearings: tuple[FloatArray, ...]
    scans: tuple[int, ...]
    pairs: tuple[tuple[int, int], ...]
    n_ranked: int
    epsilon: float
    max_range: float
    region: str


def draw_map(recipe: MapRecipe, table: IntArray, base: tuple[int, int]) -> LandmarkFrameMap:
    """Regions in F_L of one hypothesis, from every pair of scans, and what they share.

    `table` is the association's, `base` its rows at (0, 0) and (1, 0). The base cells of the
    compared pairs must be disjoint; a refining pair whose own base cells are missing or meet is
    left out. Observation points are called O1, O2, ... by column. Source: the paper's section 3,
    Fig. 6; docs/method.md, section 3.
    """
    views = [
        view
        for number, pair in enumerate(recipe.pairs)
        if (view := _pair_view(recipe, pair, table, base, refines=number >= recipe.n_ranked))
        is not None
    ]
    seen_by_all = (table[:, sorted({c for p in recipe.pairs for c in p})] != MISSED).all(axis=1)
    landmarks = tuple(
        _map_region(f"landmark {row}", [(v.scans, v.landmarks[row]) for v in views])
        for row in np.flatnonzero(seen_by_all).tolist()
    )
    points = tuple(
        _map_region(
            f"O{column + 1}",
            [(v.scans, v.points[column]) for v in views if column in v.points],
        )
        for column in range(table.shape[1])
    )
    return LandmarkFrameMap(
        base=base,
        landmarks=landmarks,
        observation_points=points,
        cut=any(view.cut for view in views),
    )


@dataclass(frozen=True)
class _PairView:
    scans: tuple[int, int]
    landmarks: dict[int, Any]
    points: dict[int, Any]
    cut: bool


def _pair_view(
    recipe: MapRecipe,
    pair: tuple[int, int],
    table: IntArray,
    base: tuple[int, int],
    *,
    refines: bool,
) -> _PairView | None:
    rows = np.flatnonzero((table[:, list(pair)] != MISSED).all(axis=1)).tolist()
    first, second = (recipe.bearings[column] for column in pair)
    all_cells = cells(first, second, epsilon=recipe.epsilon, max_range=recipe.max_range)
    index = {row: (table[row, pair[0]], table[row, pair[1]]) for row in rows}
    polygons = {row: all_cells.polygons[index[row]] for row in rows}
    filled = {row: bool(all_cells.filled[index[row]]) for row in rows}
    p1, p2 = (np.array([polygons[row]], dtype=np.object_) for row in base)
    if refines and not (all(filled[row] for row in base) and not base_cells_meet(p1, p2)[0]):
        return None
    outlines = {row: corners(polygons[row]) for row in rows if filled[row]}
    thirds = [row for row in rows if row not in base]
    present = [row for row in thirds if filled[row]]
    # The pair's own frame has its observation points at 0 and 1.
    third_cells = [outlines[row] for row in present] + [np.array([0j]), np.array([1.0 + 0j])]
    regions = landmark_frame_regions(
        [Triple(outlines[base[0]], outlines[base[1]], third) for third in third_cells],
        recipe.region,
    )
    landmarks: dict[int, Any] = {row: shapely.Polygon() for row in thirds}
    landmarks |= dict(zip(present, regions, strict=False))
    landmarks |= {row: shapely.Point(xy) for row, xy in zip(base, _BASE_POINTS, strict=True)}
    return _PairView(
        scans=(recipe.scans[pair[0]], recipe.scans[pair[1]]),
        landmarks=landmarks,
        points=dict(zip(pair, regions[len(present) :], strict=True)),
        cut=any(bool(all_cells.cut[index[row]]) for row in rows),
    )


def _map_region(name: str, by_pair: list[tuple[tuple[int, int], Any]]) -> MapRegion:
    shared = by_pair[0][1]
    for _, region in by_pair[1:]:
        shared = shapely.intersection(shared, region)
    return MapRegion(name=name, by_pair=tuple(by_pair), intersection=shared)
