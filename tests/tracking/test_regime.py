"""Dense runs are those whose landmarks move little against their distances in bearing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mht_slam as ms
from mht_slam.tracking.regime import DENSE_RATIO, bearing_change_ratio, is_dense


def run_of(step: float, n_scans: int, turn: float = 0.0, seed: int = 0) -> ms.StraightRun:
    """Ten landmarks within six metres of a path along x, and a robot that turns as it goes."""
    rng = np.random.default_rng(seed)
    reach = step * n_scans
    landmarks = np.column_stack([rng.uniform(-3.0, reach + 3.0, 10), rng.uniform(-6.0, 6.0, 10)])
    scans = []
    for k in range(n_scans):
        bearings = np.arctan2(landmarks[:, 1], landmarks[:, 0] - step * k) - turn * k
        noisy = bearings + math.radians(0.5) * rng.standard_normal(len(landmarks))
        scans.append(ms.BearingScan(rng.permutation(noisy)))
    return ms.StraightRun(scans)


@pytest.mark.parametrize("step", [0.05, 0.1])
def test_short_steps_are_tracked(step: float) -> None:
    assert all(is_dense(run_of(step, 50, seed=seed)) for seed in range(5))


@pytest.mark.parametrize("step", [1.0, 3.0])
def test_long_steps_are_not(step: float) -> None:
    assert not any(is_dense(run_of(step, 50, seed=seed)) for seed in range(5))


def test_few_scans_are_searched_however_dense() -> None:
    assert bearing_change_ratio(run_of(0.05, 49)) <= DENSE_RATIO
    assert not is_dense(run_of(0.05, 49))


@given(st.floats(-3.0, 3.0), st.integers(0, 50))
def test_what_all_bearings_turn_by_does_not_count(turn: float, seed: int) -> None:
    still = bearing_change_ratio(run_of(0.1, 4, seed=seed))
    assert bearing_change_ratio(run_of(0.1, 4, turn, seed)) == pytest.approx(still, rel=1e-6)


def test_scans_that_see_next_to_nothing_say_nothing() -> None:
    run = ms.StraightRun([ms.BearingScan([0.1, 0.5])] * 60)
    assert bearing_change_ratio(run) == math.inf
    assert not is_dense(run)
