"""Every factor: its error by hand, its Jacobian by differences, and its way through an archive."""

from __future__ import annotations

import math
import pickle
from typing import Any

import gtsam
import numpy as np
import pytest

from mht_slam import factors

POSE, OTHER, LANDMARK, SECOND_LANDMARK = 0, 1, 2, 3

FACTORS: dict[str, tuple[Any, float]] = {
    # name: factor, half the squared residual by hand at the values below
    "bearing": (
        factors.bearing(POSE, LANDMARK, 0.3, 0.1),
        0.5 * ((math.atan2(2.0, 3.0) - 0.2 - 0.3) / 0.1) ** 2,
    ),
    "landmark_range": (
        factors.landmark_range(POSE, LANDMARK, 3.0, 0.5),
        0.5 * ((math.hypot(3.0, 2.0) - 3.0) / 0.5) ** 2,
    ),
    "bearing_and_range": (
        factors.bearing_and_range(POSE, LANDMARK, 0.3, 3.0, 0.1, 0.5),
        0.5 * ((math.atan2(2.0, 3.0) - 0.5) / 0.1) ** 2
        + 0.5 * ((math.hypot(3.0, 2.0) - 3.0) / 0.5) ** 2,
    ),
    "landmark_prior": (
        factors.landmark_prior(LANDMARK, (1.0, 1.0), 2.0),
        0.5 * (3.0**2 + 2.0**2) / 4.0,
    ),
    "position_prior": (
        factors.position_prior(OTHER, (2.0, 2.0), 4.0),
        0.5 * (0.5**2 + 1.5**2) / 16.0,
    ),
    "first_baseline[0]": (
        factors.first_baseline(POSE, OTHER, length=2.0)[0],
        0.5 * (1.0 / 2e-3) ** 2 + 0.5 * (1.0 / 2e-4) ** 2,
    ),
    "first_baseline[1]": (
        factors.first_baseline(POSE, OTHER, length=2.0, line_sigma=0.1)[1],
        0.5 * (0.5 / 2e-3) ** 2 + 0.5 * (0.5 / 0.2) ** 2,
    ),
    "heading_prior": (factors.heading_prior(OTHER, 0.1, 0.05), 0.5 * (0.4 / 0.05) ** 2),
    "on_line": (factors.on_line(OTHER, 0.2, 0.1), 0.5 * (0.3 / 0.1) ** 2),
    "straight_segment[0]": (
        factors.straight_segment(POSE, OTHER, 0.1)[0],
        0.5 * ((math.atan2(-0.5, 1.5) - 0.2) / 0.1) ** 2,
    ),
    "straight_segment[1]": (
        factors.straight_segment(POSE, OTHER, 0.1)[1],
        0.5 * ((math.atan2(-0.5, 1.5) - 0.5) / 0.1) ** 2,
    ),
    "known_distance of landmarks": (
        factors.known_distance(LANDMARK, SECOND_LANDMARK, 4.0, 0.5),
        0.5 * ((math.hypot(6.0, 3.0) - 4.0) / 0.5) ** 2,
    ),
    "known_distance of poses": (
        factors.known_distance(POSE, OTHER, 1.0, 0.5, poses=True),
        0.5 * ((math.hypot(1.5, 0.5) - 1.0) / 0.5) ** 2,
    ),
    "log_step": (
        factors.log_step(POSE, OTHER, 0.1, 0.7, math.hypot(1.5, 0.5)),
        0.5 * ((math.log(math.hypot(1.5, 0.5)) - 0.1) / 0.7) ** 2,
    ),
    "turn": (factors.turn(POSE, OTHER, 0.2), 0.5 * (0.3 / 0.2) ** 2),
    "standstill": (factors.standstill(POSE, OTHER, 0.2), math.nan),
    "drift": (
        factors.drift(POSE, OTHER, 0.1),
        0.5 * ((math.atan2(-0.5, 1.5) - 0.2) / 0.1) ** 2,
    ),
    "smooth_motion": (factors.smooth_motion(POSE, OTHER, 1.0, 0.3, 0.1, 0.2), math.nan),
    "odometry": (
        factors.odometry(POSE, OTHER, (1.3, -0.7, 0.25), np.diag([0.04, 0.09, 0.01])),
        math.nan,
    ),
}


def some_values() -> gtsam.Values:
    values = gtsam.Values()
    values.insert(POSE, gtsam.Pose2(1.0, 1.0, 0.2))
    values.insert(OTHER, gtsam.Pose2(2.5, 0.5, 0.5))
    values.insert(LANDMARK, np.array([4.0, 3.0]))
    values.insert(SECOND_LANDMARK, np.array([-2.0, 0.0]))
    return values


def moved(values: gtsam.Values, key: int, delta: np.ndarray[Any, Any]) -> gtsam.Values:
    """Return the values with one of them moved in its own tangent space."""
    result = gtsam.Values(values)
    if key in (POSE, OTHER):
        result.update(key, values.atPose2(key).retract(delta))
    else:
        result.update(key, values.atPoint2(key) + delta)
    return result


@pytest.mark.parametrize("name", [n for n, (_, e) in FACTORS.items() if not math.isnan(e)])
def test_the_error_is_the_hand_formula(name: str) -> None:
    factor, expected = FACTORS[name]
    # FREE_SIGMA adds 1e-12 of a squared length.
    assert factor.error(some_values()) == pytest.approx(expected, rel=1e-9, abs=1e-10)


@pytest.mark.parametrize("name", FACTORS)
def test_the_jacobian_is_the_derivative_of_the_whitened_residual(name: str) -> None:
    factor, _ = FACTORS[name]
    values = some_values()
    jacobian = factor.linearize(values).jacobian()[0]
    column = 0
    for key in list(factor.keys()):
        size = 3 if key in (POSE, OTHER) else 2
        for axis in range(size):
            step = 1e-6 * np.eye(size)[axis]
            plus = factor.whitenedError(moved(values, key, step))
            minus = factor.whitenedError(moved(values, key, -step))
            difference = (plus - minus) / 2e-6
            assert jacobian[:, column] == pytest.approx(difference, rel=1e-5, abs=1e-5)
            column += 1
    assert column == jacobian.shape[1]


@pytest.mark.parametrize("name", FACTORS)
def test_a_factor_survives_pickle_and_archive(name: str) -> None:
    factor, _ = FACTORS[name]
    values = some_values()
    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(factor)
    archived = gtsam.NonlinearFactorGraph()
    archived.deserialize(graph.serialize())
    for copy in (pickle.loads(pickle.dumps(factor)), archived.at(0)):  # noqa: S301 - our own bytes
        assert copy.error(values) == factor.error(values)
        assert factors.log_normaliser(copy) == factors.log_normaliser(factor)


def test_a_bearing_across_the_backward_direction_is_close() -> None:
    values = some_values()
    values.update(LANDMARK, np.array([1.0 + math.cos(0.2 - 3.1), 1.0 + math.sin(0.2 - 3.1)]))
    error = factors.bearing(POSE, LANDMARK, 3.1, 0.1).error(values)
    assert error == pytest.approx(0.5 * ((2 * math.pi - 6.2) / 0.1) ** 2)
