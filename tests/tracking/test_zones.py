"""Zones are told by apparent angles, and order changes by dense looking along the path."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.arrays import FloatArray
from mht_slam.errors import OptionError, TooFewLandmarksError
from mht_slam.tracking.order import apparent_angles, visual_order
from mht_slam.tracking.zones import OrderChange, order_changes, zone

SQUARE = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
SEEDS = st.integers(0, 2**32 - 1)


def bearings(point: FloatArray, landmarks: FloatArray) -> FloatArray:
    away = landmarks - point
    return np.arctan2(away[:, 1], away[:, 0])


def seen_order(point: FloatArray, landmarks: FloatArray) -> list[int]:
    return visual_order(bearings(point, landmarks)).tolist()


def zone_by_looking(point: FloatArray, landmarks: FloatArray) -> str:
    """The paper's own words: apparent angles, and the order seen from the middle."""
    if (apparent_angles(bearings(point, landmarks)) < math.pi).all():
        return "A"
    inside = seen_order(landmarks.mean(axis=0), landmarks)
    return "B" if seen_order(point, landmarks) == inside else "C"


@given(SEEDS, st.integers(3, 8))
def test_zones_are_those_of_the_apparent_angles_and_the_order(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    angles = np.linspace(0.0, 2 * math.pi, n, endpoint=False) + rng.uniform(-0.3, 0.3, n)
    landmarks = np.column_stack([3.0 * np.cos(angles), 2.0 * np.sin(angles)])
    landmarks = rng.permutation(landmarks)  # on an ellipse: convex whatever the angles
    for point in rng.uniform(-8.0, 8.0, (20, 2)):
        assert zone(point, landmarks) == zone_by_looking(point, landmarks)


@pytest.mark.parametrize(
    ("point", "expected"),
    [((0.5, 0.0), "B"), ((2.0, 0.0), "C"), ((-1.0, -1.0), "C"), ((0.5, 1e-9), "A")],
)
def test_places_on_the_boundaries_follow_the_documented_rule(
    point: tuple[float, float], expected: str
) -> None:
    assert zone(point, SQUARE) == expected


@pytest.mark.parametrize(
    ("landmarks", "error"),
    [
        ([*SQUARE, (0.5, 0.5)], OptionError),
        ([*SQUARE, (0.5, 0.0)], OptionError),
        ([*SQUARE, (0.0, 0.0)], OptionError),
        ([(0, 0), (1, 1), (2, 2)], OptionError),
        ([(0, 0), (1, 1)], TooFewLandmarksError),
        ([(0, 0, 0), (1, 1, 1), (2, 2, 1)], OptionError),
    ],
)
def test_layouts_without_zones_are_refused(
    landmarks: list[tuple[float, ...]], error: type[Exception]
) -> None:
    with pytest.raises(error, match="landmarks"):
        zone((0.3, 0.2), landmarks)


def test_a_place_on_a_landmark_has_no_zone() -> None:
    with pytest.raises(OptionError, match="on a landmark"):
        zone((1.0, 1.0), SQUARE)
    with pytest.raises(OptionError, match="point"):
        zone((1.0, 1.0, 0.0), SQUARE)


def position(change: OrderChange) -> float:
    """Place on the path, in segments from its start."""
    return change.segment + change.parameter


def on_path(path: FloatArray, where: float) -> FloatArray:
    segment = min(int(where), len(path) - 2)
    return path[segment] + (where - segment) * (path[segment + 1] - path[segment])


@settings(max_examples=60)
@given(SEEDS, st.integers(2, 7))
def test_the_order_seen_changes_exactly_at_the_order_changes(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    landmarks, path = rng.uniform(-5.0, 5.0, (n, 2)), rng.uniform(-6.0, 6.0, (4, 2))
    changes = order_changes(path, landmarks)
    order = seen_order(path[0], landmarks)
    pending = list(changes)
    for sample in np.linspace(0.0, 3.0, 600)[1:]:
        while pending and position(pending[0]) <= sample:
            i, j = pending.pop(0).pair
            places = {i: j, j: i}
            swapped = [places.get(k, k) for k in order]
            first = swapped.index(0)
            order = swapped[first:] + swapped[:first]
        assert seen_order(on_path(path, sample), landmarks) == order
    assert not pending


@given(SEEDS, st.integers(3, 7))
def test_each_change_lies_on_the_line_of_its_pair_outside_the_segment(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    landmarks, path = rng.uniform(-5.0, 5.0, (n, 2)), rng.uniform(-6.0, 6.0, (3, 2))
    for change in order_changes(path, landmarks):
        assert 0.0 <= change.parameter <= 1.0
        np.testing.assert_allclose(change.point, on_path(path, position(change)), atol=1e-9)
        first, second = (landmarks[k] - change.point for k in change.pair)
        assert first[0] * second[1] - first[1] * second[0] == pytest.approx(0.0, abs=1e-9)
        assert first @ second > 0.0


@given(SEEDS, st.integers(3, 8))
def test_in_convex_position_the_paper_rule_holds_at_every_change(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    angles = np.linspace(0.0, 2 * math.pi, n, endpoint=False) + rng.uniform(-0.3, 0.3, n)
    landmarks = np.column_stack([3.0 * np.cos(angles), 2.0 * np.sin(angles)])
    path = rng.uniform(-8.0, 8.0, (5, 2))
    assert all(change.by_paper_rule for change in order_changes(path, landmarks))


def test_the_paper_rule_misses_a_change_before_landmarks_all_around() -> None:
    landmarks = [(-4.0, -3.0), (4.0, -3.0), (4.0, 5.0), (0.0, 5.0), (-4.0, 5.0), (0.0, 2.0)]
    path = [(-1.0, 0.0), (1.0, 0.0)]
    (change,) = order_changes(path, landmarks)
    assert change.pair == (3, 5)
    assert change.point.tolist() == [0.0, 0.0]
    assert change.parameter == 0.5
    assert not change.by_paper_rule


LINE = [(0.0, 0.0), (1.0, 0.0)]
"""Two landmarks: their line is the x axis."""
ASIDE = (0.5, -1000.0)
"""A third one, whose lines with the others no path below crosses."""


@pytest.mark.parametrize(
    ("path", "places"),
    [
        ([(2, -1), (2, 1)], [(0, 0.5)]),  # across, outside the segment
        ([(0.5, -1), (0.5, 1)], []),  # between the two
        ([(2, 1), (3, 0), (4, 1)], []),  # touched, and back
        ([(2, 1), (3, 0), (4, -1)], [(0, 1.0)]),  # across at a vertex
        ([(2, 1), (3, 0), (4, 0), (5, -1)], [(0, 1.0)]),  # along it, and across
        ([(2, 1), (3, 0), (4, 0), (5, 1)], []),  # along it, and back
        ([(2, 0), (3, 1)], []),  # from it
        ([(3, 1), (2, 0)], []),  # to it
        ([(2, -1), (2, -1), (2, 1)], [(1, 0.5)]),  # after a standstill
        ([(2, -1)], []),
        ([], []),
    ],
)
def test_paths_that_meet_the_line_follow_the_documented_rule(
    path: list[tuple[float, float]], places: list[tuple[int, float]]
) -> None:
    changes = order_changes(path, [*LINE, ASIDE])
    assert [(c.segment, c.parameter) for c in changes] == places
    assert {c.pair for c in changes} <= {(0, 1)}


@given(SEEDS)
def test_two_landmarks_alone_have_one_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    landmarks, path = rng.uniform(-5.0, 5.0, (2, 2)), rng.uniform(-6.0, 6.0, (4, 2))
    assert order_changes(path, landmarks) == ()


def test_three_landmarks_in_a_line_exchange_places_pair_by_pair() -> None:
    changes = order_changes([(3, -1), (3, 1)], [(0, 0), (1, 0), (2, 0)])
    assert [change.pair for change in changes] == [(0, 1), (0, 2), (1, 2)]


def test_a_path_through_a_landmark_and_landmarks_in_one_place_are_refused() -> None:
    with pytest.raises(OptionError, match="path goes through landmark 1"):
        order_changes([(0.5, 0), (2, 0)], LINE)
    with pytest.raises(OptionError, match="landmarks 0 and 1 are in one place"):
        order_changes([(0, 1), (2, 1)], [(0, 0), (0, 0)])
    with pytest.raises(OptionError, match="path has shape"):
        order_changes([(0, 1, 2)], LINE)
