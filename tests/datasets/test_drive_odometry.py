"""Speeds add up to motions, whatever the clock of the scans."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.datasets.drive_odometry import (
    CarGeometry,
    StepNoise,
    integrated_motions,
    relative_motions,
)


@given(st.floats(-2.0, 3.0), st.floats(-0.8, 0.8), st.integers(2, 6), st.integers(0, 99))
def test_constant_speeds_drive_an_arc(speed: float, turn: float, m: int, seed: int) -> None:
    at = np.sort(np.random.default_rng(seed).uniform(0.0, 5.0, m))
    times = np.arange(0.0, 5.0, 0.01)
    motions = integrated_motions(times, np.tile([speed, 0.0, turn], (len(times), 1)), at)
    angles, lasts = turn * np.diff(at), np.diff(at)
    # Chord of an arc of this length and angle, seen from its start.
    chords = speed * lasts * np.sinc(angles / 2.0 / math.pi)
    expected = np.column_stack([chords * np.cos(angles / 2), chords * np.sin(angles / 2), angles])
    np.testing.assert_allclose(motions, expected, atol=1e-4)


def test_a_speed_holds_until_the_next_one_and_before_the_first() -> None:
    twists = np.array([[1.0, 0.0, 0.0], [0.0, 0.5, 0.0], [3.0, 0.0, 0.0]])
    motions = integrated_motions(np.array([1.0, 2.0, 4.0]), twists, np.array([0.5, 1.5, 3.0, 5.0]))
    np.testing.assert_allclose(motions, [[1.0, 0, 0], [0.5, 0.5, 0], [3.0, 0.5, 0]])


def test_relative_motions_lead_from_pose_to_pose() -> None:
    poses = np.array([[1.0, 2.0, 0.3], [2.0, 2.5, 3.0], [0.0, 0.0, -3.0]])
    x, y, theta = poses[0]
    for (dx, dy, dtheta), after in zip(relative_motions(poses), poses[1:], strict=True):
        x, y = (
            x + dx * math.cos(theta) - dy * math.sin(theta),
            y + dx * math.sin(theta) + dy * math.cos(theta),
        )
        theta = math.remainder(theta + dtheta, 2.0 * math.pi)
        np.testing.assert_allclose([x, y, theta], after, atol=1e-12)


def test_a_steered_car_turns_about_one_centre() -> None:
    car = CarGeometry(wheelbase=2.0, wheel_offset=0.7, sensor_ahead=3.0, sensor_left=0.4)
    ((forward, left, turn),) = car.twists(np.array([1.0]), np.array([0.3])).tolist()
    radius = 2.0 / math.tan(0.3)  # of the middle of the rear axle, centre to its left
    assert turn == pytest.approx(1.0 / (radius - 0.7))
    assert (forward, left) == pytest.approx((turn * (radius - 0.4), turn * 3.0))


def test_noise_has_a_floor_and_grows_with_the_motion() -> None:
    noise = StepNoise(0.1, 0.2, 0.05, 0.01, 0.02, 0.5)
    still = noise.odometry(np.zeros(3))
    np.testing.assert_allclose(np.sqrt(np.diag(still.covariance)), [0.1, 0.1, 0.01])
    far = noise.odometry(np.array([30.0, 40.0, 2.0]))
    np.testing.assert_allclose(
        np.sqrt(np.diag(far.covariance)),
        [math.hypot(0.1, 10.0), math.hypot(0.1, 2.5), math.hypot(0.01, 1.0, 1.0)],
    )
