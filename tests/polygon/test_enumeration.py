"""Every assignment and every completion, once."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mht_slam.association import MISSED, Association
from mht_slam.errors import OptionError
from mht_slam.polygon import enumeration
from mht_slam.polygon.enumeration import assignments, completions, level_size, subsets


@given(hnp.arrays(np.bool_, st.integers(1, 5).map(lambda n: (n, n))))
def test_assignments_are_the_permitted_permutations(allowed: np.ndarray) -> None:
    n = len(allowed)
    expected = [p for p in permutations(range(n)) if all(allowed[i, d] for i, d in enumerate(p))]
    assert [tuple(row) for row in assignments(allowed).tolist()] == expected


def test_too_many_assignments_are_refused_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(enumeration, "MAX_ASSIGNMENTS", 100)
    with pytest.raises(OptionError, match="max_missed"):
        assignments(np.ones((5, 5), dtype=np.bool_))


def all_partial_associations(counts: tuple[int, ...]) -> set[Association]:
    """Every association of `counts` detections, by giving each detection a label in turn."""
    n = sum(counts)
    found = set()
    for labels in product(range(-1, n), repeat=n):
        flat = [None if label < 0 else label for label in labels]
        split, start = [], 0
        for count in counts:
            split.append(flat[start : start + count])
            start += count
        if any(len({x for x in s if x is not None}) < sum(x is not None for x in s) for s in split):
            continue
        found.add(Association.from_labels(split))
    return found


@pytest.mark.parametrize("counts", [(0, 0, 0), (1, 1, 0), (1, 1, 1), (2, 1, 1), (1, 1, 1, 1)])
@pytest.mark.parametrize(("max_missed", "max_false"), [(0, 1), (2, 0), (2, 1), (8, 4)])
def test_completions_are_all_associations_without_a_fully_seen_landmark(
    counts: tuple[int, ...], max_missed: int, max_false: int
) -> None:
    expected = {
        a
        for a in all_partial_associations(counts)
        if not any((row != MISSED).all() for row in a.table)
        and a.n_missed <= max_missed
        and len(a.false_alarms) <= max_false
    }
    found = [
        Association(np.array(rows).reshape(-1, len(counts)), counts)
        for rows in completions(counts, max_missed, max_false)
    ]
    assert len(found) == len(set(found))
    assert set(found) == expected


def test_left_overs_beyond_the_budgets_are_not_searched() -> None:
    assert completions((12, 12, 12), max_missed=0, max_false=0) == []


def test_level_size_counts_subsets_and_assignments() -> None:
    assert level_size((3, 3, 3), 3, 1) == 36
    assert level_size((4, 3, 3), 3, 2) == 4 * 36 * 2
    assert len(list(subsets((4, 3, 3), 3))) == 4
