"""Motion factors mean what they say of headings, lines, steps and odometers."""

from __future__ import annotations

import math

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam import factors

ANGLES = st.floats(-3.0, 3.0)
LENGTHS = st.floats(0.05, 20.0)


def two_poses(first: gtsam.Pose2, second: gtsam.Pose2) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(0, first)
    values.insert(1, second)
    return values


@given(step=LENGTHS, mean=st.floats(-2.0, 2.0), sigma=st.floats(0.1, 2.0))
def test_a_log_step_is_exact_about_its_own_step(step: float, mean: float, sigma: float) -> None:
    factor = factors.log_step(0, 1, mean, sigma, step)

    def residual(length: float) -> float:
        values = two_poses(gtsam.Pose2(0.0, 0.0, 0.3), gtsam.Pose2(length, 0.0, -0.4))
        return float(factor.whitenedError(values)[0])

    assert residual(step) == pytest.approx((math.log(step) - mean) / sigma, abs=1e-9)
    h = 1e-6 * step
    slope = (residual(step + h) - residual(step - h)) / (2.0 * h)
    assert slope == pytest.approx(1.0 / (step * sigma), rel=1e-6)


def test_solving_with_renewed_log_steps_ends_at_the_mode_of_the_log_normal_posterior() -> None:
    mean, sigma, measured, noise = 0.2, 0.5, 2.0, 0.3
    step = 1.0
    for _ in range(50):
        graph = gtsam.NonlinearFactorGraph()
        graph.push_back(factors.log_step(0, 1, mean, sigma, step))
        graph.push_back(factors.known_distance(0, 1, measured, noise, poses=True))
        for pose in (0, 1):
            graph.push_back(factors.on_line(pose, 0.0, 1e-3))
            graph.push_back(factors.heading_prior(pose, 0.0, 0.1))
        graph.push_back(factors.position_prior(0, (0.0, 0.0), 1e-3))
        values = two_poses(gtsam.Pose2(0.0, 0.0, 0.0), gtsam.Pose2(step, 0.0, 0.0))
        values = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
        step = values.atPose2(1).x() - values.atPose2(0).x()
    lengths = np.linspace(1.0, 3.0, 200_001)
    cost = ((np.log(lengths) - mean) / sigma) ** 2 + ((lengths - measured) / noise) ** 2
    assert step == pytest.approx(lengths[cost.argmin()], abs=2e-5)


@given(x=st.floats(-50.0, 50.0), theta=ANGLES)
def test_the_line_does_not_notice_where_on_it_or_which_way_the_robot_looks(
    x: float, theta: float
) -> None:
    values = two_poses(gtsam.Pose2(x, 0.0, theta), gtsam.Pose2())
    assert factors.on_line(0, 0.0, 1e-4).error(values) == pytest.approx(0.0, abs=1e-8)


@given(x=st.floats(-50.0, 50.0), y=st.floats(-50.0, 50.0), theta=st.floats(-1.0, 1.0))
def test_the_heading_prior_does_not_notice_where_the_robot_is(
    x: float, y: float, theta: float
) -> None:
    values = two_poses(gtsam.Pose2(x, y, theta), gtsam.Pose2())
    error = factors.heading_prior(0, 0.0, 0.1).error(values)
    assert error == pytest.approx(0.5 * (theta / 0.1) ** 2, abs=1e-7)


@given(
    x=st.floats(-5.0, 5.0), y=st.floats(-5.0, 5.0), direction=ANGLES, length=st.floats(0.1, 10.0)
)
def test_a_straight_segment_lets_direction_and_length_free(
    x: float, y: float, direction: float, length: float
) -> None:
    away = length * np.array([math.cos(direction), math.sin(direction)])
    values = two_poses(
        gtsam.Pose2(x, y, direction), gtsam.Pose2(x + away[0], y + away[1], direction)
    )
    for factor in factors.straight_segment(0, 1, 0.01):
        assert factor.error(values) == pytest.approx(0.0, abs=1e-9)
    reversed_run = two_poses(values.atPose2(1), values.atPose2(0))
    for factor in factors.straight_segment(0, 1, 0.01):
        assert factor.error(reversed_run) == pytest.approx(0.5 * (math.pi / 0.01) ** 2)


