"""The trivial baselines do what their names say, and bow to known identities."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.association import Association, respects_labels
from mht_slam.errors import AssociationError, UnequalScansError
from mht_slam.evaluation.baselines import nearest_bearing, order_changes, order_keeping
from mht_slam.measurements import BearingScan, StraightRun

Landmarks: TypeAlias = list[tuple[float, float]]
Baseline: TypeAlias = Callable[[StraightRun], Association]


def run_past(
    landmarks: Landmarks, positions: tuple[float, ...], shuffles: list[list[int]]
) -> tuple[StraightRun, Association]:
    """Drive along the x axis past the landmarks; scan k lists them in the order shuffles[k]."""
    scans = [
        BearingScan([math.atan2(landmarks[i][1], landmarks[i][0] - x) for i in order])
        for x, order in zip(positions, shuffles, strict=True)
    ]
    return StraightRun(scans), Association.from_labels(shuffles)


@st.composite
def orders(draw: st.DrawFn, n: int = 4) -> list[list[int]]:
    return [draw(st.permutations(range(n))) for _ in range(3)]


FAR_APART: Landmarks = [(5.0, 9.0), (20.0, 9.0), (8.0, -9.0), (-6.0, -9.0)]
"""No line through two of them on one side meets the path between 0 and 2."""


@given(orders())
def test_order_keeping_finds_the_truth_where_the_order_is_kept(shuffles: list[list[int]]) -> None:
    run, truth = run_past(FAR_APART, (0.0, 1.0, 2.0), shuffles)
    assert order_keeping(run) == truth
    assert not order_changes(run, truth)


CROSSING: Landmarks = [(1.0, 10.0), (1.01, 20.0), (8.0, -9.0), (-6.0, -9.0)]
"""Seen from x = 0 and x = 2, the near one of the first two is on opposite sides of the far one."""


@given(orders())
def test_order_keeping_is_wrong_exactly_where_the_order_changes(shuffles: list[list[int]]) -> None:
    run, truth = run_past(CROSSING, (0.0, 0.5, 2.0), shuffles)
    assert order_changes(run, truth)
    assert not order_keeping(run).exact(truth)
    assert not order_changes(run, order_keeping(run))


@given(orders())
def test_left_and_right_never_exchange_at_the_cut(shuffles: list[list[int]]) -> None:
    astern: Landmarks = [(-50.0, 0.5), (-40.0, -0.5), (3.0, 2.0), (9.0, -3.0)]
    run, truth = run_past(astern, (0.0, 1.0, 2.0), shuffles)
    assert order_keeping(run) == truth


def test_an_exchange_is_seen_even_across_a_scan_that_misses_both() -> None:
    run = StraightRun([BearingScan([0.1, 0.2]), BearingScan([0.5]), BearingScan([0.4, 0.3])])
    crossed = Association([[0, -1, 0], [1, -1, 1], [-1, 0, -1]], (2, 1, 2))
    kept = Association([[0, -1, 1], [1, -1, 0], [-1, 0, -1]], (2, 1, 2))
    assert order_changes(run, crossed)
    assert not order_changes(run, kept)


def test_a_truth_of_other_detections_is_refused() -> None:
    run, _ = run_past(FAR_APART, (0.0, 1.0, 2.0), [[0, 1]] * 3)
    with pytest.raises(AssociationError, match="these scans"):
        order_changes(run, Association([], (2, 2, 3)))


SCANS = st.lists(
    st.lists(st.floats(-3.1, 3.1), min_size=3, max_size=3, unique=True), min_size=3, max_size=3
)


def total_turn(before: list[float], after: list[float]) -> float:
    return float(np.abs(np.angle(np.exp(1j * np.subtract(before, after)))).sum())


@given(SCANS)
def test_nearest_bearing_is_the_cheapest_match_of_every_two_scans(
    bearings: list[list[float]],
) -> None:
    table = nearest_bearing(StraightRun(map(BearingScan, bearings)), with_rate=False).table
    for first, second in ((0, 1), (1, 2)):
        before = [bearings[first][i] for i in table[:, first]]
        chosen = [bearings[second][i] for i in table[:, second]]
        turns = [total_turn(before, list(after)) for after in itertools.permutations(chosen)]
        assert total_turn(before, chosen) == pytest.approx(min(turns), abs=1e-9)


def test_the_rate_carries_a_track_through_a_crossing() -> None:
    scans = [BearingScan([0.0, 1.0]), BearingScan([0.4, 0.9]), BearingScan([0.8, 0.81])]
    run = StraightRun([*scans, BearingScan([1.2, 0.7])])
    moving = [[0, 0, 0, 0], [1, 1, 1, 1]]
    assert nearest_bearing(run).table.tolist() == moving
    assert nearest_bearing(run, with_rate=False).table.tolist() != moving


def test_bearings_just_across_the_cut_are_near() -> None:
    run = StraightRun([BearingScan([3.1, 0.0]), BearingScan([0.1, -3.1]), BearingScan([-3.0, 0.2])])
    assert nearest_bearing(run).table.tolist() == [[0, 1, 0], [1, 0, 1]]


@pytest.mark.parametrize("baseline", [order_keeping, nearest_bearing])
def test_scans_of_different_length_are_refused(baseline: Baseline) -> None:
    run = StraightRun([BearingScan([0.1, 0.2]), BearingScan([0.1]), BearingScan([0.1, 0.2])])
    with pytest.raises(UnequalScansError, match=r"\(2, 1, 2\)"):
        baseline(run)


@pytest.mark.parametrize("baseline", [order_keeping, nearest_bearing])
def test_labels_that_name_too_many_landmarks_are_refused(baseline: Baseline) -> None:
    run = StraightRun([BearingScan([0.1], labels=[name]) for name in "aab"])
    with pytest.raises(AssociationError, match="up to scan 2 name more landmarks"):
        baseline(run)


@pytest.mark.parametrize("baseline", [order_keeping, nearest_bearing])
def test_runs_without_detections_have_the_empty_association(baseline: Baseline) -> None:
    assert baseline(StraightRun([BearingScan([])] * 3)) == Association([], (0, 0, 0))


@pytest.mark.parametrize("baseline", [order_keeping, nearest_bearing])
@given(SCANS, orders(3), st.lists(st.booleans(), min_size=9, max_size=9))
def test_known_identities_bind_even_across_scans_that_hide_them(
    baseline: Baseline, bearings: list[list[float]], identities: list[list[int]], shown: list[bool]
) -> None:
    show = iter(shown)
    scans = [
        BearingScan(scan, labels=[str(i) if next(show) else None for i in names])
        for scan, names in zip(bearings, identities, strict=True)
    ]
    association = baseline(StraightRun(scans))
    assert association.is_full
    assert respects_labels(association, scans)


@given(SCANS, orders(3))
def test_permuting_detections_permutes_the_table(
    bearings: list[list[float]], shuffles: list[list[int]]
) -> None:
    shuffled = [[scan[i] for i in order] for scan, order in zip(bearings, shuffles, strict=True)]
    table = order_keeping(StraightRun(map(BearingScan, bearings))).table
    again = order_keeping(StraightRun(map(BearingScan, shuffled))).table
    back = [[shuffles[k][i] for k, i in enumerate(row)] for row in again.tolist()]
    assert sorted(back) == table.tolist()
