"""Regions in F_L against dense sampling, and their ratios."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.polygon.cones import cells, corners
from mht_slam.polygon.landmark_frame import Triple, base_cells_meet, landmark_frame_regions
from mht_slam.polygon.ratio import Outlines, ratio_table

Complex = npt.NDArray[np.complex128]


def random_triple(seed: int, epsilon: float) -> tuple[Triple, Complex] | None:
    """Cells of three landmarks seen with errors inside epsilon, and the landmarks."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-4.0, 4.0, (3, 2))
    bearings = [
        np.arctan2(points[:, 1], points[:, 0] - apex) + 0.9 * rng.uniform(-epsilon, epsilon, 3)
        for apex in (0.0, 1.0)
    ]
    found = cells(bearings[0], bearings[1], epsilon=epsilon, max_range=100.0)
    polygons = found.polygons.diagonal()
    if base_cells_meet(polygons[:1], polygons[1:2])[0]:
        return None
    return Triple(*(corners(p) for p in polygons)), points[:, 0] + 1j * points[:, 1]


def along_boundary(cell: Complex, per_edge: int) -> Complex:
    places = np.linspace(0.0, 1.0, per_edge, endpoint=False)[:, None]
    return np.concatenate((cell + places * (np.roll(cell, -1) - cell)).T)


def densely_sampled_hull(triple: Triple, per_edge: int) -> shapely.Geometry:
    """Hull of all combinations of boundary points, with closer points where cells are close."""
    p1, p2 = along_boundary(triple.first, per_edge), along_boundary(triple.second, per_edge)
    inverse = 1.0 / (p2[None, :] - p1[:, None])
    images = np.concatenate([((p3 - p1[:, None]) * inverse).ravel() for p3 in triple.third])
    return shapely.convex_hull(shapely.MultiPoint(np.column_stack([images.real, images.imag])))


def compact_triple(seed: int, epsilon: float) -> Triple:
    """A random triple whose base cells uniform sampling can measure: apart, and not long."""
    for attempt in range(100):
        scene = random_triple(100 * seed + attempt, epsilon)
        if scene is not None and np.abs(np.concatenate(scene[0][:2])).max() <= 20.0:
            return scene[0]
    raise AssertionError("no suitable triple")


@pytest.mark.parametrize("epsilon_deg", [1.0, 3.0, 8.0])
@pytest.mark.parametrize("seed", range(4))
def test_edges_region_is_an_outer_bound_within_half_a_per_cent(
    seed: int, epsilon_deg: float
) -> None:
    triple = compact_triple(seed, np.deg2rad(epsilon_deg))
    region = landmark_frame_regions([triple])[0]
    coarse, dense = (densely_sampled_hull(triple, n) for n in (40, 120))
    left = dense.area - coarse.area  # the sampled area still grows by about an eighth of that
    assert region.buffer(1e-9 * np.sqrt(region.area)).covers(dense)
    assert region.area <= 1.005 * (dense.area + left)


def crowded_at_the_ends(cell: Complex, per_end: int) -> Complex:
    """Points along the boundary, in geometric steps from both ends of every edge."""
    steps = 0.5 * np.geomspace(1e-4, 1.0, per_end)
    places = np.concatenate([[0.0], steps, 1.0 - steps])[:, None]
    return np.concatenate((cell + places * (np.roll(cell, -1) - cell)).T)


def test_edges_region_of_long_cells_is_no_disc() -> None:
    """Bearings that are nearly parallel: cells that reach to the cut at 100 baselines."""
    n_long = 0
    for seed in range(16):
        rng = np.random.default_rng(seed)
        bearings = rng.uniform(0.3, 2.8, 3)
        found = cells(bearings, bearings + rng.uniform(0.0, 0.1, 3), epsilon=0.05, max_range=100.0)
        polygons = found.polygons.diagonal()
        if not found.filled.diagonal().all() or shapely.distance(*polygons[:2]) < 3.0:
            continue
        n_long += 1
        triple = Triple(*(corners(p) for p in polygons))
        p1, p2 = (crowded_at_the_ends(c, 40) for c in triple[:2])
        z = ((triple.third[:, None, None] - p1[:, None]) / (p2 - p1[:, None])).ravel()
        dense = shapely.convex_hull(shapely.MultiPoint(np.column_stack([z.real, z.imag])))
        region = landmark_frame_regions([triple])[0]
        assert region.buffer(1e-9 * np.sqrt(region.area)).covers(dense)
        assert region.area <= 1.02 * dense.area  # the sampled hull is about a per cent too small
    assert n_long >= 5


