"""Pairs add up over runs, and only close landmarks may be exchanged."""

from __future__ import annotations

import itertools
from typing import TypeAlias

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.association import MISSED, Association
from mht_slam.errors import AssociationError, OptionError
from mht_slam.evaluation.agreement import (
    PairCounts,
    exact_up_to_exchanges,
    pair_counts,
    pooled,
    pooled_f1_difference,
    pooled_f1_interval,
)
from mht_slam.measurements import BearingScan, StraightRun

WITHIN = 0.1
History: TypeAlias = tuple[tuple[int, ...], tuple[tuple[int, ...], ...]]
LABELS = st.lists(st.lists(st.integers(-1, 3), min_size=3, max_size=3), min_size=3, max_size=3)


def association(labels: list[list[int]]) -> Association:
    """Repeated labels of a scan, and -1, are false alarms."""
    return Association.from_labels(
        [[None if i == -1 or i in scan[:k] else i for k, i in enumerate(scan)] for scan in labels]
    )


def pairs(labels: list[list[int]]) -> set[frozenset[tuple[int, int]]]:
    table = association(labels).table.tolist()
    return {
        frozenset(pair)
        for row in table
        for pair in itertools.combinations(
            [(scan, entry) for scan, entry in enumerate(row) if entry != MISSED], 2
        )
    }


@given(LABELS, LABELS)
def test_pairs_are_counted_as_sets(answer: list[list[int]], truth: list[list[int]]) -> None:
    counts = pair_counts(association(answer), association(truth))
    mine, theirs = pairs(answer), pairs(truth)
    assert counts == (len(mine & theirs), len(mine), len(theirs))
    assert counts.f1 == pytest.approx(association(answer).f1(association(truth)))


@given(LABELS, LABELS)
def test_pairs_of_two_false_alarms_may_be_left_out(
    answer: list[list[int]], truth: list[list[int]]
) -> None:
    false = set(association(truth).false_alarms)
    left = {pair for pair in pairs(answer) if not pair <= false}
    counts = pair_counts(association(answer), association(truth), count_false=False)
    assert counts == (len(left & pairs(truth)), len(left), len(pairs(truth)))


def test_pooling_weighs_pairs_and_not_runs() -> None:
    counts = pooled([PairCounts(1, 1, 1), PairCounts(0, 5, 3)])
    assert counts == (1, 6, 4)
    assert counts.f1 == pytest.approx(0.2)
    assert pooled([]).f1 == 1.0


def test_the_interval_of_a_pooled_f1_is_that_of_runs_drawn_again() -> None:
    counts = [PairCounts(8, 10, 10), PairCounts(1, 2, 3), PairCounts(5, 5, 9)]
    drawn = sorted(
        pooled(draw).f1 for draw in itertools.product(counts, repeat=3)
    )  # all 27 draws are alike probable
    interval = pooled_f1_interval(counts, rng=np.random.default_rng(1), level=0.9)
    assert interval.estimate == pooled(counts).f1
    np.testing.assert_allclose(interval[1:], np.quantile(drawn, [0.05, 0.95]), atol=0.02)


def test_the_difference_of_pooled_f1_pairs_the_runs() -> None:
    good = [PairCounts(9, 10, 10), PairCounts(1, 10, 10), PairCounts(5, 10, 10)]
    worse = [PairCounts(count.common - 1, 10, 10) for count in good]
    difference = pooled_f1_difference(good, worse, rng=np.random.default_rng(0))
    np.testing.assert_allclose(difference, [0.1, 0.1, 0.1])  # though F1 itself varies widely
    with pytest.raises(OptionError, match="same runs"):
        pooled_f1_difference(good, worse[:2], rng=np.random.default_rng(0))
    with pytest.raises(OptionError, match="one at least"):
        pooled_f1_interval([], rng=np.random.default_rng(0))


def exchanged_truths(labels: list[list[int]], bearings: list[list[float]]) -> set[Association]:
    """Every truth that exchanges give, written out: close pairs swap before or after a scan."""
    histories = {((0, 1, 2), ())}  # the track that each landmark now continues, labels so far
    for ids, angles in zip(labels, bearings, strict=True):
        close = [
            (a, b)
            for (a, x), (b, y) in itertools.combinations(zip(ids, angles, strict=True), 2)
            if abs(x - y) < WITHIN and MISSED not in (a, b)
        ]
        begun = swapped(histories, close)
        told = {
            (track, (*past, tuple(MISSED if i == MISSED else track[i] for i in ids)))
            for track, past in begun
        }
        histories = swapped(told, close)
    return {association([list(scan) for scan in past]) for _, past in histories}


