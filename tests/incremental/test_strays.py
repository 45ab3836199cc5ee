"""Strays: which landmarks of a few detections are given up for others."""

from __future__ import annotations

import numpy as np
import pytest

from mht_slam.arrays import IntArray
from mht_slam.incremental.strays import strays_reread

from .rows import CONFIG, STRAY, Row, renamed


def reread(row: Row) -> list[IntArray] | None:
    return strays_reread(row.smoothed(), row.bearings, row.sigmas, CONFIG)


@pytest.mark.parametrize("landmark", [0, 2, 4])
def test_the_first_sightings_of_a_landmark_under_another_name_are_its_own(landmark: int) -> None:
    row = renamed(Row(None, range(0)), landmark, range(4))
    found = reread(row)
    assert found is not None
    assert all(owner.tolist() == [0, 1, 2, 3, 4] for owner in found)
    assert (row.owners[0] == STRAY).any(), "the owners that were given have changed"


def test_a_stray_may_be_two_landmarks_in_turn() -> None:
    row = renamed(renamed(Row(None, range(0)), 0, range(2)), 3, range(2, 4))
    found = reread(row)
    assert found is not None
    assert all(owner.tolist() == [0, 1, 2, 3, 4] for owner in found)


@pytest.mark.parametrize("place", [(4.0, 9.0), (7.0, -8.0), (3.0, 1.5)])
def test_a_landmark_of_its_own_stays(place: tuple[float, float]) -> None:
    assert reread(Row(np.array(place), range(4))) is None


def test_two_landmarks_that_one_scan_sees_are_two() -> None:
    row = Row(np.array([2.0, 3.0]), range(4))  # where the first one stands
    found = reread(row)
    assert found is None or all(0 in owner[:5] for owner in found)
    assert found is None or not any((owner[5:] == 0).any() for owner in found)


def test_a_stray_is_explained_only_by_a_landmark_seen_far_more_often() -> None:
    assert reread(renamed(Row(None, range(0)), 0, range(5))) is None
