"""The visual order is cyclic, starts at the first bearing, and does not see the robot turn."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.errors import MeasurementError
from mht_slam.tracking.order import apparent_angles, visual_order

BEARINGS = st.lists(st.integers(-179, 180), min_size=1, max_size=8, unique=True).map(np.deg2rad)


@given(BEARINGS, st.floats(-10.0, 10.0))
def test_a_turn_of_the_robot_changes_neither_order_nor_apparent_angles(
    bearings: np.ndarray, turn: float
) -> None:
    assert visual_order(bearings + turn).tolist() == visual_order(bearings).tolist()
    np.testing.assert_allclose(
        apparent_angles(bearings + turn), apparent_angles(bearings), atol=1e-9
    )


@given(BEARINGS)
def test_the_order_is_counter_clockwise_from_the_first_bearing(bearings: np.ndarray) -> None:
    order = visual_order(bearings).tolist()
    assert order[0] == 0
    assert sorted(order) == list(range(len(bearings)))
    steps = [
        (bearings[b] - bearings[a]) % (2 * math.pi)
        for a, b in zip(order, [*order[1:], order[0]], strict=True)
    ]
    if len(bearings) > 1:
        np.testing.assert_allclose(apparent_angles(bearings), steps, atol=1e-12)
    assert apparent_angles(bearings).sum() == pytest.approx(2 * math.pi)


@given(BEARINGS)
def test_a_mirror_reverses_the_order(bearings: np.ndarray) -> None:
    first, *rest = visual_order(bearings).tolist()
    assert visual_order(-bearings).tolist() == [first, *rest[::-1]]


def test_equal_bearings_follow_each_other_at_no_angle() -> None:
    assert visual_order([1.0, 0.5, 1.0]).tolist() == [0, 2, 1]
    assert apparent_angles([1.0, 0.5, 1.0])[0] == 0.0


def test_nothing_seen_has_no_order_and_one_bearing_a_whole_turn() -> None:
    assert visual_order([]).size == apparent_angles([]).size == 0
    assert apparent_angles([0.3]).tolist() == [2 * math.pi]


@pytest.mark.parametrize("bad", [[math.nan], [[0.1, 0.2]], ["north"]])
def test_what_is_no_list_of_bearings_is_refused(bad: list[object]) -> None:
    with pytest.raises(MeasurementError, match="bearings"):
        visual_order(bad)  # type: ignore[arg-type]
    with pytest.raises(MeasurementError, match="bearings"):
        apparent_angles(bad)  # type: ignore[arg-type]