@pytest.mark.parametrize("turn", [0.0, 0.4, -1.2, 2.5])
def test_odometry_keeps_the_covariance_of_the_increments_to_first_order(turn: float) -> None:
    covariance = 1e-6 * np.array([[4.0, 1.0, 0.3], [1.0, 9.0, -0.5], [0.3, -0.5, 2.0]])
    motion = np.array([1.5, -0.4, turn])
    factor = factors.odometry(0, 1, tuple(motion.tolist()), covariance)
    start = gtsam.Pose2(3.0, -2.0, 0.9)
    rng = np.random.default_rng(4)
    for deviation in rng.multivariate_normal(np.zeros(3), covariance, 20):
        values = two_poses(start, start.compose(gtsam.Pose2(*(motion + deviation))))
        expected = 0.5 * deviation @ np.linalg.solve(covariance, deviation)
        assert factor.error(values) == pytest.approx(expected, rel=0.02)


def test_smooth_motion_charges_what_leaves_the_heading_of_the_first_pose() -> None:
    factor = factors.smooth_motion(0, 1, 1.0, factors.FREE_SIGMA, 0.01, factors.FREE_SIGMA)
    for forward in (0.3, 1.0, 4.0):
        ahead = gtsam.Pose2(forward, 0.0, 0.0)
        assert factor.error(two_poses(gtsam.Pose2(), ahead)) == pytest.approx(0.0, abs=1e-8)
    aside = gtsam.Pose2(1.0, 0.05, 0.0)
    expected = 0.5 * (0.05 / 0.01) ** 2
    assert factor.error(two_poses(gtsam.Pose2(), aside)) == pytest.approx(expected, rel=1e-6)


def test_an_arc_ends_half_a_step_times_the_turn_beside_the_first_heading() -> None:
    factor = factors.smooth_motion(0, 1, 1.0, 0.1, 0.01, factors.FREE_SIGMA)
    turn = 0.02
    arc = gtsam.Pose2.Expmap(np.array([1.0, 0.0, turn]))
    lateral = factor.whitenedError(two_poses(gtsam.Pose2(), arc))[1]
    assert lateral == pytest.approx(0.5 * turn / 0.01, rel=0.01)


@given(
    steps=st.tuples(LENGTHS, LENGTHS),
    headings=st.tuples(ANGLES, ANGLES, ANGLES),
    directions=st.tuples(ANGLES, ANGLES),
    sigma=st.floats(0.05, 1.0),
)
def test_a_step_change_is_exact_about_its_own_poses(
    steps: tuple[float, float],
    headings: tuple[float, float, float],
    directions: tuple[float, float],
    sigma: float,
) -> None:
    moves = [[s * math.cos(d), s * math.sin(d)] for s, d in zip(steps, directions, strict=True)]
    around = np.zeros((3, 3))
    around[1:, :2] = np.cumsum(moves, axis=0)
    around[:, 2] = headings
    factor = factors.step_change((0, 1, 2), around, sigma)
    values = gtsam.Values()
    for key, (x, y, theta) in enumerate(around.tolist()):
        values.insert(key, gtsam.Pose2(x, y, theta))

    def residual(key: int, delta: np.ndarray) -> float:
        places = [values.atPose2(k) for k in range(3)]
        places[key] = places[key].retract(delta)
        a, b, c = (np.array([p.x(), p.y()]) for p in places)
        return math.log(np.linalg.norm(c - b) / np.linalg.norm(b - a)) / sigma

    assert factor.error(values) == pytest.approx(0.5 * residual(0, np.zeros(3)) ** 2, abs=1e-9)
    jacobian = factor.linearize(values).jacobian()[0]
    for key in range(3):
        for axis in range(3):
            step = 1e-6 * min(steps) * np.eye(3)[axis]
            slope = (residual(key, step) - residual(key, -step)) / (2e-6 * min(steps))
            assert jacobian[0, 3 * key + axis] == pytest.approx(slope, rel=1e-4, abs=1e-4)
