"""The trivial trackers assign as cheaply as can be, inside their gate, gap and order."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.association import MISSED, Association
from mht_slam.errors import OptionError
from mht_slam.evaluation.baselines import order_changes, order_keeping
from mht_slam.evaluation.trackers import nearest_bearing_tracker, order_keeping_tracker
from mht_slam.measurements import BearingScan, StraightRun

Tracker: TypeAlias = Callable[..., Association]

TRACKERS = [nearest_bearing_tracker, order_keeping_tracker]
BEARINGS = st.lists(st.lists(st.floats(-1.5, 1.5), max_size=4, unique=True), min_size=3, max_size=5)
GATES = st.floats(0.05, 1.0)
GAPS = st.integers(0, 3)


def run_of(bearings: Sequence[Sequence[float]]) -> StraightRun:
    return StraightRun(BearingScan(list(scan)) for scan in bearings)


def steps(association: Association) -> Iterator[tuple[int, int, int, int]]:
    """First scan and detection, next scan and detection, of every track's consecutive sightings."""
    for row in association.table.tolist():
        seen = [(scan, entry) for scan, entry in enumerate(row) if entry != MISSED]
        for first, second in itertools.pairwise(seen):
            yield (*first, *second)


@pytest.mark.parametrize("tracker", TRACKERS)
@given(BEARINGS, GATES, GAPS)
def test_no_step_goes_beyond_the_gate_or_the_gap(
    tracker: Tracker, bearings: list[list[float]], gate: float, max_gap: int
) -> None:
    association = tracker(run_of(bearings), gate, max_gap, with_rate=False)
    assert not association.false_alarms
    for scan, detection, later, other in steps(association):
        assert abs(bearings[scan][detection] - bearings[later][other]) <= gate
        assert later - scan - 1 <= max_gap


def matchings(n: int, m: int) -> Iterator[list[tuple[int, int]]]:
    """All partial matchings of n things with m things."""
    for k in range(min(n, m) + 1):
        for chosen in itertools.combinations(range(n), k):
            for images in itertools.permutations(range(m), k):
                yield list(zip(chosen, images, strict=True))


def saved(
    matching: Sequence[tuple[int, int]], before: list[float], after: list[float], gate: float
) -> float:
    return sum(gate**2 - (before[i] - after[j]) ** 2 for i, j in matching)


@given(BEARINGS, GATES)
def test_nearest_bearing_is_the_cheapest_of_all_matchings(
    bearings: list[list[float]], gate: float
) -> None:
    association = nearest_bearing_tracker(run_of(bearings), gate, 0, with_rate=False)
    for scan, (before, after) in enumerate(itertools.pairwise(bearings)):
        chosen = [(i, j) for k, i, _, j in steps(association) if k == scan]
        best = max(saved(m, before, after, gate) for m in matchings(len(before), len(after)))
        assert saved(chosen, before, after, gate) == pytest.approx(best, abs=1e-9)


@given(BEARINGS, GATES)
def test_order_keeping_is_the_cheapest_of_the_matchings_that_keep_the_order(
    bearings: list[list[float]], gate: float
) -> None:
    association = order_keeping_tracker(run_of(bearings), gate, 0, with_rate=False)
    for scan, (before, after) in enumerate(itertools.pairwise(bearings)):
        chosen = [(i, j) for k, i, _, j in steps(association) if k == scan]
        best = max(
            saved(m, before, after, gate)
            for m in matchings(len(before), len(after))
            if all(
                (before[i] < before[k]) == (after[j] < after[p])
                for (i, j), (k, p) in itertools.combinations(m, 2)
            )
        )
        assert saved(chosen, before, after, gate) == pytest.approx(best, abs=1e-9)


@given(BEARINGS, GATES, GAPS, st.booleans())
def test_order_keeping_never_lets_tracks_exchange_places(
    bearings: list[list[float]], gate: float, max_gap: int, with_rate: bool
) -> None:
    run = run_of(bearings)
    association = order_keeping_tracker(run, gate, max_gap, with_rate=with_rate)
    assert not order_changes(run, association)
    assert not association.false_alarms


FAR_APART = [(5.0, 9.0), (20.0, 9.0), (8.0, -9.0), (-6.0, -9.0)]


@st.composite
def incomplete_scenes(draw: st.DrawFn) -> tuple[StraightRun, Association]:
    """Small steps past landmarks far apart, each of them missed now and then, never twice."""
    missed = [draw(st.integers(-1, 3)) for _ in range(8)]
    labels = []
    for scan, landmark in enumerate(missed):
        seen = [i for i in range(4) if i != landmark or (scan and missed[scan - 1] == landmark)]
        labels.append(draw(st.permutations(seen)))
    scans = [
        BearingScan([math.atan2(FAR_APART[i][1], FAR_APART[i][0] - 0.2 * scan) for i in ids])
        for scan, ids in enumerate(labels)
    ]
    return StraightRun(scans), Association.from_labels(labels)


