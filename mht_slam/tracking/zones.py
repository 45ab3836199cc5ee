"""Where the visual order changes: the paper's zones, and the general rule along a path."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from mht_slam.arrays import FloatArray, finite_array, freeze
from mht_slam.errors import OptionError, TooFewLandmarksError
from mht_slam.tracking.order import apparent_angles

Zone: TypeAlias = Literal["A", "B", "C"]

MIN_LANDMARKS = 3
"""Fewest landmarks with an inside, and with more than one cyclic order."""

FARTHEST = 1e100
"""Coordinates whose products are still numbers."""

ROUNDING = 1e-12
"""Places closer than this share of the layout's extent are one place."""


@dataclass(frozen=True, eq=False)
class OrderChange:
    """A place on a path where two landmarks exchange places in the visual order.

    Attributes
    ----------
    segment : index k of the path's segment, from vertex k to vertex k + 1.
    parameter : where on that segment, in [0, 1].
    point : (2,) the place, in the frame of the path.
    pair : indices (i, j), i < j, of the two landmarks, which have one bearing there.
    by_paper_rule : whether another apparent angle there exceeds 180 degrees, as the paper's rule
        demands of a change. It always does for landmarks in convex position.
    """

    segment: int
    parameter: float
    point: FloatArray
    pair: tuple[int, int]
    by_paper_rule: bool


def zone(point: npt.ArrayLike, landmarks: npt.ArrayLike) -> Zone:
    """Zone of the paper's section 2 that a point lies in, for landmarks in convex position.

    Parameters
    ----------
    point : (2,) the robot's place.
    landmarks : (n, 2) corners of a strictly convex polygon in any order, in the same frame.

    Returns
    -------
    "A" inside the polygon, where all apparent angles are below 180 degrees; "B" outside with the
    same visual order as inside, where one apparent angle exceeds 180 degrees; "C" the rest.

    Outside, B are the places from which one side of the polygon is visible and C those from which
    several are. A place on a side belongs to B, one on the continuation of a side to C. Raises
    `TooFewLandmarksError` for fewer than three landmarks, and `OptionError` for landmarks that are
    not in convex position or a point on a landmark, which has no bearing there. Source: the paper's
    section 2; docs/method.md, section 6.

    >>> square = [(0, 0), (1, 0), (1, 1), (0, 1)]
    >>> [zone(point, square) for point in ((0.5, 0.4), (0.5, -1), (2, 2))]
    ['A', 'B', 'C']
    """
    place = finite_array(point, "point", OptionError, remedy="give two coordinates")
    if place.shape != (2,):
        raise OptionError(f"point has shape {place.shape}: give two coordinates")
    place = _points(place[None], "point")[0]
    corners = convex_corners(landmarks)
    if (corners == place).all(axis=1).any():
        raise OptionError("point is on a landmark: there it has no bearing")
    sides = np.roll(corners, -1, axis=0) - corners
    seen_from_outside = int((_cross(sides, place - corners) <= 0.0).sum())
    return "A" if seen_from_outside == 0 else "B" if seen_from_outside == 1 else "C"


def convex_corners(landmarks: npt.ArrayLike) -> FloatArray:
    """Landmarks in convex position as the polygon's corners, counter-clockwise, (n, 2).

    Raises `TooFewLandmarksError` for fewer than three, and `OptionError` where they are not in
    strictly convex position: one inside or on a side, all on a line, two in one place.
    """
    points = _points(landmarks, "landmarks")
    if len(points) < MIN_LANDMARKS:
        raise TooFewLandmarksError(
            f"landmarks has {len(points)}: zones need at least {MIN_LANDMARKS}"
        )
    away = points - points.mean(axis=0)
    corners = points[np.argsort(np.arctan2(away[:, 1], away[:, 0]), kind="stable")]
    sides = np.roll(corners, -1, axis=0) - corners
    turns = _cross(sides, np.roll(sides, -1, axis=0))
    if (turns <= ROUNDING * np.ptp(points, axis=0).max() ** 2).any():
        raise OptionError(
            "landmarks are not in convex position: zones need each of them to be a corner; "
            "order_changes holds for any layout"
        )
    return corners


