"""Cones, cells and the choice of the base pair."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.errors import OptionError
from mht_slam.measurements import wrap_angle
from mht_slam.polygon.base import choose_base, given_base
from mht_slam.polygon.cones import cells, corners, disc

BEARINGS = st.floats(-np.pi, np.pi)


@given(BEARINGS, BEARINGS, st.floats(0.01, 1.5), st.integers(0, 2**32 - 1))
def test_cell_holds_exactly_the_points_seen_within_epsilon_and_range(
    first: float, second: float, epsilon: float, seed: int
) -> None:
    max_range = 6.0
    found = cells(np.array([first]), np.array([second]), epsilon=epsilon, max_range=max_range)
    points = np.random.default_rng(seed).uniform(-8.0, 9.0, (400, 2))
    offsets = [
        np.abs(wrap_angle(np.arctan2(points[:, 1], points[:, 0] - apex) - bearing))
        for apex, bearing in ((0.0, first), (1.0, second))
    ]
    margin = epsilon - np.maximum(*offsets)
    distance = np.hypot(points[:, 0] - 0.5, points[:, 1])
    inside = shapely.contains_xy(found.polygons[0, 0], points[:, 0], points[:, 1])
    assert inside[(margin > 1e-6) & (distance < max_range)].all() or not found.filled[0, 0]
    assert not inside[margin < -1e-6].any()
    assert not inside[distance > max_range / np.cos(np.pi / 64) + 1e-6].any()
    if ((margin > 1e-3) & (distance < max_range - 0.1)).any():
        assert found.filled[0, 0]


def test_parallel_cones_are_cut_and_crossing_ones_are_not() -> None:
    first = np.array([np.pi / 2.0, np.pi / 4.0, 0.3])
    second = np.array([np.pi / 2.0, 3.0 * np.pi / 4.0, 2.8])
    found = cells(first, second, epsilon=np.deg2rad(3), max_range=50.0)
    assert found.cut[0, 0]
    assert not found.cut[1, 1]
    assert found.filled[[0, 1, 2], [0, 1, 2]].all()


def test_diverging_cones_have_an_empty_cell() -> None:
    found = cells(np.array([2.5]), np.array([0.5]), epsilon=0.05, max_range=100.0)
    assert not found.filled[0, 0]
    assert found.polygons[0, 0].is_empty
    assert not found.cut[0, 0]


def test_a_cell_entirely_beyond_the_disc_is_empty() -> None:
    found = cells(np.array([1.5]), np.array([1.52]), epsilon=0.002, max_range=5.0)
    assert not found.filled[0, 0]
    assert not found.cut[0, 0]


def test_disc_holds_its_circle_and_is_its_own_mirror_image() -> None:
    polygon = disc(10.0)
    angles = np.linspace(0.0, 2.0 * np.pi, 1000)
    assert shapely.contains_xy(
        polygon, 0.5 + 9.9999 * np.cos(angles), 9.9999 * np.sin(angles)
    ).all()
    assert polygon.area == pytest.approx(100.0 * np.pi, rel=2e-3)
    flipped = shapely.transform(polygon, lambda xy: xy * [1.0, -1.0])
    assert flipped.symmetric_difference(polygon).area < 1e-9


def test_corners_run_counter_clockwise_whatever_the_polygon_does() -> None:
    square = shapely.box(0.0, 0.0, 1.0, 1.0)
    for polygon in (square, square.reverse()):
        found = corners(polygon)
        assert len(found) == 4
        turns = (np.roll(found, -1) - found).conj() * (np.roll(found, -2) - np.roll(found, -1))
        assert (turns.imag > 0.0).all()


@given(st.lists(BEARINGS, min_size=2, max_size=7))
def test_base_rule_takes_the_best_pair_and_ignores_mirrors_and_reversal(
    values: list[float],
) -> None:
    bearings = np.array(values)
    among = range(len(bearings))

    def quality(i: int, j: int) -> float:
        return float(
            abs(np.sin(bearings[i] - bearings[j]))
            * min(abs(np.sin(bearings[i])), abs(np.sin(bearings[j])))
        )

    i, j = choose_base(bearings, among)
    assert i < j
    assert quality(i, j) >= max(quality(a, b) for a in among for b in among if a < b) - 1e-11
    for changed in (-bearings, bearings + np.pi):
        k, m = choose_base(changed, among)
        assert quality(k, m) == pytest.approx(quality(i, j), abs=1e-11)


def test_base_rule_breaks_ties_by_the_smallest_indices() -> None:
    assert choose_base(np.array([1.0, -1.0, 1.0, -1.0]), range(4)) == (0, 1)
    assert choose_base(np.array([1.0, -1.0, 1.0, -1.0]), (1, 2, 3)) == (1, 2)


@pytest.mark.parametrize("base", [(0, 0), (0, 3), (-1, 1), (0,), "01", (0, 1.0), (True, 1), 4])
def test_a_base_that_is_no_pair_of_detections_is_refused(base: object) -> None:
    with pytest.raises(OptionError, match="base"):
        given_base(base, 3)
