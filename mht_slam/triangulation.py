"""`triangulate`: landmarks from two scans of a straight run whose association is known."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray, finite_number, freeze
from mht_slam.association import MISSED, Association
from mht_slam.errors import AssociationError, MeasurementError
from mht_slam.measurements import SMALLEST_SIGMA, BearingScan
from mht_slam.polygon.cones import cells

_RIGHT_ANGLE = 0.5 * math.pi


@dataclass(frozen=True, eq=False)
class Triangulation:
    """Landmarks in F_R: O1 at (0, 0), O2 at (1, 0), in baselines.

    Attributes
    ----------
    rows : (n,) rows of the association that both scans see.
    meets : (n,) whether their rays meet, neither parallel nor behind the robot.
    points : (k, 2) where they meet, of the k rows ``rows[meets]``.
    covariances : (k, 2, 2) of the points, to first order in the bearings' noise.
    cells : n shapely polygons, the paper's: where both cones meet; empty where they do not.
    unbounded : (n,) whether the cell was cut at `max_range`, for it reaches beyond.
    """

    rows: IntArray
    meets: BoolArray
    points: FloatArray
    covariances: FloatArray
    cells: tuple[Any, ...]
    unbounded: BoolArray


def triangulate(
    first: BearingScan,
    second: BearingScan,
    association: Association,
    *,
    epsilon: float,
    sigma: float,
    max_range: float = 100.0,
) -> Triangulation:
    """Triangulate each landmark that both scans of a straight run see: the paper's starting point.

    Parameters
    ----------
    first, second : scans from O1 and O2, forward along the direction of travel.
    association : over these two scans.
    epsilon : vision error, radians: half the opening of the cones, below 90 degrees.
    sigma : standard deviation of a bearing, radians; a scan's own goes before it.
    max_range : cells are cut with the disc of this radius, baselines, round the midpoint.

    With bearings b1, b2 the ranges are sin b2 / s and sin b1 / s, s = sin(b2 - b1); an error of one
    bearing moves the point along the other ray. Raises `MeasurementError`, `AssociationError` or
    `OptionError` naming what is wrong. Source: the paper's section 3; docs/method.md, section 3.

    >>> left, right = BearingScan([0.785398]), BearingScan([2.356194])
    >>> found = triangulate(left, right, Association([[0, 0]], (1, 1)), epsilon=0.02, sigma=0.01)
    >>> found.points.round(3).tolist()
    [[0.5, 0.5]]
    """
    for name, scan in (("first", first), ("second", second)):
        if not isinstance(scan, BearingScan):
            raise MeasurementError(f"{name} is {type(scan).__name__}: give a BearingScan")
    if not isinstance(association, Association):
        raise AssociationError(f"association is {type(association).__name__}: give an Association")
    if association.n_detections != (len(first), len(second)):
        raise AssociationError(
            f"the association is over {association.n_detections} detections and the scans have "
            f"{(len(first), len(second))}: give the association of these two scans"
        )
    finite_number(epsilon, "epsilon", above=0.0, below=_RIGHT_ANGLE)
    finite_number(sigma, "sigma", at_least=SMALLEST_SIGMA, below=math.pi)
    finite_number(max_range, "max_range", above=0.5)
    rows = np.flatnonzero((association.table != MISSED).all(axis=1)).astype(np.int64)
    i, j = association.table[rows].T
    b1, b2 = first.bearings[i], second.bearings[j]
    points, covariances, meets = _meeting_points(
        b1, b2, _variances(first, sigma)[i], _variances(second, sigma)[j]
    )
    regions = cells(b1, b2, epsilon=epsilon, max_range=max_range)
    own = np.arange(len(rows))
    return Triangulation(
        rows=freeze(rows),
        meets=freeze(meets),
        points=freeze(points[meets]),
        covariances=freeze(covariances[meets]),
        cells=tuple(regions.polygons[own, own]),
        unbounded=freeze(regions.cut[own, own]),
    )


def _meeting_points(
    b1: FloatArray, b2: FloatArray, variance1: FloatArray, variance2: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    parallax = np.sin(b2 - b1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        range1, range2 = np.sin(b2) / parallax, np.sin(b1) / parallax
        ray1 = np.column_stack([np.cos(b1), np.sin(b1)])
        ray2 = np.column_stack([np.cos(b2), np.sin(b2)])
        points = range1[:, None] * ray1
        by_first = (range1 / parallax)[:, None] * ray2
        by_second = -(range2 / parallax)[:, None] * ray1
        covariances = variance1[:, None, None] * by_first[:, :, None] * by_first[:, None, :]
        covariances += variance2[:, None, None] * by_second[:, :, None] * by_second[:, None, :]
    finite = np.isfinite(covariances).all(axis=(1, 2))
    meets = finite & (range1 > 0.0) & (range2 > 0.0)
    return points, covariances, np.asarray(meets)


def _variances(scan: BearingScan, sigma: float) -> FloatArray:
    own = np.full(len(scan), sigma) if scan.sigma is None else scan.sigma
    return np.asarray(own**2)
