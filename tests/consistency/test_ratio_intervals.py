"""Ratio intervals of three cones against sampling, their side conditions, the shared window."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.consistency.ratio_intervals import (
    Cones,
    pair_meets,
    ratio_intervals,
    shared_ratios,
)

Floats = npt.NDArray[np.float64]
SEEDS = st.integers(0, 2**32 - 1)


def left_cones(*intervals: tuple[float, float]) -> list[Cones]:
    """Cones that hold these cotangents on the left and nothing on the right."""
    return [Cones(np.array([low, np.inf]), np.array([high, -np.inf])) for low, high in intervals]


def is_empty(interval: tuple[Floats, Floats]) -> bool:
    return bool(interval[0] > interval[1])


def test_the_third_side_condition_refuses_the_classic_false_certificate() -> None:
    assert is_empty(ratio_intervals(*left_cones((0.0, 1.0), (0.5, 5.0), (2.0, 3.0))))
    # Each of the first two conditions alone holds there, and r would range over (0, inf).
    assert not is_empty(ratio_intervals(*left_cones((0.0, 2.1), (0.5, 5.0), (2.0, 3.0))))


def test_an_interval_has_the_ends_of_the_formula() -> None:
    low, high = ratio_intervals(*left_cones((4.0, 5.0), (2.0, 3.0), (0.0, 1.0)))
    assert low == pytest.approx((2 - 1) / (5 - 2), rel=1e-14)
    assert high == pytest.approx((3 - 0) / (4 - 3), rel=1e-14)
    assert low < 1 / 3
    assert high > 3


def test_an_end_that_does_not_exist_is_zero_or_infinite() -> None:
    assert ratio_intervals(*left_cones((2.0, 5.0), (2.0, 3.0), (0.0, 2.5))) == (0.0, np.inf)


def test_a_cone_that_contains_the_line_of_travel_is_on_both_sides() -> None:
    ahead, behind, aside = (Cones.of(np.array(b), 0.1) for b in (0.05, -3.1, 1.0))
    assert ahead.present.tolist() == behind.present.tolist() == [True, True]
    assert aside.present.tolist() == [True, False]
    assert ahead.highest.tolist() == [np.inf, np.inf]
    assert behind.lowest.tolist() == [-np.inf, -np.inf]
    assert ratio_intervals(ahead, ahead, behind) == (0.0, np.inf)
    assert is_empty(ratio_intervals(behind, ahead, ahead))
    assert pair_meets(ahead, behind)
    assert not pair_meets(behind, ahead)


@settings(max_examples=200, deadline=None)
@given(SEEDS, st.floats(0.1, 89.0))
def test_no_landmark_that_three_cones_hold_has_its_ratio_outside(seed: int, degrees: float) -> None:
    rng = np.random.default_rng(seed)
    epsilon = float(np.deg2rad(degrees))
    n = 400
    x, y = rng.uniform(-4.0, 8.0, n), rng.normal(0.0, rng.choice([0.01, 1.0, 10.0]), n)
    ratio = np.exp(rng.normal(0.0, 1.5, n))
    seen = [np.arctan2(y, x - at) for at in (0.0, 1.0, 1.0 + ratio)]
    # The scan is the first landmark's; whichever others its cones hold are tested too.
    centres = [b[0] + epsilon * rng.uniform(-1.0, 1.0) for b in seen]
    apart = [(b - c + np.pi) % (2 * np.pi) - np.pi for b, c in zip(seen, centres, strict=True)]
    held = np.all([np.abs(a) <= epsilon for a in apart], axis=0)
    held[0] = True
    low, high = ratio_intervals(
        *(Cones.of(np.array((c + np.pi) % (2 * np.pi) - np.pi), epsilon) for c in centres)
    )
    assert low <= ratio[held].min()
    assert ratio[held].max() <= high


@settings(max_examples=200, deadline=None)
@given(st.lists(st.integers(-40, 40), min_size=6, max_size=6, unique=True), SEEDS)
def test_computed_ends_are_outside_the_exact_ones(ends: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    scale = float(rng.uniform(0.1, 10.0))
    intervals = [tuple(sorted((scale * ends[i], scale * ends[i + 1]))) for i in (0, 2, 4)]
    low, high = ratio_intervals(*left_cones(*intervals))  # type: ignore[arg-type]
    (l1, u1), (l2, u2), (l3, u3) = ((Fraction(a), Fraction(b)) for a, b in intervals)
    if not (u1 > l2 and u2 > l3 and u1 > l3):
        assert low > high
        return
    exact_low = (l2 - u3) / (u1 - l2) if l2 > u3 else Fraction(0)
    assert 0 <= exact_low - Fraction(float(low)) <= exact_low * Fraction(1, 10**14)
    if l1 > u2:
        exact_high = (u2 - l3) / (l1 - u2)
        assert 0 <= Fraction(float(high)) - exact_high <= exact_high * Fraction(1, 10**14)
    else:
        assert high == np.inf


@settings(max_examples=100, deadline=None)
@given(st.integers(1, 12), SEEDS, st.floats(0.01, 5.0))
def test_the_shared_window_holds_the_true_ratio(n: int, seed: int, degrees: float) -> None:
    rng = np.random.default_rng(seed)
    epsilon = float(np.deg2rad(degrees))
    x, y = rng.uniform(-3.0, 6.0, n), rng.choice([-1, 1], n) * rng.uniform(0.5, 4.0, n)
    ratio = float(np.exp(rng.normal()))
    bearings = [
        rng.permutation(np.arctan2(y, x - at) + epsilon * rng.choice([-1, 1], n))
        for at in (0.0, 1.0, 1.0 + ratio)
    ]
    low, high = shared_ratios([Cones.of(b, epsilon) for b in bearings])
    assert low <= ratio <= high


def test_the_shared_window_needs_unambiguous_sides() -> None:
    bearings = [np.array([0.8, -0.6]), np.array([1.2, -0.9]), np.array([1.8, -1.5])]
    low, high = shared_ratios([Cones.of(b, 0.02) for b in bearings])
    assert 0.0 < low < high < np.inf
    assert shared_ratios([Cones.of(b, 0.7) for b in bearings]) == (0.0, np.inf)
    # As many on either side in every scan, or nothing explains them.
    bearings[1] = np.array([1.2, 0.9])
    low, high = shared_ratios([Cones.of(b, 0.02) for b in bearings])
    assert low > high
