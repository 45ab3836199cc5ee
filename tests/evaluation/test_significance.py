"""Intervals cover what they promise and tests agree with their definitions."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.errors import OptionError
from mht_slam.evaluation.significance import mcnemar, paired_bootstrap, wilson_interval

OUTCOMES = st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=10)


@given(st.integers(1, 60).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilsons_bounds_are_the_rates_that_a_score_test_just_accepts(
    counts: tuple[int, int],
) -> None:
    k, n = counts
    rate = wilson_interval(k, n)
    assert 0.0 <= rate.low <= rate.estimate == k / n <= rate.high <= 1.0
    for bound in (rate.low, rate.high):
        if 0.0 < bound < 1.0:
            z = (k / n - bound) / math.sqrt(bound * (1 - bound) / n)
            assert abs(z) == pytest.approx(1.959964, abs=1e-4)


def test_a_lower_level_gives_a_narrower_interval() -> None:
    wide, narrow = wilson_interval(7, 10), wilson_interval(7, 10, level=0.5)
    assert wide.low < narrow.low < narrow.high < wide.high


def test_no_trials_say_nothing() -> None:
    rate = wilson_interval(0, 0)
    assert math.isnan(rate.estimate)
    assert (rate.low, rate.high) == (0.0, 1.0)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [((3, 2), "n_successes"), ((-1, 2), "n_successes"), ((1, 2.0), "n"), ((1, 2, 1.0), "level")],
)
def test_counts_that_are_none_are_refused(arguments: tuple[Any, ...], field: str) -> None:
    with pytest.raises(OptionError, match=field):
        wilson_interval(*arguments)


def mcnemar_by_enumeration(first: list[bool], second: list[bool]) -> float:
    """Chance that fair coins on the discordant scenes split at least as unevenly as seen."""
    discordant = [a for a, b in zip(first, second, strict=True) if a != b]
    n, seen = len(discordant), sum(discordant)
    splits = [sum(coins) for coins in itertools.product([0, 1], repeat=n)]
    return sum(abs(split - n / 2) >= abs(seen - n / 2) for split in splits) / len(splits)


@given(OUTCOMES)
def test_mcnemars_value_is_that_of_fair_coins_on_the_discordant_scenes(
    outcomes: list[tuple[bool, bool]],
) -> None:
    first, second = map(list, zip(*outcomes, strict=True))
    assert mcnemar(first, second) == pytest.approx(mcnemar_by_enumeration(first, second))
    assert mcnemar(first, second) == mcnemar(second, first)


def test_methods_that_never_differ_cannot_be_told_apart() -> None:
    assert mcnemar([True, False, True], [True, False, True]) == 1.0


def test_the_bootstrap_repeats_with_its_generator() -> None:
    first, second = [1, 0, 1, 1, 0], [0, 0, 1, 0, 0]
    runs = [paired_bootstrap(first, second, rng=np.random.default_rng(7)) for _ in range(2)]
    assert runs[0] == runs[1]
    assert runs[0].estimate == pytest.approx(0.4)


def test_the_bootstrap_interval_is_that_of_the_mean_of_differences() -> None:
    rng = np.random.default_rng(1)
    first, second = rng.normal(0.3, 1.0, 400), rng.normal(0.0, 1.0, 400)
    interval = paired_bootstrap(first, second, rng=rng)
    difference = first - second
    half = 1.96 * difference.std() / math.sqrt(len(difference))
    assert interval.low == pytest.approx(difference.mean() - half, abs=0.02)
    assert interval.high == pytest.approx(difference.mean() + half, abs=0.02)


def test_pairing_takes_out_what_scenes_have_in_common() -> None:
    rng = np.random.default_rng(2)
    hardness = rng.normal(0.0, 10.0, 50)
    interval = paired_bootstrap(hardness + 0.1, hardness, rng=rng)
    assert interval.low == pytest.approx(0.1)
    assert interval.high == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        ([1.0], [1.0], "at least 2"),
        ([1.0, 2.0], [1.0], "pair them"),
        ([1.0, np.nan], [1.0, 2.0], r"first\[1\] is nan"),
        ([[1.0, 2.0]], [1.0, 2.0], "one figure per scene"),
    ],
)
def test_scenes_that_do_not_pair_are_refused(first: Any, second: Any, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        paired_bootstrap(first, second, rng=np.random.default_rng(0))


def test_successes_are_true_or_false() -> None:
    with pytest.raises(OptionError, match=r"second\[1\] is 0.5"):
        mcnemar([True, False], [1.0, 0.5])
