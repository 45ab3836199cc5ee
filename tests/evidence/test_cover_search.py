"""The search over covers finds what trying every cover finds, and bounds what it leaves out."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam import Association
from mht_slam.evidence.cover_search import (
    FALSE_ALARM,
    LISTED,
    Cover,
    CoverWeights,
    heaviest_covers,
)

PROBLEMS = st.tuples(
    st.integers(0, 3), st.integers(0, 3), st.integers(0, 3), st.integers(0, 4), st.integers(0, 3)
)


def random_weights(
    counts: tuple[int, int, int], rng: np.random.Generator, *, n_ratios: int = 4
) -> CoverWeights:
    n1, n2, n3 = counts

    def some(*shape: int) -> np.ndarray:
        weights = np.exp(3.0 * rng.standard_normal((*shape, n_ratios)))
        return weights * (rng.random(shape) < 0.8)[..., None]

    return CoverWeights(
        base=some(),
        middle=some(n2, n1 + 1, n3 + 1),
        first=some(n1, n3 + 1),
        last=some(n3),
        false_alarm=(some(n1), some(n2), some(n3)),
    )


def weight_of(association: Association, weights: CoverWeights) -> float:
    total = weights.base.copy()
    for i, m, k in association.table.tolist():
        if m >= 0:
            total *= weights.middle[m, i, k]
        else:
            total *= weights.first[i, k] if i >= 0 else weights.last[k]
    for scan, detection in association.false_alarms:
        total *= weights.false_alarm[scan][detection]
    return float(total.sum())


def as_association(cover: Cover, counts: tuple[int, ...]) -> Association:
    rows = [part for part in cover if FALSE_ALARM not in part]
    return Association(np.array(rows, dtype=int).reshape(-1, 3), counts)


@settings(max_examples=60, deadline=None)
@given(problem=PROBLEMS, seed=st.integers(0, 10_000), top_k=st.integers(1, 12))
def test_the_heaviest_covers_are_those_of_all_covers(
    problem: tuple[int, int, int, int, int],
    seed: int,
    top_k: int,
    associations_within: Callable[..., list[Association]],
) -> None:
    *n, max_missed, max_false = problem
    counts = (n[0], n[1], n[2])
    if max(n) == 3 and max_missed + max_false > 4:
        max_missed, max_false = 2, 2
    weights = random_weights(counts, np.random.default_rng(seed))
    found = heaviest_covers(
        weights, top_k=top_k, max_missed=max_missed, max_false=max_false, work_limit=100_000
    )
    everything = {
        a: w
        for a in associations_within(counts, max_missed, max_false)
        if (w := weight_of(a, weights)) > 0.0
    }
    best = max(everything.values(), default=0.0)
    expected = [w for w in sorted(everything.values(), reverse=True) if w > LISTED * best][:top_k]
    assert found.complete
    listed = {as_association(cover, counts): weight for weight, cover in found.covers}
    for association, weight in listed.items():
        assert weight == pytest.approx(everything[association], rel=1e-9)
    assert sorted(listed.values(), reverse=True)[: len(expected)] == pytest.approx(
        expected, rel=1e-9, abs=1e-15 * best
    )
    left_out = sum(everything.values()) - sum(everything[a] for a in listed)
    assert found.outside >= left_out - 1e-9 * sum(everything.values())


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), work_limit=st.integers(1, 15))
def test_a_search_that_gives_up_still_bounds_what_it_left(
    seed: int, work_limit: int, associations_within: Callable[..., list[Association]]
) -> None:
    counts = (3, 3, 3)
    weights = random_weights(counts, np.random.default_rng(seed))
    found = heaviest_covers(weights, top_k=3, max_missed=1, max_false=1, work_limit=work_limit)
    everything = {a: weight_of(a, weights) for a in associations_within(counts, 1, 1)}
    total = sum(everything.values())
    listed = [as_association(cover, counts) for _, cover in found.covers]
    assert found.n_nodes <= work_limit
    assert found.outside >= total - sum(everything[a] for a in listed) - 1e-9 * total
    if found.complete:
        best = sorted(everything.values(), reverse=True)[: len(listed)]
        assert sorted((everything[a] for a in listed), reverse=True) == pytest.approx(best)


def test_equal_covers_are_all_listed() -> None:
    n = 3
    middle = np.zeros((n, n + 1, n + 1, 2))
    middle[:, :n, :n] = 1.0
    nothing = np.zeros((n, 2))
    weights = CoverWeights(
        np.ones(2), middle, np.zeros((n, n + 1, 2)), nothing, (nothing, nothing, nothing)
    )
    found = heaviest_covers(weights, top_k=5, max_missed=0, max_false=0, work_limit=1000)
    assert len(found.covers) == len(list(itertools.permutations(range(n)))) ** 2
    assert found.complete and found.outside == 0.0