def swapped(histories: set[History], close: list[tuple[int, int]]) -> set[History]:
    reached = set(histories)
    for _ in range(3):  # two swaps give every order of three landmarks
        for (track, past), (a, b) in list(itertools.product(reached, close)):
            now = list(track)
            now[a], now[b] = track[b], track[a]
            reached.add((tuple(now), past))
    return reached


@st.composite
def close_scenes(draw: st.DrawFn) -> tuple[list[list[int]], list[list[float]]]:
    """Three or four scans of up to three landmarks and a false alarm, some of them close."""
    n_scans = draw(st.integers(3, 4))
    labels, bearings = [], []
    for _ in range(n_scans):
        ids = draw(st.permutations(draw(st.sampled_from([[0, 1, 2], [0, 1], [1, 2], [0, 1, -1]]))))
        labels.append(list(ids))
        places = draw(st.permutations([0.0, 0.05, 0.2, 0.26]))
        bearings.append([places[i] for i in range(len(ids))])
    return labels, bearings


@settings(max_examples=150)
@given(close_scenes(), st.data())
def test_forgiven_is_what_some_exchange_of_close_landmarks_explains(
    scene: tuple[list[list[int]], list[list[float]]], data: st.DataObject
) -> None:
    labels, bearings = scene
    run = StraightRun(map(BearingScan, bearings))
    truth = association(labels)
    forgiven = exchanged_truths(labels, bearings)
    assert truth in forgiven
    for answer in forgiven:
        assert exact_up_to_exchanges(answer, truth, run, WITHIN)
    other = association([list(data.draw(st.permutations(scan))) for scan in labels])
    expected = any(other.exact(candidate) for candidate in forgiven)
    assert exact_up_to_exchanges(other, truth, run, WITHIN) == expected


@given(close_scenes(), st.data())
def test_nothing_but_exactness_is_forgiven_where_nothing_is_close(
    scene: tuple[list[list[int]], list[list[float]]], data: st.DataObject
) -> None:
    labels, bearings = scene
    other = association([list(data.draw(st.permutations(scan))) for scan in labels])
    truth = association(labels)
    forgiven = exact_up_to_exchanges(other, truth, StraightRun(map(BearingScan, bearings)), 0.0)
    assert forgiven == other.exact(truth)


CROSSING = StraightRun([BearingScan([0.0, 1.0]), BearingScan([0.5, 0.52]), BearingScan([1.0, 0.0])])
KEPT = Association([[0, 0, 0], [1, 1, 1]], (2, 2, 2))


@pytest.mark.parametrize(
    ("table", "forgiven"),
    [
        ([[0, 1, 1], [1, 0, 0]], True),  # from the close scan on
        ([[0, 0, 1], [1, 1, 0]], True),  # after it
        ([[0, 1, 0], [1, 0, 1]], True),  # with it and back
        ([[0, 0, 0], [1, 1, -1], [-1, -1, 1]], False),  # a lost track is no exchange
        ([[0, 0, 0], [1, 1, -1]], False),
    ],
)
def test_two_close_landmarks_may_be_exchanged_with_or_after_a_scan(
    table: list[list[int]], forgiven: bool
) -> None:
    answer = Association(table, (2, 2, 2))
    assert exact_up_to_exchanges(answer, KEPT, CROSSING, WITHIN) == forgiven
    assert not exact_up_to_exchanges(answer, KEPT, CROSSING, 0.01)


def test_an_exchange_reaches_beyond_scans_that_miss_one_of_the_two() -> None:
    run = StraightRun([*CROSSING.scans[:2], BearingScan([0.8]), CROSSING.scans[2]])
    truth = Association([[0, 0, 0, 0], [1, 1, -1, 1]], (2, 2, 1, 2))
    exchanged = Association([[0, 0, -1, 1], [1, 1, 0, 0]], (2, 2, 1, 2))
    back = Association([[0, 0, -1, 0], [1, 1, 0, 1]], (2, 2, 1, 2))
    assert exact_up_to_exchanges(exchanged, truth, run, WITHIN)
    assert not exact_up_to_exchanges(back, truth, run, WITHIN)


def test_close_across_the_cut_is_close() -> None:
    run = StraightRun([BearingScan([3.12, -3.12]), BearingScan([2.0, -2.0]), BearingScan([1, -1])])
    exchanged = Association([[0, 1, 1], [1, 0, 0]], (2, 2, 2))
    assert exact_up_to_exchanges(exchanged, KEPT, run, WITHIN)


def test_associations_of_other_scans_are_refused() -> None:
    other = Association([[0, 0, 0]], (1, 1, 1))
    with pytest.raises(AssociationError, match="this run"):
        exact_up_to_exchanges(other, KEPT, CROSSING, WITHIN)
    with pytest.raises(AssociationError):
        pair_counts(other, KEPT)
