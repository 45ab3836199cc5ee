"""Maps are compared landmark by landmark, by where they are and by what was seen of them."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.association import Association
from mht_slam.evaluation.landmark_maps import (
    CUTOFF,
    gospa,
    matched_by_detections,
    matched_by_position,
)


def test_gospa_is_zero_on_the_truth_and_half_a_cutoff_for_each_landmark_left_over() -> None:
    true = np.array([[0.0, 1.0], [5.0, 5.0], [-3.0, 2.0]])
    assert gospa(true[::-1], true) == 0.0
    assert gospa(true[:2], true) == 0.5 * CUTOFF
    assert gospa(np.empty((0, 2)), true) == 1.5 * CUTOFF
    assert gospa(true + np.array([0.0, 0.25]), true) == pytest.approx(0.75)
    assert gospa(true + np.array([100.0, 0.0]), true) == pytest.approx(3 * CUTOFF)


@given(st.integers(0, 4), st.integers(0, 4), st.integers(0, 99))
def test_gospa_is_the_best_of_all_matchings(k: int, n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    ours, theirs = rng.uniform(0, 3, (k, 2)), rng.uniform(0, 3, (n, 2))
    few, many = (ours, theirs) if k <= n else (theirs, ours)
    sums = [
        sum(min(float(np.hypot(*(a - many[j]))), 1.0) for a, j in zip(few, order, strict=True))
        for order in permutations(range(len(many)), len(few))
    ]
    assert gospa(ours, theirs, 1.0) == pytest.approx(min(sums) + 0.5 * abs(k - n))


def test_landmarks_nearer_than_the_cutoff_are_partners_once() -> None:
    true = np.array([[0.0, 0.0], [10.0, 0.0]])
    assert matched_by_position([[0.1, 0.0], [0.2, 0.0], [9.0, 0.0]], true, 0.5) == (1, 3, 2)
    assert matched_by_position([[0.1, 0.0], [9.8, 0.0]], true, 0.5).one_to_one
    assert matched_by_position([], true, 0.5) == (0, 0, 2)


def test_a_landmark_split_in_two_has_one_partner_at_most() -> None:
    truth = Association([[0] * 6, [1] * 6, [2, -1, -1, -1, -1, -1]], [3, 2, 2, 2, 2, 2])
    assert matched_by_detections(truth, truth, shortest=2) == (2, 2, 2)
    split = Association([[0, 0, 0, 0, -1, -1], [-1, -1, -1, -1, 0, 0], [1] * 6], truth.n_detections)
    assert matched_by_detections(split, truth, shortest=2) == (2, 3, 2)
    halves = Association([[0, 0, 0, 1, 1, 1], [1, 1, 1, 0, 0, 0]], truth.n_detections)
    assert matched_by_detections(halves, truth, shortest=2) == (0, 2, 2)


def test_short_landmarks_are_not_asked_for_and_no_mistake_where_found() -> None:
    truth = Association([[0, 0, 0, 0], [1, 1, -1, -1]], [2, 2, 1, 1])
    only_long = Association([[0, 0, 0, 0]], truth.n_detections)
    assert matched_by_detections(only_long, truth, shortest=3).one_to_one
    longer = Association([[1, 1, -1, 0], [0, 0, 0, -1]], truth.n_detections)
    assert matched_by_detections(longer, truth, shortest=3) == (2, 2, 2)