@given(st.integers(0, 2**32 - 1), st.floats(0.002, 0.2))
@settings(max_examples=60, deadline=None)
def test_edges_region_holds_the_truth_and_the_vertices_region(seed: int, epsilon: float) -> None:
    scene = random_triple(seed, epsilon)
    if scene is None:
        return
    triple, points = scene
    truth = (points[2] - points[0]) / (points[1] - points[0])
    edges = landmark_frame_regions([triple])[0]
    vertices = landmark_frame_regions([triple], "vertices")[0]
    assert shapely.contains_xy(edges, truth.real, truth.imag)
    assert edges.buffer(1e-9 * np.sqrt(edges.area)).covers(vertices)


@given(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_edges_region_holds_every_image_of_points_inside_the_cells(seed: int, inner: int) -> None:
    scene = random_triple(seed, np.deg2rad(4))
    if scene is None:
        return
    rng = np.random.default_rng(inner)
    p1, p2, p3 = (rng.dirichlet(np.ones(len(c)), 2000) @ c for c in scene[0])
    images = (p3 - p1) / (p2 - p1)
    region = landmark_frame_regions([scene[0]])[0]
    assert shapely.contains_xy(region, images.real, images.imag).all()


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_exchanging_base_landmarks_turns_the_region_by_half_a_turn(seed: int) -> None:
    scene = random_triple(seed, np.deg2rad(3))
    if scene is None:
        return
    first, second, third = scene[0]
    region, exchanged = landmark_frame_regions(
        [Triple(first, second, third), Triple(second, first, third)]
    )
    turned = shapely.transform(exchanged, lambda xy: [1.0, 0.0] - xy)
    assert turned.symmetric_difference(region).area <= 1e-7 * region.area


def test_a_point_as_third_cell_gives_where_the_observation_point_may_be() -> None:
    scene = random_triple(3, np.deg2rad(2))
    assert scene is not None
    (first, second, _), points = scene
    region = landmark_frame_regions([Triple(first, second, np.array([1.0 + 0j]))])[0]
    truth = (1.0 - points[0]) / (points[1] - points[0])
    assert shapely.contains_xy(region, truth.real, truth.imag)


def test_base_cells_that_nearly_touch_along_an_edge_still_have_a_finite_outer_region() -> None:
    square = np.array([0j, 1.0 + 0j, 1.0 + 1j, 1j])
    third = np.asarray(square * 0.1 + 3.0, dtype=np.complex128)
    second = np.asarray(square + 1.00001, dtype=np.complex128)
    region = landmark_frame_regions([Triple(square, second, third)])[0]
    assert np.isfinite(region.area)
    p1, p2 = 1.0 + 0.3j, 1.00001 + 0.3j
    images = (third - p1) / (p2 - p1)
    assert shapely.contains_xy(region, images.real, images.imag).all()


def test_cells_that_share_a_point_meet_and_distant_ones_do_not() -> None:
    box = shapely.box(0.0, 0.0, 1.0, 1.0)
    others = [shapely.box(x, 0.0, x + 1.0, 1.0) for x in (0.5, 1.0, 1.1)]
    assert base_cells_meet(np.array([box] * 3), np.array(others)).tolist() == [True, True, False]


def outline_of(polygon: shapely.Geometry) -> Complex:
    x, y = shapely.get_coordinates(shapely.orient_polygons(polygon))[:-1].T
    return np.asarray(x + 1j * y)


def test_ratios_of_squares() -> None:
    squares = Outlines.of([outline_of(shapely.box(x, 0.0, x + 1.0, 1.0)) for x in (0.0, 0.5, 2.0)])
    wide = Outlines.of([outline_of(shapely.box(0.0, 0.0, 2.0, 1.0))])
    assert ratio_table(squares, wide, "iou")[:, 0] == pytest.approx([0.5, 0.5, 0.0])
    assert ratio_table(squares, wide, "overlap")[:, 0] == pytest.approx([1.0, 1.0, 0.0])


def test_a_region_without_area_has_ratio_zero() -> None:
    flat = Outlines.of([np.array([0.0 + 0.0j, 1.0 + 0.0j])])
    square = Outlines.of([outline_of(shapely.box(0.0, -1.0, 1.0, 1.0))])
    for ratio in ("iou", "overlap"):
        assert ratio_table(flat, square, ratio)[0, 0] == 0.0
