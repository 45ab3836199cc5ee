"""The paper's scene has the shape the paper describes."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.simulation import paper_scene
from mht_slam.simulation.paper_scene import (
    BASE,
    LANDMARKS,
    LAWNMOWER_TRACK,
    OBSERVATION_POINTS,
    SEEN,
    SENSOR_RANGE,
)


def distance(point, name):
    return float(np.hypot(*(np.array(LANDMARKS[name]) - point)))


def bearing(point, name):
    x, y = np.array(LANDMARKS[name]) - point
    return math.atan2(y, x)


def visual_order(point):
    return sorted(SEEN, key=lambda name: bearing(point, name))


def test_the_base_landmarks_are_ten_metres_apart():
    one, other = (np.array(LANDMARKS[name]) for name in BASE)
    assert np.hypot(*(one - other)) == pytest.approx(10.0)


def test_only_three_of_five_landmarks_are_in_view():
    assert len(LANDMARKS) == 5
    for name in LANDMARKS:
        for point in OBSERVATION_POINTS:
            assert (distance(point, name) < SENSOR_RANGE) == (name in SEEN)


def test_the_observation_points_lie_on_one_leg_of_the_lawnmower():
    start, end = LAWNMOWER_TRACK[-2:]
    assert start[1] == end[1] == 0.0
    assert not OBSERVATION_POINTS[:, 1].any()
    assert start[0] < OBSERVATION_POINTS[0, 0]
    assert (np.diff(OBSERVATION_POINTS[:, 0]) > 0).all()
    assert OBSERVATION_POINTS[-1, 0] < end[0]


def test_a_lawnmower_goes_to_and_fro():
    legs = np.diff(LAWNMOWER_TRACK, axis=0)
    assert (legs == 0).any(axis=1).all(), "every leg is along an axis"
    along = legs[::2, 0]
    assert (along[:-1] * along[1:] < 0).all(), "and each turns back"


def test_ld_and_le_swap_between_o1_and_o2_and_nothing_else_does():
    first, second, third = (visual_order(point) for point in OBSERVATION_POINTS)
    assert first == ["Ld", "Le", "Lc"]
    assert second == ["Le", "Ld", "Lc"]
    assert third == second


def test_o3_is_the_farthest_from_every_landmark_and_its_step_is_the_shorter():
    first, second, third = OBSERVATION_POINTS
    for name in SEEN:
        assert distance(third, name) > max(distance(first, name), distance(second, name))
    assert np.hypot(*(third - second)) < 0.5 * np.hypot(*(second - first))


def test_the_base_is_what_the_bearings_of_o2_suggest():
    angles = {name: bearing(OBSERVATION_POINTS[1], name) for name in SEEN}

    def quality(i, j):
        a, b = angles[i], angles[j]
        return abs(math.sin(a - b)) * min(abs(math.sin(a)), abs(math.sin(b)))

    best = max((("Lc", "Ld"), ("Lc", "Le"), ("Ld", "Le")), key=lambda pair: quality(*pair))
    assert best == BASE


@given(st.integers(0, 2**32 - 1), st.floats(0.01, math.radians(3.0)))
@settings(deadline=None)
def test_cones_of_the_base_landmarks_never_meet_at_three_degrees(seed, epsilon):
    # Disjoint cones from one point make the base cells of every pair disjoint.
    scene = paper_scene(np.random.default_rng(seed), epsilon)
    rows = [
        int(np.argmin(np.hypot(*(scene.landmarks - np.array(LANDMARKS[name]) / 12.0).T)))
        for name in BASE
    ]
    bearings = scene.scans[1].bearings[scene.truth.table[rows, 1]]
    assert abs(bearings[0] - bearings[1]) > 2 * math.radians(3.0) + 0.1


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.2))
@settings(deadline=None)
def test_noise_stays_inside_epsilon_and_the_truth_is_full(seed, epsilon):
    scene = paper_scene(np.random.default_rng(seed), epsilon)
    assert scene.truth.is_full
    assert scene.truth.n_landmarks == 3
    assert len(scene.unseen_landmarks) == 2
    for row, landmark in zip(scene.truth.table, scene.landmarks, strict=True):
        for scan, detection in enumerate(row):
            x, y, theta = scene.poses[scan]
            expected = math.atan2(landmark[1] - y, landmark[0] - x) - theta
            error = abs(scene.run.scans[scan].bearings[detection] - expected)
            assert error < epsilon or error < 1e-12


def test_the_scene_is_in_baselines_and_its_step_ratio_is_the_constants():
    scene = paper_scene(np.random.default_rng(0), 0.05)
    unit = OBSERVATION_POINTS[1, 0]
    np.testing.assert_allclose(scene.poses[:, :2], OBSERVATION_POINTS / unit)
    nearly = paper_scene(np.random.default_rng(0), 0.05, deviation=0.3)
    assert nearly.poses[2, 1] == pytest.approx(0.3 / unit)
