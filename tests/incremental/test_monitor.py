"""When the estimate is lost, and what that opens."""

from __future__ import annotations

import numpy as np
import pytest

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.incremental.monitor import FRESH, OPENING, SCANS, Monitor, opened
from mht_slam.incremental.motion_terms import ODOMETRY, SMOOTH, STILL
from mht_slam.incremental.steps import Step

from .drives import terms

NOTHING = np.empty(0, np.int64)


def owners(unexplained: int, of: int = 10, scans: int = SCANS + FRESH) -> tuple[IntArray, ...]:
    one = np.array([-1] * unexplained + list(range(of - unexplained)), np.int64)
    return (one,) * scans


def seen(*numbers: int) -> IntArray:
    return np.array(numbers, np.int64)


def test_detections_that_nothing_explains_make_it_lost_and_less_of_them_found() -> None:
    monitor = Monitor().after(owners(5), NOTHING)
    assert not monitor.is_lost
    assert monitor.unexplained == pytest.approx(0.5)
    monitor = monitor.after(owners(7), NOTHING)
    assert monitor.is_lost
    assert monitor.after(owners(5), NOTHING).is_lost, "found again only when it is clearly better"
    assert not monitor.after(owners(3), NOTHING).is_lost


def test_a_mere_pair_explains_nothing_but_where_settled_scans_have_seen_it() -> None:
    pairs = tuple(np.arange(5) + 5 * (k // 2) for k in range(SCANS + FRESH))
    monitor = Monitor().after(pairs, NOTHING)
    assert monitor.is_lost
    assert monitor.unexplained == 1.0
    assert not Monitor().after(pairs, np.arange(5 * len(pairs))).is_lost


def test_the_newest_scans_and_few_detections_say_nothing() -> None:
    explained, fresh = owners(0, scans=SCANS), owners(1, of=3, scans=FRESH)
    assert not Monitor().after(explained + fresh, NOTHING).is_lost
    for few in ((), owners(10, scans=FRESH), owners(1, of=1, scans=FRESH + 3)):
        assert not Monitor().after(few, NOTHING).is_lost
        assert Monitor(is_lost=True).after(few, NOTHING).is_lost, "what it was before"


@pytest.mark.parametrize("again", range(8))
def test_the_estimate_tears_where_few_landmarks_in_sight_are_seen_again(again: int) -> None:
    before = (np.arange(8),) * 4
    beyond = seen(*range(again), *range(20, 28 - again))
    monitor = Monitor().after(before + (beyond,) * (FRESH + 1), NOTHING)
    assert monitor.tears == (again <= 3)
    assert monitor.is_lost == monitor.tears
    # A landmark that comes back at once has not left.
    hidden = before + (seen(30, 31),) * FRESH + (np.arange(8),)
    assert not Monitor().after(hidden, NOTHING).tears


def test_landmarks_that_are_merely_not_read_tear_nothing() -> None:
    before = (np.arange(8),) * 4
    for beyond in (seen(), seen(0, 7), seen(0, 7, 20), seen(20)):
        assert not Monitor().after(before + (beyond,) * (FRESH + 1), NOTHING).tears
    assert Monitor().after(before + (seen(20, 21),) * (FRESH + 1), NOTHING).tears


def test_few_landmarks_or_unsure_ones_tear_nothing() -> None:
    beyond = (seen(20, 21, 22, 23),) * (FRESH + 1)
    few = (np.arange(4),) * 4
    unsure = (np.arange(8),) * 2
    assert not Monitor().after(few + beyond, NOTHING).tears
    assert not Monitor().after(unsure + beyond, NOTHING).tears
    assert Monitor().after(unsure + beyond, np.arange(8)).tears, "settled scans know them"


def test_a_torn_estimate_is_found_by_the_scans_beyond_and_tears_once() -> None:
    past, scans = (np.arange(8),) * 4, [np.arange(20, 28)] * 9
    monitor, states, tears = Monitor(), [], []
    for k in range(len(scans)):
        monitor = monitor.after((*past, *scans[: k + 1]), NOTHING)
        states.append(monitor.is_lost)
        tears.append(monitor.tears)
    assert tears == [k == FRESH for k in range(9)]
    assert states == [k == FRESH for k in range(9)]
    nonsense = [np.full(8, -1)] * 9
    monitor = Monitor()
    for k in range(len(nonsense)):
        monitor = monitor.after((*past, *nonsense[: k + 1]), NOTHING)
        assert monitor.is_lost == (k >= FRESH)


@pytest.mark.parametrize("kind", [ODOMETRY, SMOOTH])
def test_an_opened_step_deviates_so_many_times_more(kind: int) -> None:
    parameters: FloatArray = np.array([1.0, 0.1, 0.2, *(np.eye(3) * 5.0).ravel()])
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.3, 0.4, 0.3]])
    _, tight, _ = terms(kind, parameters, poses)
    for step, factor in (
        (opened(Step(kind, parameters)), OPENING),
        (opened(Step(kind, parameters), 30.0), 30.0),
    ):
        _, wide, _ = terms(kind, step.parameters, poses)
        np.testing.assert_allclose(wide * factor, tight)


def test_a_standstill_stays_one() -> None:
    parameters = np.array([1e-3, 1e-3, *np.zeros(10)])
    np.testing.assert_array_equal(opened(Step(STILL, parameters)).parameters, parameters)
