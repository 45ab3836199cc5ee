"""Rank and probability metrics agree with their definitions."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.association import Association
from mht_slam.errors import AssociationError, OptionError
from mht_slam.evaluation.metrics import (
    brier_score,
    log_score,
    mean_reciprocal_rank,
    rank_of_truth,
    top_k_rate,
)

RANKS = st.lists(st.one_of(st.none(), st.integers(1, 9)), min_size=1, max_size=12)


def test_the_truths_rank_counts_from_one_and_looks_at_pairs_only() -> None:
    straight, crossed = Association([[0, 0], [1, 1]], (2, 2)), Association([[0, 1], [1, 0]], (2, 2))
    assert rank_of_truth([crossed, straight], straight) == 2
    assert rank_of_truth([crossed], straight) is None
    assert rank_of_truth([straight], None) is None
    singles = Association([[0, -1], [-1, 0]], (2, 2))
    assert rank_of_truth([straight, Association([], (2, 2))], singles) == 2
    with pytest.raises(AssociationError):
        rank_of_truth([straight], Association([], (2, 3)))


@given(RANKS, st.integers(1, 9))
def test_a_top_k_rate_counts_listed_truths(ranks: list[int | None], k: int) -> None:
    hits = [rank for rank in ranks if rank in range(1, k + 1)]
    assert top_k_rate(ranks, k) == pytest.approx(len(hits) / len(ranks))


@given(RANKS)
def test_the_reciprocal_rank_lies_between_exact_and_listed(ranks: list[int | None]) -> None:
    assert (
        top_k_rate(ranks, 1) - 1e-12 <= mean_reciprocal_rank(ranks) <= top_k_rate(ranks, 9) + 1e-12
    )


def test_the_reciprocal_rank_of_a_known_list() -> None:
    assert mean_reciprocal_rank([1, 4, None, 2]) == pytest.approx((1 + 0.25 + 0 + 0.5) / 4)


@given(st.lists(st.floats(0.01, 1.0), min_size=1, max_size=6), st.data())
def test_brier_sums_squared_distances_to_the_truths_indicator(
    weights: list[float], data: st.DataObject
) -> None:
    p = [w / sum(weights) for w in weights]
    truth = data.draw(st.one_of(st.none(), st.integers(0, len(p) - 1)))
    unlisted = [0.0]
    indicator = [float(truth == i) for i in range(len(p))] + [float(truth is None)]
    expected = sum((a - b) ** 2 for a, b in zip(p + unlisted, indicator, strict=True))
    assert brier_score(p, truth) == pytest.approx(expected)


def test_log_score_of_certainty_half_and_nothing() -> None:
    assert log_score([1.0], 0) == 0.0
    assert log_score([0.5, 0.5], 1) == pytest.approx(math.log(0.5))
    assert log_score([1.0, 0.0], 1) == -math.inf
    assert log_score([1.0], None) == -math.inf


@pytest.mark.parametrize(
    ("probabilities", "truth", "message"),
    [
        ([0.5, 1.5], 0, r"probabilities\[1\] is 1.5"),
        ([0.5, -0.5], 0, r"probabilities\[1\] is -0.5"),
        ([0.5, 0.5], 2, "truth is 2"),
        ([0.5, 0.5], -1, "truth is -1"),
        ([[0.5, 0.5]], 0, "one per candidate"),
    ],
)
def test_what_is_no_probability_is_refused(probabilities: Any, truth: int, message: str) -> None:
    for score in (brier_score, log_score):
        with pytest.raises(OptionError, match=message):
            score(probabilities, truth)


def test_rates_need_scenes_and_ranks_from_one() -> None:
    with pytest.raises(OptionError, match="ranks is empty"):
        top_k_rate([], 1)
    with pytest.raises(OptionError, match=r"ranks\[1\] is 0"):
        mean_reciprocal_rank([1, 0])
    with pytest.raises(OptionError, match="k is 0"):
        top_k_rate([1], 0)
