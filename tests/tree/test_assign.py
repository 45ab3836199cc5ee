"""Over all proposals, matchings come where they do best, and none within the limit is missing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from mht_slam.matchings import ranked_matchings
from mht_slam.tree.assign import best_matchings

DROP = 4.05
EIGHTHS = st.integers(-40, 40).map(lambda i: i / 8.0)


@given(
    npst.arrays(np.float64, (3, 3, 3), elements=EIGHTHS),
    npst.arrays(np.float64, 3, elements=EIGHTHS),
)
def test_the_best_over_all_proposals_is_the_best_of_any(
    gains: np.ndarray, offsets: np.ndarray
) -> None:
    expected: dict[tuple[tuple[int, int], ...], float] = {}
    for own, offset in zip(gains, offsets, strict=True):
        for matches, gain in ranked_matchings(np.maximum(own, 0.0)):
            expected[matches] = max(expected.get(matches, -np.inf), offset + gain)
    top = max(expected.values())
    within = {matches: gain for matches, gain in expected.items() if gain >= top - DROP}
    found = best_matchings(gains, offsets, drop=DROP, n_ranked=3, depth=1000)
    assert {c.matches for c in found} == set(within)
    assert found[0].log_gain == pytest.approx(top)
    for candidate in found:
        assert candidate.log_gain == pytest.approx(within[candidate.matches])
