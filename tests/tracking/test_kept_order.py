"""Alignment in the cyclic order is the best of all that keep it."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from mht_slam.tracking.kept_order import _aligned

GAINS = npst.arrays(
    np.float64,
    st.tuples(st.integers(0, 4), st.integers(0, 4)),
    elements=st.sampled_from([0.0, 0.5, 1.0, 2.5, 7.25]),
)


def cyclic_alignments(n: int, m: int) -> list[list[tuple[int, int]]]:
    """All pairings of rows with columns in the same cyclic order."""
    found = []
    for k in range(min(n, m) + 1):
        for rows in combinations(range(n), k):
            for columns in combinations(range(m), k):
                found += [
                    list(zip(rows, columns[turn:] + columns[:turn], strict=True))
                    for turn in range(max(k, 1))
                ]
    return found


@given(GAINS)
def test_no_pairing_in_the_same_cyclic_order_gains_more(gains: np.ndarray) -> None:
    pairs = _aligned(gains)
    every = cyclic_alignments(*gains.shape)
    assert sorted(pairs) in [sorted(alignment) for alignment in every]
    best = max(sum(float(gains[p]) for p in alignment) for alignment in every)
    assert sum(float(gains[p]) for p in pairs) == best
