"""Weights of when a landmark is seen: a hidden chain, summed over all that may have been."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.incremental.associate import log_seen_again
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.sightings import Sightings, log_as_seen, log_unseen, sightings_of

from .rows import CONFIG, Row


def summed(chance: float, stay: float, back: float, inside: list[bool], seen_then: bool) -> float:
    """Every sequence of in view and not in view, one by one."""
    total = 0.0
    for states in product((True, False), repeat=len(inside) + seen_then):
        weight, before = 1.0, True
        for k, now in enumerate(states):
            moved = stay if before else back
            weight *= moved if now else 1.0 - moved
            if k == len(inside):
                weight *= chance if now else 0.0
            elif now and inside[k]:
                weight *= 1.0 - chance
            before = now
        total += weight
    return math.log(total)


@settings(deadline=None)
@given(
    chance=st.floats(0.05, 0.99),
    stay=st.floats(0.1, 1.0),
    back=st.floats(0.01, 0.5),
    inside=st.lists(st.booleans(), max_size=7),
    seen_then=st.booleans(),
)
def test_not_being_seen_sums_over_all_that_may_have_been_in_view(
    chance: float, stay: float, back: float, inside: list[bool], seen_then: bool
) -> None:
    found = log_unseen(chance, stay, back, bytes(inside), seen_then)
    assert found == pytest.approx(summed(chance, stay, back, inside, seen_then), abs=1e-9)


@pytest.mark.parametrize("gap", range(1, 9))
def test_always_in_the_field_it_is_the_chance_that_tracking_uses(gap: int) -> None:
    found = log_unseen(0.9, 0.97, 0.02, bytes([1] * (gap - 1)), True)
    assert found == pytest.approx(log_seen_again(0.9, 0.97, 0.02, gap))


@settings(deadline=None, max_examples=60)
@given(
    scans=st.sets(st.integers(0, 11), min_size=2, max_size=11),
    lag=st.integers(1, 12),
    view=st.sampled_from([2.0 * math.pi, math.radians(150.0)]),
    sight=st.sampled_from([None, 7.0]),
)
def test_the_odds_of_a_sighting_are_the_ratio_of_weights_with_and_without(
    scans: set[int], lag: int, view: float, sight: float | None
) -> None:
    row = Row(None, range(0))
    model = replace(CONFIG.model, field_of_view=view)
    config = SlamConfig(motion="odometry", model=model, lag=lag, sight=sight)
    sightings = Sightings(row.smoothed(), config)
    for scan in sorted(scans)[1:]:  # the first one moves the prior of the place, too
        others = sorted(scans - {scan})
        away = row.landmarks[4] - row.poses[scan, :2]
        outside = abs(math.atan2(away[1], away[0])) > 0.5 * view
        if outside or (sight is not None and math.hypot(*away) > sight):
            assert sightings.log_odds(4, others, scan) == -math.inf
        else:
            gain = sightings.log_weight(4, sorted(scans)) - sightings.log_weight(4, others)
            assert sightings.log_odds(4, others, scan) == pytest.approx(gain, abs=1e-9)
        assert sightings.log_odds(4, sorted(scans), scan) == -math.inf


def test_an_earlier_first_sighting_moves_the_prior_of_the_place() -> None:
    row = Row(None, range(0))
    whole, scans = row.smoothed(), [5, 6, 7]
    sightings = Sightings(whole, CONFIG)
    sigma = CONFIG.observation_model.landmark_sigma
    gain = sightings.log_weight(2, [3, *scans]) - sightings.log_weight(2, scans)
    for scan, sign in ((3, 1.0), (5, -1.0)):
        reach = math.hypot(*(whole.points[2] - whole.poses[scan, :2]))
        gain += sign * (-math.log(reach) - 0.5 * (reach / sigma) ** 2)
    assert sightings.log_odds(2, scans, 3) == pytest.approx(gain)


def test_away_for_long_a_landmark_is_back_with_the_share_of_time_in_view() -> None:
    config = replace(CONFIG, lag=3)
    model = config.observation_model
    sightings = Sightings(Row(None, range(0)).smoothed(), config)
    p, stay, back = model.detection_probability, model.stay_probability, config.return_probability
    assert p is not None
    gone = log_unseen(p, stay, back, bytes([1, 1, 1]), False)
    last = log_unseen(p, stay, back, bytes([1, 1]), False)  # two scans follow the newest sighting
    born = sightings.log_weight(0, [0]) - gone
    wanted = born + gone + math.log(back / (1.0 - stay + back) * p) + last
    assert sightings.log_weight(0, [0, 9]) == pytest.approx(wanted)


def test_bearings_towards_a_landmark_are_its_most_likely_sightings() -> None:
    points = np.array([[3.0, 1.0], [-2.0, 4.0]])
    pose = np.array([0.5, -0.5, 0.3])
    away = points - pose[:2]
    bearings = np.arctan2(away[:, 1], away[:, 0]) - pose[2]
    bearings[0] += 2.0 * math.pi
    found = log_as_seen(pose, points, bearings, np.full(2, 0.01), None)
    best = -0.5 * math.log(2.0 * math.pi) - math.log(math.sqrt(2.0) * 0.01)
    np.testing.assert_allclose(np.diag(found), best, atol=1e-9)
    assert (found[[0, 1], [1, 0]] < -100.0).all()


def test_detections_are_listed_by_landmark() -> None:
    owners = [np.array([4, -1, 2]), np.array([-1]), np.array([2, 4])]
    assert sightings_of(owners) == {4: [(0, 0), (2, 1)], 2: [(0, 2), (2, 0)]}
