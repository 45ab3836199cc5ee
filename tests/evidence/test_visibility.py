"""Patterns of detections have the chances that counting every stretch in view gives them."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from scipy.integrate import quad

from mht_slam import ObservationModel
from mht_slam.errors import OptionError
from mht_slam.evidence.visibility import (
    detection_chances,
    expected_detected,
    log_bearing_density,
    log_visibility,
)

PATTERNS = npst.arrays(np.bool_, st.integers(1, 6)).filter(lambda seen: bool(seen.any()))
CHANCES = st.floats(0.0, 1.0)


def chance_by_stretches(seen: np.ndarray, chances: np.ndarray, stay: float) -> float:
    """Sum over every first and last scan in view."""
    m = len(seen)
    total = 0.0
    for first in range(m):
        for last in range(first, m):
            came = 1.0 if first == 0 else 1.0 - stay
            left = 1.0 if last == m - 1 else 1.0 - stay
            product = came * stay ** (last - first) * left
            for k in range(m):
                in_view = first <= k <= last
                p = float(chances[k]) if in_view else 0.0
                product *= p if seen[k] else 1.0 - p
            total += product
    return total


@given(PATTERNS, st.lists(CHANCES, min_size=6, max_size=6), st.floats(0.05, 1.0))
def test_a_pattern_has_the_chance_of_all_stretches_that_make_it(
    seen: np.ndarray, chances: list[float], stay: float
) -> None:
    own = np.array(chances[: len(seen)])
    expected = chance_by_stretches(seen, own, stay)
    found = math.exp(log_visibility(seen[None], own[None], stay)[0])
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)


@given(st.integers(1, 5), st.floats(0.05, 1.0), st.floats(0.05, 1.0))
def test_the_expected_number_detected_sums_over_all_patterns(
    m: int, chance: float, stay: float
) -> None:
    model = ObservationModel(
        sigma=0.01,
        detection_probability=chance,
        stay_probability=stay,
        false_alarm_rate=0.1,
        expected_landmarks=3.0,
    )
    patterns = [p for p in itertools.product([False, True], repeat=m) if any(p)]
    total = sum(math.exp(log_visibility(np.array([p]), chance, stay)[0]) for p in patterns)
    assert expected_detected(model, m) == pytest.approx(3.0 * total)


@given(PATTERNS, CHANCES)
def test_landmarks_that_stay_are_detected_and_missed_independently(
    seen: np.ndarray, chance: float
) -> None:
    product = math.prod(chance if s else 1.0 - chance for s in seen.tolist())
    found = math.exp(log_visibility(seen[None], chance, 1.0)[0])
    assert found == pytest.approx(product, rel=1e-9, abs=1e-300)


def test_a_landmark_outside_the_field_of_view_is_missed_for_nothing() -> None:
    model = ObservationModel(
        sigma=0.01,
        detection_probability=0.9,
        false_alarm_rate=0.1,
        expected_landmarks=3.0,
        field_of_view=math.radians(100.0),
    )
    seen = np.array([[True, False, False]])
    bearings = np.radians([[10.0, 40.0, 60.0]])
    chances = detection_chances(model, seen, bearings)
    assert np.asarray(chances).tolist() == [[0.9, 0.9, 0.0]]
    assert math.exp(log_visibility(seen, chances, 1.0)[0]) == pytest.approx(0.9 * 0.1)


def test_a_detection_outside_the_field_of_view_counts_as_inside() -> None:
    model = ObservationModel(
        sigma=0.01,
        detection_probability=0.9,
        false_alarm_rate=0.1,
        expected_landmarks=3.0,
        field_of_view=1.0,
    )
    chances = detection_chances(model, np.array([[True]]), np.array([[2.0]]))
    assert np.asarray(chances).tolist() == [[0.9]]


def test_a_model_without_a_detection_probability_is_refused() -> None:
    with pytest.raises(OptionError, match="detection_probability"):
        detection_chances(ObservationModel(sigma=0.1), np.array([[True]]), np.zeros((1, 1)))


@given(
    st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(-3.0, 3.0)),
    st.floats(-3.0, 3.0),
    st.floats(0.5, 20.0),
)
def test_the_density_of_a_bearing_is_the_prior_along_its_ray(
    pose: tuple[float, float, float], bearing: float, sigma: float
) -> None:
    model = ObservationModel(sigma=0.01, landmark_sigma=sigma, landmark_centre=(1.0, -2.0))
    angle = pose[2] + bearing

    def along(distance: float) -> float:
        x = pose[0] + distance * math.cos(angle) - 1.0
        y = pose[1] + distance * math.sin(angle) + 2.0
        return distance * math.exp(-0.5 * (x * x + y * y) / sigma**2)

    total = quad(along, 0.0, 30.0 + 15.0 * sigma, limit=400, points=[5.0, 15.0])[0]
    found = math.exp(log_bearing_density(model, np.array(pose), np.array(bearing)))
    assert found == pytest.approx(total / (2.0 * math.pi * sigma**2), rel=1e-5, abs=1e-9)
