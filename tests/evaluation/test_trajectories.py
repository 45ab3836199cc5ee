"""Alignment undoes every similarity, and no other frame would leave a smaller error."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from mht_slam.arrays import FloatArray
from mht_slam.errors import OptionError
from mht_slam.evaluation.trajectories import Alignment, align, trajectory_errors
from mht_slam.measurements import wrap_angle

SIMILARITIES = st.builds(
    Alignment,
    st.floats(0.2, 5.0),
    st.floats(-3.1, 3.1),
    st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)),
)


def wandering(seed: int, m: int = 12) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.normal(size=(m, 2)).cumsum(axis=0), rng.uniform(-3, 3, m)])


@given(SIMILARITIES, st.integers(0, 50))
def test_alignment_undoes_a_similarity(similarity: Alignment, seed: int) -> None:
    poses = wandering(seed)
    errors = trajectory_errors(poses, similarity.poses(poses), with_scale=True)
    assert errors.position == pytest.approx(0.0, abs=1e-8)
    assert errors.heading == pytest.approx(0.0, abs=1e-8)
    assert errors.alignment.scale == pytest.approx(similarity.scale)
    assert errors.n_poses == len(poses)


@given(st.integers(0, 30), st.booleans())
def test_no_other_frame_leaves_a_smaller_position_error(seed: int, with_scale: bool) -> None:
    estimated, reference = wandering(seed), wandering(seed + 1000)

    def left(frame: FloatArray) -> float:
        turn, x, y, log_scale = frame
        other = Alignment(math.exp(log_scale) if with_scale else 1.0, turn, (x, y))
        apart = other.points(estimated) - reference[:, :2]
        return float(np.mean(np.sum(apart**2, axis=1)))

    starts = [np.array([turn, 0.0, 0.0, 0.0]) for turn in np.linspace(-3, 3, 5)]
    oracle = min(minimize(left, start).fun for start in starts)
    ours = trajectory_errors(estimated, reference, with_scale=with_scale).position ** 2
    # A reflection or a vanishing scale is beyond the oracle and beyond us.
    assert ours == pytest.approx(oracle, rel=1e-4, abs=1e-9)


def test_positions_on_one_line_are_aligned_without_a_reflection() -> None:
    line = np.column_stack([np.arange(5.0), np.zeros(5), np.full(5, 0.5)])
    turned = Alignment(2.0, 2.0, (1.0, 1.0)).poses(line)
    errors = trajectory_errors(line, turned, with_scale=True)
    assert (errors.position, errors.heading) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_robot_that_stood_still_is_aligned_by_its_headings() -> None:
    still = np.tile([1.0, 2.0, 0.3], (4, 1))
    reference = np.tile([5.0, 5.0, -2.9], (4, 1))
    errors = trajectory_errors(still, reference, with_scale=True)
    assert errors == (pytest.approx(0.0), pytest.approx(0.0), errors.alignment, 4)
    assert errors.alignment.scale == 1.0
    assert errors.alignment.rotation == pytest.approx(wrap_angle(-2.9 - 0.3))


def test_without_scale_a_stretched_estimate_keeps_its_error() -> None:
    reference = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    stretched = reference * [2.0, 1.0, 1.0]
    assert trajectory_errors(stretched, reference, with_scale=False).position == pytest.approx(
        math.sqrt(2.0 / 3.0)
    )
    assert trajectory_errors(stretched, reference, with_scale=True).position == pytest.approx(0.0)


def test_poses_and_headings_without_a_reference_are_left_out() -> None:
    poses = wandering(1)
    reference = Alignment(1.0, 0.7, (3.0, 0.0)).poses(poses)
    poses[3] = [50.0, 50.0, 0.0]
    reference[3] = np.nan
    reference[:, 2] = np.nan
    errors = trajectory_errors(poses, reference, with_scale=False)
    assert errors.position == pytest.approx(0.0, abs=1e-9)
    assert math.isnan(errors.heading)
    assert errors.n_poses == len(poses) - 1
    nothing = trajectory_errors(poses, np.full_like(poses, np.nan), with_scale=True)
    assert math.isnan(nothing.position)
    assert nothing.n_poses == 0


def test_headings_are_measured_in_the_aligned_frame() -> None:
    poses = wandering(2)
    reference = Alignment(1.0, 1.2, (0.0, 0.0)).poses(poses)
    poses[:, 2] += 0.1
    assert trajectory_errors(poses, reference, with_scale=True).heading == pytest.approx(0.1)


def test_other_shapes_are_refused() -> None:
    with pytest.raises(OptionError, match="3 estimated and 4"):
        align(np.zeros((3, 3)), np.zeros((4, 3)), with_scale=True)
    with pytest.raises(OptionError, match="reference has shape"):
        align(np.zeros((3, 3)), np.zeros((3, 2)), with_scale=True)
