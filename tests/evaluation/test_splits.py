"""The two halves share nothing and lose nothing."""

from hypothesis import given
from hypothesis import strategies as st

from mht_slam.evaluation.splits import halves


@given(st.integers(0, 50))
def test_every_run_is_in_one_half_and_neighbours_are_in_different_ones(n: int) -> None:
    tuning, scored = halves(range(n))
    assert sorted(tuning + scored) == list(range(n))
    assert all(place % 2 == 0 for place in tuning)
    assert all(place % 2 == 1 for place in scored)


def test_items_need_not_be_numbers_nor_a_list() -> None:
    assert halves(iter("abc")) == (["a", "c"], ["b"])
