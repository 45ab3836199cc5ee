"""Owners by scan, their names, and the association that they stand for."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.arrays import IntArray
from mht_slam.incremental.branch import landmark_number
from mht_slam.incremental.history import History, SeenApart, association_of


def ints(*values: int) -> IntArray:
    return np.array(values, np.int64)


@st.composite
def all_owners(draw: st.DrawFn) -> list[IntArray]:
    """Scans of detections of ten landmarks, none twice in a scan."""
    found = []
    for _ in range(draw(st.integers(1, 6))):
        names = draw(st.lists(st.integers(0, 9), max_size=5, unique=True))
        alone = draw(st.integers(0, 2))
        found.append(ints(*draw(st.permutations([*(100 + n for n in names), *[-1] * alone]))))
    return found


@settings(max_examples=60, deadline=None)
@given(all_owners())
def test_rows_and_numbers_agree(owners: list[IntArray]) -> None:
    association, numbers = association_of(owners)
    assert association.n_detections == tuple(len(owner) for owner in owners)
    assert len(numbers) == association.n_landmarks
    for row, number in zip(association.table, numbers.tolist(), strict=True):
        for scan, detection in enumerate(row.tolist()):
            if detection == -1:
                assert number not in owners[scan].tolist()
            else:
                assert owners[scan][detection] == number
    counts = {n: sum(n in owner.tolist() for owner in owners) for n in range(100, 110)}
    assert sorted(numbers.tolist()) == [n for n, count in counts.items() if count > 1]


def test_what_is_renamed_keeps_its_last_name_however_long_the_chain() -> None:
    history = History(owners=[ints(5, 6, -1), ints(7)], renamed={5: 6, 6: 7, 9: 6})
    assert [history.name(n) for n in (5, 6, 7, 8, 9)] == [7, 7, 7, 8, 7]
    now = history.owners_now([ints(9, 8)])
    assert [owner.tolist() for owner in now] == [[7, 7, -1], [7], [7, 8]]
    assert history.owners[0].tolist() == [5, 6, -1], "the log itself stays as it was"


def test_numbers_of_landmarks_never_meet() -> None:
    numbers = {landmark_number(scan, d) for scan in (0, 1, 2, 10**6) for d in (0, 1, 999_999)}
    assert len(numbers) == 12


@settings(max_examples=100, deadline=None)
@given(st.lists(st.sampled_from(["one", "other", "none"]), max_size=12))
def test_seen_apart_counts_up_to_the_last_change_from_one_to_the_other(events: list[str]) -> None:
    """After it, one of them may simply have left."""
    one, other = landmark_number(0, 0), landmark_number(1, 0)
    names = {"one": [one], "other": [other], "none": []}
    history = History(owners=[ints(one), *(ints(7, *names[event]) for event in events)])
    seen = [event for event in events if event != "none"]
    changes = [i for i in range(1, len(seen)) if seen[i] != seen[i - 1]]
    assert SeenApart(history, [])(one, other) == (changes[-1] + 1 if changes else 0)
    history.owners.append(ints(other, one))
    assert SeenApart(history, [])(one, other) is None


def test_seen_apart_knows_todays_names() -> None:
    one, other, former = (landmark_number(scan, 0) for scan in (0, 1, 2))
    history = History(
        owners=[ints(one), ints(other), ints(former), ints(one, former)], renamed={former: other}
    )
    assert SeenApart(history, [])(one, other) is None
