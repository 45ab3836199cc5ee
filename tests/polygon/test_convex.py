"""Convex polygons of complex corners against shapely."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.polygon.convex import convex_hull, polygon_area, shared_area

Complex = npt.NDArray[np.complex128]


def point_cloud(seed: int) -> Complex:
    """Between one and twenty points; of every other seed on a coarse grid, so that some meet."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(int(rng.integers(1, 21)), 2)) + rng.normal(size=2)
    if seed % 2:
        points = np.round(points)
    return np.asarray(points[:, 0] + 1j * points[:, 1])


def hull_of(points: Complex) -> Complex:
    hull = np.empty(len(points) + 1, dtype=np.complex128)
    return hull[: convex_hull(points, hull)]


def shapely_hull(points: Complex) -> shapely.Geometry:
    return shapely.convex_hull(shapely.MultiPoint(np.column_stack([points.real, points.imag])))


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_hull_is_shapelys(seed: int) -> None:
    points = point_cloud(seed)
    hull, expected = hull_of(points), shapely_hull(points)
    corners = {complex(*xy) for xy in shapely.get_coordinates(expected)}
    assert len(hull) == len(corners)
    assert set(hull.tolist()) == corners
    assert polygon_area(hull, len(hull)) == pytest.approx(expected.area, abs=1e-12)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1))
def test_the_shared_area_is_shapelys(seed_1: int, seed_2: int) -> None:
    clouds = point_cloud(seed_1), point_cloud(seed_2)
    first, second = (hull_of(cloud) for cloud in clouds)
    expected = shapely.intersection(*(shapely_hull(cloud) for cloud in clouds)).area
    assert shared_area(first, len(first), second, len(second)) == pytest.approx(expected, abs=1e-9)


def test_polygons_that_touch_share_nothing() -> None:
    square = np.array([0j, 1 + 0j, 1 + 1j, 1j])
    for shift in (1.0, 1.0j, 1.0 + 1.0j):
        assert shared_area(square, 4, square + shift, 4) == 0.0
    assert shared_area(square, 4, square, 4) == 1.0
