"""Ranked matchings come best first, none missing or twice; ordered ones are the best."""

from __future__ import annotations

from itertools import combinations, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from mht_slam.matchings import best_in_order, ranked_matchings

GAINS = npst.arrays(
    np.float64,
    st.tuples(st.integers(0, 4), st.integers(0, 3)),
    elements=st.sampled_from([0.0, 0.5, 1.0, 2.5, 7.25]),
)


def every_matching(gains: np.ndarray) -> dict[tuple[tuple[int, int], ...], float]:
    """All sets of pairs of positive gain that share neither row nor column."""
    rows, columns = gains.shape
    result = {}
    for size in range(min(rows, columns) + 1):
        for chosen in combinations(range(rows), size):
            for order in permutations(range(columns), size):
                pairs = tuple(zip(chosen, order, strict=True))
                if all(gains[pair] > 0.0 for pair in pairs):
                    result[pairs] = float(sum(gains[pair] for pair in pairs))
    return result


@given(GAINS)
def test_ranked_matchings_are_all_matchings_best_first(gains: np.ndarray) -> None:
    expected = every_matching(gains)
    found = list(ranked_matchings(gains))
    assert len(found) == len(expected)
    assert {matches: pytest.approx(gain) for matches, gain in found} == expected
    ordered = [gain for _, gain in found]
    assert ordered == sorted(ordered, reverse=True)


def matchings_in_order(n: int, m: int, *, cyclic: bool) -> list[list[tuple[int, int]]]:
    """All matchings whose columns follow each other as their rows do."""
    found = []
    for k in range(min(n, m) + 1):
        for rows in combinations(range(n), k):
            for columns in combinations(range(m), k):
                found += [
                    list(zip(rows, columns[turn:] + columns[:turn], strict=True))
                    for turn in range(max(k, 1) if cyclic else 1)
                ]
    return found


@pytest.mark.parametrize("cyclic", [False, True])
@given(GAINS)
def test_no_matching_in_the_same_order_gains_more(cyclic: bool, gains: np.ndarray) -> None:
    pairs = best_in_order(gains, cyclic=cyclic)
    every = matchings_in_order(*gains.shape, cyclic=cyclic)
    assert sorted(pairs) in [sorted(matching) for matching in every]
    best = max(sum(float(gains[p]) for p in matching) for matching in every)
    assert sum(float(gains[p]) for p in pairs) == best