def order_changes(path: npt.ArrayLike, landmarks: npt.ArrayLike) -> tuple[OrderChange, ...]:
    """Every place where the visual order changes along a polyline, in the order of travel.

    Parameters
    ----------
    path : (m, 2) vertices of the robot's path.
    landmarks : (n, 2) in any layout, in the same frame.

    The order changes exactly where the path crosses the line through two landmarks outside the
    segment between them: from one side of the line to the other. A path that touches the line and
    stays on its side changes nothing; one that runs along the line and leaves it on the other side
    changes the order once, where it reached the line; one that begins or ends on the line does not
    change it there. Landmarks in one line exchange places pair by pair at one place, listed by
    pair. Raises `OptionError` where the path goes through a landmark, which has no bearing there,
    or where two landmarks are in one place. Source: docs/method.md, section 6.
    """
    vertices, points = _points(path, "path"), _points(landmarks, "landmarks")
    smallest = ROUNDING * _extent(vertices, points)
    _refuse_landmarks_on_path(vertices, points, smallest)
    changes = []
    for i, j in combinations(range(len(points)), 2):
        along = points[j] - points[i]
        length = float(np.hypot(*along))
        if length <= smallest:
            raise OptionError(f"landmarks {i} and {j} are in one place: no robot tells them apart")
        beside = _cross(along, vertices - points[i]) / length
        beside[np.abs(beside) <= smallest] = 0.0
        for segment, parameter in _crossings(beside):
            start, end = vertices[segment], vertices[segment + 1]
            place = start + parameter * (end - start)
            outside = float((points[i] - place) @ (points[j] - place)) > 0.0
            if outside and len(points) >= MIN_LANDMARKS:
                other = np.delete(points, j, axis=0) - place  # the pair has one bearing there
                largest = apparent_angles(np.arctan2(other[:, 1], other[:, 0])).max()
                changes.append(
                    OrderChange(segment, parameter, freeze(place), (i, j), bool(largest > np.pi))
                )
    return tuple(sorted(changes, key=lambda c: (c.segment, c.parameter, c.pair)))


def _crossings(beside: FloatArray) -> list[tuple[int, float]]:
    """Segment and parameter of every change of side, given the vertices' signed distances."""
    off_line = np.flatnonzero(beside)
    found = []
    for before, after in pairwise(off_line.tolist()):
        if beside[before] * beside[after] < 0.0:
            # Vertices between the two lie on the line: the path reaches it at the first of them.
            share = beside[before] / (beside[before] - beside[before + 1])
            found.append((before, float(share)))
    return found


def _refuse_landmarks_on_path(vertices: FloatArray, points: FloatArray, smallest: float) -> None:
    for start, end in pairwise(vertices):
        along = end - start
        squared = float(along @ along)
        share = np.clip((points - start) @ along / squared if squared else 0.0, 0.0, 1.0)
        nearest = start + np.multiply.outer(share, along)
        hit = np.flatnonzero(np.hypot(*(points - nearest).T) <= smallest)
        if len(hit):
            raise OptionError(f"path goes through landmark {hit[0]}: there it has no bearing")


def _extent(vertices: FloatArray, points: FloatArray) -> float:
    every = np.concatenate([vertices, points])
    return float(np.ptp(every, axis=0).max()) if len(every) else 0.0


def _points(value: npt.ArrayLike, name: str) -> FloatArray:
    points = finite_array(value, name, OptionError, remedy="give rows of two coordinates")
    if points.size == 0:
        return points.reshape(0, 2)
    if points.ndim != 2 or points.shape[1] != 2:
        raise OptionError(f"{name} has shape {points.shape}: give rows of two coordinates")
    if np.abs(points).max() > FARTHEST:
        raise OptionError(f"{name} reaches beyond {FARTHEST:g}: give another unit of length")
    return points


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
