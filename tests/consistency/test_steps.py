"""Steps that keep ratio bounds, against steps known to keep them or to break them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.consistency.steps import RatioBounds, gaps, triples

SEEDS = st.integers(0, 2**32 - 1)


def ratios_of(steps: list[float]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    before, after = gaps(len(steps) + 1)
    return np.asarray((after @ steps) / (before @ steps))


def test_triples_with_the_last_scan_come_last() -> None:
    assert triples(4) == [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]
    assert triples(5)[:4] == triples(4)


@settings(max_examples=100, deadline=None)
@given(st.integers(4, 7), SEEDS, st.sampled_from([0.0, 1e-12, 1e-6, 0.1, 10.0]))
def test_bounds_around_the_true_ratios_leave_the_true_steps(
    n_scans: int, seed: int, width: float
) -> None:
    rng = np.random.default_rng(seed)
    steps = [1.0, *np.exp(rng.normal(0.0, 1.5, n_scans - 2)).tolist()]
    ratios = ratios_of(steps)
    lowest = ratios * np.exp(-width * rng.random(len(ratios)))
    highest = ratios * np.exp(width * rng.random(len(ratios)))
    lowest[rng.random(len(ratios)) < 0.2] = 0.0
    highest[rng.random(len(ratios)) < 0.2] = np.inf
    bounds = RatioBounds(n_scans, lowest, highest)
    assert bounds.steps_exist
    intervals = bounds.step_intervals()
    assert (intervals[:, 0] <= steps[1:]).all()
    assert (steps[1:] <= intervals[:, 1]).all()


@settings(max_examples=100, deadline=None)
@given(SEEDS, st.floats(1e-6, 1.0))
def test_ratios_that_contradict_each_other_leave_nothing(seed: int, lie: float) -> None:
    rng = np.random.default_rng(seed)
    ratios = ratios_of([1.0, *np.exp(rng.normal(0.0, 0.7, 3)).tolist()])
    # Every three of the first four scans agree on the steps but for one.
    ratios[rng.integers(4)] *= 1.0 + lie
    assert not RatioBounds(5, ratios * (1 - 1e-9), ratios * (1 + 1e-9)).steps_exist


def test_steps_that_nothing_bounds_are_unbounded() -> None:
    bounds = RatioBounds(4, np.zeros(4), np.array([np.inf, 2.0, np.inf, np.inf]))
    assert bounds.steps_exist
    intervals = bounds.step_intervals()
    assert intervals[0] == pytest.approx([0.0, 2.0], abs=1e-7)
    assert intervals[1] == pytest.approx([0.0, 2.0], abs=1e-7)
    free = RatioBounds(4, np.zeros(4), np.full(4, np.inf))
    assert free.step_intervals().tolist() == [[0.0, np.inf], [0.0, np.inf]]
