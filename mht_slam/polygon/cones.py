"""Cones and cells of one pair of scans, in its robot-based frame F_R.

F_R of a pair: the first observation point at (0, 0), the second at (1, 0), the unit is the pair's
own baseline. A *cone* is what one detection allows, a *cell* is where two cones meet.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import shapely

from mht_slam.arrays import BoolArray, FloatArray

ObjectArray: TypeAlias = npt.NDArray[np.object_]
ComplexArray: TypeAlias = npt.NDArray[np.complex128]

DISC_SIDES = 64
"""Sides of the polygon circumscribed about the disc of `max_range`."""

EMPTY_CELL = 1e-12
"""Cells smaller than this share of epsilon squared are rounding, not geometry."""

_CONE_SPOKES = 5
_OBSERVATION_POINTS = (0.0, 1.0)


@dataclass(frozen=True)
class Cells:
    """The cells of one pair of scans in F_R, one per detection of the first and of the second.

    Attributes
    ----------
    polygons : (n1, n2) shapely polygons, empty where two cones do not meet inside the disc.
    filled : (n1, n2) whether the cell has area.
    cut : (n1, n2) whether the cell reached beyond the disc and was cut there.
    """

    polygons: ObjectArray
    filled: BoolArray
    cut: BoolArray


def cells(first: FloatArray, second: FloatArray, *, epsilon: float, max_range: float) -> Cells:
    """Intersect every cone of one scan with every cone of the next (the paper's polygons).

    `first` (n1,) and `second` (n2,) are bearings in radians from the direction of travel, taken at
    (0, 0) and (1, 0); each cone spans the bearing plus and minus `epsilon`. Cells are cut with a
    polygon circumscribed about the disc of `max_range` baselines round the pair's midpoint, so
    nothing inside `max_range` is lost. Source: the paper's section 3; docs/method.md, section 3.
    """
    cones_first = cones(first, _OBSERVATION_POINTS[0], epsilon=epsilon, max_range=max_range)
    cones_second = cones(second, _OBSERVATION_POINTS[1], epsilon=epsilon, max_range=max_range)
    uncut = shapely.intersection(cones_first[:, None], cones_second[None, :])
    boundary = disc(max_range)
    polygons = np.asarray(shapely.intersection(uncut, boundary), dtype=np.object_)
    smallest = EMPTY_CELL * epsilon**2
    filled = shapely.area(polygons) > smallest
    polygons[~filled] = shapely.Polygon()
    cut = filled & ~shapely.covered_by(uncut, boundary)
    return Cells(polygons=polygons, filled=filled, cut=cut)


def cones(bearings: FloatArray, apex: float, *, epsilon: float, max_range: float) -> ObjectArray:
    """Cones seen from (apex, 0), as (n,) polygons that reach beyond the disc of `max_range`."""
    spread = np.linspace(-epsilon, epsilon, _CONE_SPOKES)
    # Far enough that the chord between two spokes still clears the disc from either apex.
    reach = 2.0 * (max_range + 1.0) / np.cos(spread[1] - spread[0])
    angles = np.asarray(bearings)[:, None] + spread
    rim = np.stack([apex + reach * np.cos(angles), reach * np.sin(angles)], axis=-1)
    tip = np.broadcast_to(np.array([apex, 0.0]), (len(rim), 1, 2))
    polygons = shapely.polygons(np.concatenate([tip, rim], axis=1))
    return np.asarray(polygons, dtype=np.object_).reshape(len(rim))


def disc(max_range: float) -> Any:
    """Polygon circumscribed about the disc of `max_range` baselines round (0.5, 0)."""
    # Half a step off the axis: the polygon is its own mirror image in both axes.
    angles = (np.arange(DISC_SIDES) + 0.5) * (2.0 * np.pi / DISC_SIDES)
    radius = max_range / np.cos(np.pi / DISC_SIDES)
    return shapely.Polygon(
        np.column_stack([0.5 + radius * np.cos(angles), radius * np.sin(angles)])
    )


def corners(polygon: Any) -> ComplexArray:
    """Corners of a polygon as complex numbers, counter-clockwise, none repeated."""
    x, y = shapely.get_coordinates(polygon)[:-1].T
    points: ComplexArray = x + 1j * y
    from_first = points - points[0]
    signed_area = float((from_first[:-1].conj() * from_first[1:]).imag.sum())
    return np.ascontiguousarray(points if signed_area > 0.0 else points[::-1])
