"""Steps of the robot: derivatives, densities, and what the graph's factors say of the same step."""

from __future__ import annotations

import math

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam import factors
from mht_slam.arrays import FloatArray
from mht_slam.incremental.motion_terms import (
    FREE,
    ODOMETRY,
    RESTART,
    SMOOTH,
    STILL,
    STRAIGHT,
    wrapped,
)

from .drives import terms

KINDS = (ODOMETRY, SMOOTH, RESTART, STILL, STRAIGHT, FREE)
SEEDS = st.integers(0, 2**32 - 1)


def draw(kind: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Parameters of a step, and three poses whose angles are nowhere near half a turn."""
    parameters = np.zeros(12)
    parameters[:3] = rng.uniform(0.05, 2.0, 3)
    parameters[3] = rng.normal()
    if kind == ODOMETRY:
        parameters[:3] = rng.normal(size=3)
        parameters[3:12] = (rng.normal(size=(3, 3)) + 3.0 * np.eye(3)).ravel()
    poses = np.zeros((3, 3))
    heading = rng.uniform(-1.0, 1.0)
    for k in range(3):
        poses[k, 2] = heading
        heading += rng.uniform(-0.9, 0.9)
        if k:
            direction = poses[k - 1, 2] + rng.uniform(-1.2, 1.2)
            step = math.exp(rng.normal(0.0, 0.7))
            poses[k, :2] = poses[k - 1, :2] + step * np.array(
                [math.cos(direction), math.sin(direction)]
            )
    poses[:, :2] += 10.0 * rng.normal(size=2) if kind != STRAIGHT else 0.0
    return parameters, poses


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, kind=st.sampled_from(KINDS))
def test_derivatives_are_the_slopes_of_the_residual(seed: int, kind: int) -> None:
    parameters, poses = draw(kind, np.random.default_rng(seed))
    _, _, jacobian = terms(kind, parameters, poses)
    for i in range(9):
        ahead, behind = poses.copy().ravel(), poses.copy().ravel()
        ahead[i] += 1e-6
        behind[i] -= 1e-6
        up = terms(kind, parameters, ahead.reshape(3, 3))[1]
        down = terms(kind, parameters, behind.reshape(3, 3))[1]
        np.testing.assert_allclose((up - down) / 2e-6, jacobian[:, i], rtol=1e-5, atol=1e-6)


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, kind=st.sampled_from((ODOMETRY, SMOOTH, RESTART, STILL, FREE)))
def test_the_volume_makes_the_density_one_over_the_next_pose(seed: int, kind: int) -> None:
    parameters, poses = draw(kind, np.random.default_rng(seed))
    volume, _, jacobian = terms(kind, parameters, poses)
    if kind == ODOMETRY:
        normaliser = np.linalg.slogdet(parameters[3:12].reshape(3, 3))[1]
    elif kind == STILL:
        normaliser = -math.log(parameters[0] ** 2 * parameters[1])
    else:
        normaliser = -np.log(parameters[:3]).sum()
    change = np.linalg.slogdet(jacobian[:, 6:])[1]
    assert change == pytest.approx(normaliser + volume, abs=1e-9)


@given(step=st.floats(0.01, 50.0), heading=st.floats(-1.0, 1.0))
def test_on_a_line_the_volume_is_that_of_the_log_step(step: float, heading: float) -> None:
    poses = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [step, 0.0, heading]])
    parameters = np.array([0.1, 0.2, 0.3, 0.4, *np.zeros(8)])
    volume, _, jacobian = terms(STRAIGHT, parameters, poses)
    change = np.linalg.slogdet(jacobian[:, 6:])[1]
    assert change == pytest.approx(volume - np.log(parameters[:3]).sum(), abs=1e-9)


def factors_of(kind: int, p: FloatArray, poses: FloatArray) -> list[gtsam.NonlinearFactor]:
    """What `mht_slam.factors` has for a step between poses 1 and 2, after the one from 0."""
    around = math.dist(poses[1, :2], poses[2, :2])
    match kind:
        case 0:  # odometry
            root = np.linalg.inv(p[3:12].reshape(3, 3))
            return [factors.odometry(1, 2, tuple(p[:3].tolist()), root @ root.T)]
        case 3:  # still
            return [factors.standstill(1, 2, p[0])]
        case 4:  # straight
            return [
                factors.heading_prior(2, 0.0, p[0]),
                factors.on_line(2, 0.0, p[1]),
                factors.log_step(1, 2, p[3], p[2], around),
            ]
    found = [factors.turn(1, 2, p[0]), factors.drift(1, 2, p[1])]
    if kind == SMOOTH:
        found.append(factors.step_change((0, 1, 2), poses, p[2]))
    else:
        found.append(factors.log_step(1, 2, p[3], p[2], around))
    return found


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, kind=st.sampled_from(KINDS))
def test_graph_factors_say_the_same_of_a_step(seed: int, kind: int) -> None:
    """Cost, gradient and curvature; GTSAM moves poses along their own axes."""
    parameters, poses = draw(kind, np.random.default_rng(seed))
    if kind == ODOMETRY:  # the same to first order about the measured motion
        c, s = math.cos(poses[1, 2]), math.sin(poses[1, 2])
        poses[2, :2] = poses[1, :2] + np.array([[c, -s], [s, c]]) @ parameters[:2]
        poses[2, 2] = poses[1, 2] + parameters[2]
    if kind == STILL:
        poses[2] = poses[1]
        parameters[1] = parameters[0]
    _, residual, jacobian = terms(kind, parameters, poses)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    axes = np.zeros((9, 9))
    ordering = gtsam.Ordering()
    for k, (x, y, theta) in enumerate(poses.tolist()):
        values.insert(k, gtsam.Pose2(x, y, theta))
        ordering.push_back(k)
        axes[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = gtsam.Rot3.Rz(theta).matrix()
        # Poses that a factor leaves out still have to be in the system.
        graph.push_back(
            gtsam.PriorFactorPose2(k, values.atPose2(k), gtsam.noiseModel.Unit.Create(3))
        )
    for factor in factors_of(kind, parameters, poses):
        graph.push_back(factor)
    assert graph.error(values) == pytest.approx(0.5 * residual @ residual, rel=1e-6, abs=1e-9)
    curvature, pull = graph.linearize(values).hessian(ordering)
    along = jacobian @ axes
    np.testing.assert_allclose(curvature - np.eye(9), along.T @ along, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(-pull, along.T @ residual, rtol=1e-6, atol=1e-6)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS, turns=st.lists(st.integers(-2, 2), min_size=3, max_size=3))
@pytest.mark.parametrize("kind", KINDS)
def test_whole_turns_of_any_pose_change_nothing(kind: int, seed: int, turns: list[int]) -> None:
    parameters, poses = draw(kind, np.random.default_rng(seed))
    turned = poses.copy()
    turned[:, 2] += 2.0 * math.pi * np.array(turns)
    volume, residual, _ = terms(kind, parameters, poses)
    again, same, _ = terms(kind, parameters, turned)
    np.testing.assert_allclose(same, residual, atol=1e-9)
    assert again == volume


@given(st.floats(-1e3, 1e3))
def test_a_wrapped_angle_points_the_same_way(angle: float) -> None:
    inside = wrapped(angle)
    assert -math.pi <= inside < math.pi
    assert math.cos(inside - angle) == pytest.approx(1.0, abs=1e-9)
