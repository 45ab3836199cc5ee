"""One track: predictions are exact geometry, updates know no seam, and misses wear it out."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.association import MISSED
from mht_slam.tracking.options import TrackerConfig
from mht_slam.tracking.tracks import Prediction, Track, begin, carry_on, miss, see, turned

CONFIG = TrackerConfig()
VARIANCE = CONFIG.sigma**2
PLACES = st.tuples(st.floats(-8.0, 8.0), st.floats(0.5, 8.0), st.sampled_from([-1.0, 1.0]))
STEPS = st.floats(0.01, 0.3)


def at(bearing: float, nearness: float, offset: float = 0.0) -> Track:
    """A track of well-known range."""
    mean = np.array([bearing, nearness, offset])
    covariance = np.diag([VARIANCE, (0.1 * nearness) ** 2, 0.01**2])
    return Track(0, 0, 0, mean, covariance, 1.0, 1, (0, 0), None)


@given(PLACES, STEPS)
def test_a_step_straight_ahead_is_predicted_exactly(
    place: tuple[float, float, float], step: float
) -> None:
    x, y = place[0], place[1] * place[2]
    prediction = carry_on(at(math.atan2(y, x), step / math.hypot(x, y), 0.02), CONFIG)
    assert prediction.mean[0] == pytest.approx(math.atan2(y, x - step) + 0.02)
    assert prediction.mean[1] == pytest.approx(step / math.hypot(x - step, y))
    assert prediction.mean[2] == 0.02


@given(PLACES, STEPS)
def test_uncertainty_goes_with_the_derivative_of_the_step(
    place: tuple[float, float, float], step: float
) -> None:
    x, y = place[0], place[1] * place[2]
    state, shift = np.array([math.atan2(y, x), step / math.hypot(x, y), 0.01]), 1e-6

    def moved(mean: np.ndarray) -> np.ndarray:
        return carry_on(at(*mean.tolist()), CONFIG).mean

    columns = []
    for unit in np.eye(3):
        change = moved(state + shift * unit) - moved(state - shift * unit)
        change[0] = math.remainder(change[0], math.tau)
        columns.append(change / (2 * shift))
    jacobian = np.column_stack(columns)
    track = at(*state.tolist())
    without_noise = jacobian @ track.covariance @ jacobian.T
    added = carry_on(track, CONFIG).covariance - without_noise
    assert added - np.diag(np.diag(added)) == pytest.approx(np.zeros((3, 3)), abs=1e-6)
    assert (np.diag(added)[:2] > 0.0).all()
    assert added[2, 2] == pytest.approx(0.0, abs=1e-9)


@given(st.floats(-3.1, 3.1), st.floats(-0.2, 0.2), st.sampled_from([-1, 0, 1]))
def test_an_update_is_the_same_on_both_sides_of_the_seam(
    bearing: float, off: float, turns: int
) -> None:
    mean, covariance = np.array([bearing, 0.05, 0.0]), np.eye(3) * 0.01
    prediction = Prediction(at(bearing, 0.05), mean, covariance, 0.99)
    here = see(prediction, 1, 0, bearing + off, VARIANCE)
    over = turned(prediction, math.pi)
    there = see(over, 1, 0, bearing + off + math.pi + math.tau * turns, VARIANCE)
    assert math.remainder(there.mean[0] - here.mean[0] - math.pi, math.tau) == pytest.approx(
        0.0, abs=1e-9
    )
    np.testing.assert_allclose(there.covariance, here.covariance)
    gain = 0.01 / (0.01 + VARIANCE)
    assert math.remainder(here.mean[0] - bearing, math.tau) == pytest.approx(gain * off, abs=1e-9)


def test_misses_wear_a_track_out_and_a_detection_restores_it() -> None:
    track, left = at(1.0, 0.05), []
    while not track.has_ended:
        track = miss(carry_on(track, CONFIG), track.scan + 1, CONFIG)
        left.append(track.existence)
    assert left == sorted(left, reverse=True)
    assert 2 <= len(left) <= 6
    stay, detected = CONFIG.stay_probability, CONFIG.detection_probability
    assert left[0] == pytest.approx(stay * (1 - detected) / (1 - stay * detected))
    again = see(carry_on(track, CONFIG), 9, 4, 1.0, VARIANCE)
    assert again.existence == 1.0
    assert (again.n_seen, again.last_seen) == (2, (9, 4))
    assert again.detections() == {9: 4, 0: 0}
    assert track.detection == MISSED


def test_a_landmark_straight_ahead_stays_ahead_until_it_is_seen_elsewhere() -> None:
    track = begin(0, 0, 0, 0.001, VARIANCE, CONFIG)
    for k in range(1, 200):
        track = see(carry_on(track, CONFIG), k, 0, 0.001, VARIANCE)
        assert abs(track.mean[0]) < 0.01


def test_a_landmark_of_unknown_range_comes_no_nearer_than_five_steps() -> None:
    """It may be anywhere ahead: by its prior range it would have been passed long since."""
    track, nearest = begin(0, 0, 0, 0.0, VARIANCE, CONFIG), 0.0
    for k in range(1, 100):
        track = see(carry_on(track, CONFIG), k, 0, 0.0, VARIANCE)
        nearest = max(nearest, float(track.mean[1]))
        assert track.mean[0] == pytest.approx(0.0, abs=1e-9)
    assert nearest == pytest.approx(1 / 5)
    known = carry_on(at(0.0, 0.4), CONFIG)
    assert known.mean[1] == pytest.approx(1.0 / (1.0 / 0.4 - 1.0))
