"""The turn is what all bearings do in common, whoever is missed and whatever is false."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.tracking.options import TrackerConfig
from mht_slam.tracking.tracks import Prediction, begin
from mht_slam.tracking.turn import common_shift

CONFIG = TrackerConfig()
DEGREE = math.radians(1.0)


def predictions_at(bearings: np.ndarray) -> list[Prediction]:
    covariance = np.diag([DEGREE**2, 0.01**2, CONFIG.turn_error_sigma**2])
    return [
        Prediction(
            begin(k, 0, k, float(b), CONFIG.sigma**2, CONFIG),
            np.array([b, 0.03, 0.0]),
            covariance,
            0.99,
        )
        for k, b in enumerate(bearings)
    ]


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.floats(-40.0, 40.0))
def test_a_turn_is_found_among_misses_and_false_alarms(seed: int, degrees: float) -> None:
    rng = np.random.default_rng(seed)
    bearings = np.deg2rad([-170.0, -121.0, -40.0, -12.0, 33.0, 64.0, 115.0])
    seen = np.delete(bearings, rng.integers(7)) + degrees * DEGREE
    seen += 0.3 * DEGREE * rng.standard_normal(6)
    scan = rng.permutation(np.append(seen, rng.uniform(-3.0, 3.0)))
    shift = common_shift(predictions_at(bearings), scan, np.full(7, CONFIG.sigma**2), 0.0, CONFIG)
    assert shift == pytest.approx(degrees * DEGREE, abs=1.5 * DEGREE)


def test_a_lone_bearing_that_moves_is_a_turn_in_part() -> None:
    alone = predictions_at(np.array([0.5]))
    moved = np.array([0.5 + 2.0 * DEGREE])
    shift = common_shift(alone, moved, np.array([CONFIG.sigma**2]), 0.0, CONFIG)
    assert 0.5 * DEGREE < shift < 1.9 * DEGREE


def test_nothing_seen_leaves_what_was_expected() -> None:
    nobody, nothing = predictions_at(np.array([])), np.array([])
    some = predictions_at(np.array([0.5]))
    assert common_shift(nobody, np.array([0.1]), np.array([0.01]), 0.2, CONFIG) == 0.2
    assert common_shift(some, nothing, nothing, 0.2, CONFIG) == 0.2
