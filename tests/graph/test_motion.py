"""The evidence under each motion model is an integral over what the model leaves open."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

import mht_slam as ms
from mht_slam.arrays import FloatArray
from mht_slam.errors import OptionError
from mht_slam.evidence.importance import integrate
from mht_slam.evidence.landmark_integral import log_landmark_integral
from mht_slam.graph.problem import make_problem
from mht_slam.simulation import simulate_scene

SIGMA = math.radians(0.5)
SMOOTH = ms.ObservationModel(
    sigma=SIGMA,
    motion="smooth",
    turn_sigma=math.radians(2.0),
    drift_sigma=math.radians(3.0),
    step_change_sigma=0.3,
    landmark_sigma=10.0,
)


def scene_of(seed: int, n: int = 4) -> tuple[ms.StraightRun, ms.Association]:
    """Three scans with steps of about equal length."""
    rng = np.random.default_rng(seed)
    scene = simulate_scene("annulus", n, rng, sigma=SIGMA, steps=[1.2])
    return scene.run, scene.truth


def log_landmarks(run: ms.StraightRun, table: FloatArray, poses: FloatArray) -> FloatArray:
    """(Q,) sum of the log integrals of all landmarks at (Q, 3, 3) poses."""
    total = np.zeros(len(poses))
    for row in table:
        bearings = np.array([run.scans[k].bearings[d] for k, d in enumerate(row)])
        total += log_landmark_integral(
            poses, bearings, np.full(3, SIGMA), SMOOTH.landmark_centre, SMOOTH.landmark_sigma
        )
    return total


def smooth_poses(parameters: FloatArray) -> FloatArray:
    """Poses of (Q, 5) three headings, the drift of the second step, and its log length."""
    poses = np.zeros((len(parameters), 3, 3))
    poses[:, 1, 0] = 1.0
    poses[:, :, 2] = parameters[:, :3]
    direction, length = parameters[:, 1] + parameters[:, 3], np.exp(parameters[:, 4])
    poses[:, 2, 0] = 1.0 + length * np.cos(direction)
    poses[:, 2, 1] = length * np.sin(direction)
    return poses


def log_smooth_prior(parameters: FloatArray) -> FloatArray:
    """The first step points along +x, so its drift is minus the first heading."""
    turns = np.diff(parameters[:, :3], axis=1)
    return np.asarray(
        norm.logpdf(parameters[:, 0], scale=SMOOTH.drift_sigma)
        + norm.logpdf(turns, scale=SMOOTH.turn_sigma).sum(axis=1)
        + norm.logpdf(parameters[:, 3], scale=SMOOTH.drift_sigma)
        + norm.logpdf(parameters[:, 4], scale=SMOOTH.step_change_sigma)
    )


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_smooth_evidence_is_the_integral_over_turns_drifts_and_steps(seed: int) -> None:
    run, truth = scene_of(seed)
    found = ms.refine(run, [truth], model=SMOOTH)[0]
    assert found.failure is None
    assert found.poses is not None
    headings = found.poses[:, 2]
    step = found.poses[2, :2] - found.poses[1, :2]
    drift = math.atan2(step[1], step[0]) - headings[1]
    near = np.array([*headings, drift, math.log(math.hypot(*step))])
    integral = integrate(
        lambda p: log_smooth_prior(p) + log_landmarks(run, truth.table, smooth_poses(p)),
        near,
        np.diag([0.02, 0.02, 0.02, 0.02, 0.1]) ** 2,
        np.array([-1.0, -1.0, -1.0, -1.0, 1.0]),
    )
    assert integral is not None
    # Laplace over bearings and log ranges is off by tenths of a nat with so few landmarks; a
    # normaliser forgotten would be off by .9 or more.
    assert found.log_evidence == pytest.approx(integral.log_value, abs=0.6)


def test_heavy_tails_forgive_a_bearing_that_gaussian_ones_do_not() -> None:
    run, truth = scene_of(5, n=5)
    bearings = run.scans[1].bearings.copy()
    bearings[0] += 12.0 * SIGMA
    run = ms.StraightRun([run.scans[0], ms.BearingScan(bearings), run.scans[2]])
    gaussian = ms.ObservationModel(sigma=SIGMA)
    plain = ms.refine(run, [truth], model=gaussian)[0]
    robust = ms.refine(run, [truth], model=replace(gaussian, bearing_dof=3.0))[0]
    assert robust.log_evidence > plain.log_evidence + 5.0


def test_a_hypothesis_is_solved_again_from_its_own_estimate() -> None:
    run, truth = scene_of(1)
    first = ms.refine(run, [truth], model=SMOOTH)
    again = ms.refine(run, first, model=SMOOTH)
    assert again[0].log_evidence == pytest.approx(first[0].log_evidence, abs=1e-3)
    metres = ms.refine(run, first, model=SMOOTH, scale=2.5)
    assert metres[0].poses == pytest.approx(first[0].poses * [2.5, 2.5, 1.0], abs=1e-2)


def test_a_limited_view_excuses_misses_outside_it() -> None:
    run, truth = scene_of(2)
    table = truth.table.copy()
    scans = list(run.scans)
    last = int(np.argmax(np.abs(scans[2].bearings)))
    scans[2] = ms.BearingScan(np.delete(scans[2].bearings, last))
    table[table[:, 2] == last, 2] = -1
    table[:, 2] -= table[:, 2] > last
    shorter = ms.StraightRun(scans)
    missed = ms.Association(table, shorter.n_detections)
    wide = replace(SMOOTH, detection_probability=0.9, false_alarm_rate=0.1, expected_landmarks=4.0)
    angle = 2.0 * abs(float(run.scans[2].bearings[last])) - 0.2
    narrow = replace(wide, field_of_view=angle)
    everywhere, inside = (ms.refine(shorter, [missed], model=m)[0] for m in (wide, narrow))
    gain = inside.log_evidence - everywhere.log_evidence
    assert gain == pytest.approx(-math.log(0.1), abs=1e-6)


def test_odometry_is_asked_for_where_it_is_needed() -> None:
    run, _ = scene_of(0)
    model = ms.ObservationModel(sigma=SIGMA, motion="odometry")
    with pytest.raises(OptionError, match="scan 1 has no odometry"):
        make_problem(run, (0, 1, 2), model)
    with pytest.raises(OptionError, match="the odometry gives it"):
        make_problem(run, (0, 1, 2), model, scale=2.0)
    with pytest.raises(OptionError, match="consecutive"):
        make_problem(run, (0, 2, 1), model)


def test_two_straight_runs_take_no_other_motion() -> None:
    run, _ = scene_of(0)
    pair = ms.RunPair((run.scans[0], run.scans[1]), (run.scans[1], run.scans[2]))
    with pytest.raises(OptionError, match="motion 'straight'"):
        make_problem(pair, (0, 1, 2, 3), SMOOTH)
