"""Poses of runs are in the run's frame."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.errors import OptionError
from mht_slam.measurements import wrap_angle
from mht_slam.simulation import trajectories

STEPS = st.lists(st.floats(0.01, 100.0), max_size=6)
SEEDS = st.integers(0, 2**32 - 1)


@given(STEPS)
def test_a_straight_run_starts_with_the_unit_baseline_and_keeps_its_steps(steps):
    poses = trajectories.straight(steps)
    assert poses[0].tolist() == [0.0, 0.0, 0.0]
    assert poses[1].tolist() == [1.0, 0.0, 0.0]
    np.testing.assert_allclose(np.diff(poses[1:, 0]), steps, rtol=1e-9)
    assert not poses[:, 1:].any()


@given(STEPS, SEEDS)
def test_a_nearly_straight_run_leaves_the_first_two_points_exact(steps, seed):
    poses = trajectories.nearly_straight(
        steps, np.random.default_rng(seed), heading_sigma=0.1, lateral_sigma=0.2
    )
    np.testing.assert_array_equal(poses[:2, :2], [[0.0, 0.0], [1.0, 0.0]])
    np.testing.assert_array_equal(poses[:, 0], trajectories.straight(steps)[:, 0])
    assert poses[:, 2].all(), "every heading deviates, the first included"


def test_a_smooth_run_walks_as_its_model_says():
    poses = trajectories.smooth(
        20_000,
        np.random.default_rng(0),
        turn_sigma=0.03,
        drift_sigma=0.08,
        step_change_sigma=0.002,  # small, since the walk of 20,000 steps has to stay finite
    )
    np.testing.assert_allclose(poses[:2, :2], [[0.0, 0.0], [1.0, 0.0]], atol=1e-12)
    steps = np.diff(poses[:, :2], axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    drifts = wrap_angle(np.arctan2(steps[:, 1], steps[:, 0]) - poses[:-1, 2])
    assert np.std(wrap_angle(np.diff(poses[:, 2]))) == pytest.approx(0.03, rel=0.03)
    assert np.std(drifts) == pytest.approx(0.08, rel=0.03)
    assert np.std(np.diff(np.log(lengths))) == pytest.approx(0.002, rel=0.03)


def test_deviations_have_the_stated_size():
    poses = trajectories.nearly_straight(
        np.ones(20_000), np.random.default_rng(0), heading_sigma=0.05, lateral_sigma=0.3
    )
    assert poses[:, 2].std() == pytest.approx(0.05, rel=0.03)
    assert poses[2:, 1].std() == pytest.approx(0.3, rel=0.03)


def test_steps_are_log_normal():
    steps = trajectories.draw_steps(20_000, np.random.default_rng(0), log_mean=0.5, log_sigma=0.7)
    assert np.log(steps).mean() == pytest.approx(0.5, abs=0.02)
    assert np.log(steps).std() == pytest.approx(0.7, rel=0.03)


@given(st.integers(1, 30), SEEDS)
def test_a_free_robot_looks_where_it_has_just_gone(n_scans, seed):
    poses = trajectories.free(n_scans, np.random.default_rng(seed), step=2.0)
    moves = np.diff(poses[:, :2], axis=0)
    lengths = np.hypot(moves[:, 0], moves[:, 1])
    assert ((lengths >= 1.0 - 1e-9) & (lengths <= 3.0 + 1e-9)).all()
    np.testing.assert_allclose(np.cos(poses[1:, 2]), moves[:, 0] / lengths, atol=1e-9)
    np.testing.assert_allclose(np.sin(poses[1:, 2]), moves[:, 1] / lengths, atol=1e-9)


@pytest.mark.parametrize("steps", [[1.0, 0.0], [-1.0], [np.nan], [[1.0]]])
def test_steps_that_are_none_are_refused(steps):
    with pytest.raises(OptionError, match="steps"):
        trajectories.straight(steps)
