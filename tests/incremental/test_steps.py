"""Motions to try cover what the step's own factor expects."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mht_slam.arrays import FloatArray
from mht_slam.errors import MeasurementError
from mht_slam.incremental.motion_terms import (
    FREE,
    LONGEST,
    ODOMETRY,
    RESTART,
    SHORTEST,
    SMOOTH,
    STILL,
    STRAIGHT,
)
from mht_slam.incremental.steps import Proposals, Step, frame_step, next_step, propose
from mht_slam.measurements import BearingScan, Odometry
from mht_slam.models import Motion, ObservationModel

from .drives import terms

HERE = np.array([[1.0, 0.5, 0.1], [2.5, 0.7, 0.15]])
COVARIANCE = np.array([[0.04, 0.01, 0.006], [0.01, 0.02, 0.002], [0.006, 0.002, 0.01]])
SCAN = BearingScan([0.3], odometry=Odometry(1.2, 0.1, 0.2, COVARIANCE))


def step_of(motion: Motion, number: int = 5, moved: float | None = None) -> Step:
    return next_step(ObservationModel(sigma=0.01, motion=motion), SCAN, number, False, moved)


STEPS = {
    "odometry": step_of("odometry"),
    "smooth": step_of("smooth"),
    "restart": step_of("smooth", moved=1.4),
    "straight": next_step(
        ObservationModel(sigma=0.01, motion="straight", heading_sigma=0.05, lateral_sigma=0.5),
        SCAN,
        5,
        False,
        None,
    ),
    "free": step_of("free"),
}


def next_poses(proposals: Proposals) -> FloatArray:
    c, s = math.cos(HERE[1, 2]), math.sin(HERE[1, 2])
    turned = proposals.motions @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return HERE[1] + turned


def log_density(step: Step, poses: FloatArray) -> FloatArray:
    residuals = np.array([terms(step.kind, step.parameters, [*HERE, pose])[1] for pose in poses])
    return -0.5 * (residuals**2).sum(axis=1)


@pytest.mark.parametrize("name", STEPS)
def test_the_weight_of_a_proposal_is_what_its_factor_says_of_it(name: str) -> None:
    step = STEPS[name]
    proposals = propose(step, HERE)
    expected = log_density(step, next_poses(proposals))
    difference = proposals.log_prior - expected
    np.testing.assert_allclose(difference, difference[0], atol=1e-6)


@pytest.mark.parametrize("name", STEPS)
def test_no_draw_of_the_motion_prior_is_far_from_all_proposals(name: str) -> None:
    """In units of what a proposal stands for, 95 in 100 draws lie within 2.5."""
    step, p = STEPS[name], STEPS[name].parameters
    rng = np.random.default_rng(4)
    proposals = propose(step, HERE)
    draws = np.empty((400, 3))
    for draw in draws:
        z = rng.standard_normal(3)
        if step.kind == ODOMETRY:
            draw[:] = p[:3] + np.linalg.inv(p[3:].reshape(3, 3)) @ z
            continue
        last = math.dist(HERE[0, :2], HERE[1, :2])
        length = math.exp((math.log(last) if step.kind == SMOOTH else p[3]) + p[2] * z[2])
        direction, turn = p[1] * z[1], p[0] * z[0]
        if step.kind == STRAIGHT:
            direction, turn = -HERE[1, 2], p[0] * z[0] - HERE[1, 2]
        if step.kind == FREE:  # all round
            direction, turn = rng.uniform(-math.pi, math.pi, 2)
        draw[:] = length * math.cos(direction), length * math.sin(direction), turn
    away = np.hypot(
        draws[:, None, 0] - proposals.motions[:, 0], draws[:, None, 1] - proposals.motions[:, 1]
    )
    turn = np.abs((draws[:, None, 2] - proposals.motions[:, 2] + math.pi) % (2 * math.pi) - math.pi)
    off = np.maximum(away / proposals.side_spreads, turn / proposals.turn_spread)
    assert (off.min(axis=1) < 2.5).mean() >= 0.95


def test_odometry_is_tried_at_its_mean_and_where_its_heading_error_takes_it() -> None:
    proposals = propose(STEPS["odometry"], HERE)
    best = int(np.argmax(proposals.log_prior))
    np.testing.assert_allclose(proposals.motions[best], [1.2, 0.1, 0.2], atol=1e-12)
    turns = proposals.motions[:, 2] - 0.2
    # E[place | turn] of a Gaussian.
    for axis in range(2):
        expected = (1.2, 0.1)[axis] + turns * COVARIANCE[axis, 2] / COVARIANCE[2, 2]
        np.testing.assert_allclose(proposals.motions[:, axis], expected, atol=1e-12)
    assert np.abs(turns).max() >= 2.4 * math.sqrt(COVARIANCE[2, 2])
    rest = np.trace(COVARIANCE[:2, :2]) - (COVARIANCE[:2, 2] ** 2).sum() / COVARIANCE[2, 2]
    np.testing.assert_allclose(proposals.side_spreads, math.sqrt(rest))


def test_a_standstill_has_one_proposal() -> None:
    step = next_step(ObservationModel(sigma=0.01, motion="smooth"), SCAN, 5, True, 1.0)
    assert step.kind == STILL
    proposals = propose(step, HERE)
    assert proposals.motions.tolist() == [[0.0, 0.0, 0.0]]


def test_after_a_standstill_any_step_length_is_tried() -> None:
    step = STEPS["restart"]
    assert step.kind == RESTART
    motions = propose(step, HERE).motions
    lengths = np.hypot(motions[:, 0], motions[:, 1])
    assert lengths.min() < 1.4 / 8.0
    assert lengths.max() > 1.4 * 8.0


def test_after_a_step_of_no_length_the_next_is_as_long_as_its_factor_has_it() -> None:
    """Two poses may coincide to the bit: then the last step counts as the shortest there is."""
    step = STEPS["smooth"]
    here = np.array([HERE[1], HERE[1]])
    motions = propose(step, here).motions
    lengths = np.hypot(motions[:, 0], motions[:, 1])
    _, residual, _ = terms(step.kind, step.parameters, [*here, here[1] + [SHORTEST, 0.0, 0.0]])
    assert residual[2] == pytest.approx(0.0, abs=1e-6)
    assert lengths.min() == pytest.approx(SHORTEST)
    assert (lengths < 2.0 * SHORTEST).all()
    restart = step_of("smooth", moved=0.0)
    assert restart.kind == RESTART
    assert restart.parameters[3] == math.log(SHORTEST)


@pytest.mark.parametrize("motion", ["smooth", "straight", "free"])
def test_no_step_is_tried_that_doubles_do_not_hold(motion: Motion) -> None:
    model = ObservationModel(
        sigma=0.01, motion=motion, step_change_sigma=400.0, log_step_sigma=400.0, log_step_mean=50.0
    )
    motions = propose(next_step(model, SCAN, 5, False, None), HERE).motions
    lengths = np.hypot(motions[:, 0], motions[:, 1])
    assert lengths.min() == pytest.approx(SHORTEST)
    assert lengths.max() == pytest.approx(LONGEST)


@pytest.mark.parametrize(
    "odometry",
    [
        Odometry(1e300, 0.0, 0.0, [1e-2, 1e-2, 1e-3]),
        Odometry(1.0, 0.0, 0.0, [1e-200, 1e-2, 1e-3]),
        Odometry(1.0, 0.0, 0.0, [1e-2, 1e200, 1e-3]),
    ],
)
def test_odometry_out_of_all_proportion_is_refused(odometry: Odometry) -> None:
    model = ObservationModel(sigma=0.01, motion="odometry")
    with pytest.raises(MeasurementError, match=r"scan 3 has odometry of .* check the units"):
        next_step(model, BearingScan([0.1], odometry=odometry), 3, False, None)


@pytest.mark.parametrize("motion", ["smooth", "straight", "free"])
def test_the_first_step_is_the_unit(motion: Motion) -> None:
    step = step_of(motion, number=1)
    motions = propose(step, np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])).motions
    np.testing.assert_allclose(np.hypot(motions[:, 0], motions[:, 1]), 1.0, atol=1e-9)


def test_the_made_up_step_leads_to_the_origin() -> None:
    step = frame_step()
    poses = np.array([[-2.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    _, residual, _ = terms(step.kind, step.parameters, poses)
    np.testing.assert_allclose(residual, 0.0, atol=1e-9)


@pytest.mark.parametrize("odometry", [None, Odometry(1.0, 0.0, 0.0)])
def test_odometry_that_is_missing_is_asked_for(odometry: Odometry | None) -> None:
    with pytest.raises(MeasurementError, match="scan 3 has no odometry"):
        next_step(
            ObservationModel(sigma=0.01, motion="odometry"),
            BearingScan([0.1], odometry=odometry),
            3,
            False,
            None,
        )