@pytest.mark.parametrize("tracker", TRACKERS)
@given(incomplete_scenes())
def test_a_missed_landmark_is_found_again(
    tracker: Tracker, scene: tuple[StraightRun, Association]
) -> None:
    run, truth = scene
    assert tracker(run, 0.2, 2) == truth


@pytest.mark.parametrize("tracker", TRACKERS)
def test_a_track_ends_after_the_longest_gap(tracker: Tracker) -> None:
    run = run_of([[0.1], [], [], [0.1]])
    assert tracker(run, 0.2, 2).table.tolist() == [[0, -1, -1, 0]]
    assert tracker(run, 0.2, 1).n_landmarks == 2


def test_the_rate_carries_tracks_through_a_crossing_that_nobody_saw() -> None:
    run = run_of([[0.0, 1.0], [0.4, 0.9], [], [1.2, 0.7]])
    moving, standing = [[0, 0, -1, 0], [1, 1, -1, 1]], [[0, 0, -1, 1], [1, 1, -1, 0]]
    assert nearest_bearing_tracker(run, 0.5, 1).table.tolist() == moving
    assert nearest_bearing_tracker(run, 0.5, 1, with_rate=False).table.tolist() == standing


def test_order_keeping_starts_new_tracks_between_unseen_ones() -> None:
    # 0 and 0.8 are unseen while 0.4 begins, which must stay between them.
    run = run_of([[0.0, 0.8], [0.4], [0.01, 0.41, 0.81]])
    assert order_keeping_tracker(run, 0.1, 1).table.tolist() == [[0, -1, 0], [1, -1, 2], [-1, 0, 1]]


@given(st.integers(0, 2**32), st.integers(3, 6))
def test_without_limits_and_rates_the_least_squares_of_full_scans_keep_the_order(
    seed: int, n_scans: int
) -> None:
    run = run_of(np.random.default_rng(seed).uniform(-1.0, 1.0, (n_scans, 3)))
    for tracker in TRACKERS:
        assert tracker(run, np.pi, 0, with_rate=False) == order_keeping(run)


def test_the_rate_is_the_mean_over_three_detections() -> None:
    run = run_of([[0.0], [0.5], [0.6], [0.7, 0.9]])  # 0.3 a scan, and the last step was 0.1
    assert nearest_bearing_tracker(run, 0.6, 0).table.tolist() == [[0, 0, 0, 1], [-1, -1, -1, 0]]


def test_bearings_just_across_the_cut_are_near() -> None:
    run = run_of([[3.1, 0.0], [0.1, -3.1], [-3.0, 0.2]])
    assert nearest_bearing_tracker(run, 0.3, 0).table.tolist() == [[0, 1, 0], [1, 0, 1]]


@pytest.mark.parametrize("tracker", TRACKERS)
@given(st.integers(0, 2**32), st.lists(st.integers(0, 4), min_size=3, max_size=5))
def test_permuting_detections_permutes_the_table(
    tracker: Tracker, seed: int, counts: list[int]
) -> None:
    rng = np.random.default_rng(seed)
    bearings = [rng.uniform(-1.0, 1.0, count) for count in counts]
    orders = [rng.permutation(count) for count in counts]
    table = tracker(run_of(bearings), 0.3, 1).table
    again = tracker(
        run_of([scan[order] for scan, order in zip(bearings, orders, strict=True)]), 0.3, 1
    )
    back = [
        [int(orders[scan][entry]) if entry != MISSED else MISSED for scan, entry in enumerate(row)]
        for row in again.table.tolist()
    ]
    assert Association(back, counts).table.tolist() == table.tolist()


@pytest.mark.parametrize("tracker", TRACKERS)
def test_runs_without_detections_have_the_empty_association(tracker: Tracker) -> None:
    assert tracker(run_of([[], [], []]), 0.1, 1) == Association([], (0, 0, 0))


@pytest.mark.parametrize("tracker", TRACKERS)
def test_what_makes_no_sense_is_refused(tracker: Tracker) -> None:
    run = run_of([[0.1], [0.1], [0.1]])
    with pytest.raises(OptionError, match="gate"):
        tracker(run, 0.0, 1)
    with pytest.raises(OptionError, match="max_gap"):
        tracker(run, 0.1, -1)
    labelled = StraightRun([*run.scans[:2], BearingScan([0.1], labels=["a"])])
    with pytest.raises(OptionError, match="labels in scan 2"):
        tracker(labelled, 0.1, 1)
