"""When the estimate is lost, and what that opens."""

from __future__ import annotations

import numpy as np
import pytest

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.incremental.monitor import FRESH, OPENING, SCANS, Monitor, opened
from mht_slam.incremental.motion_terms import ODOMETRY, SMOOTH, STILL
from mht_slam.incremental.steps import Step

from .drives import terms


def owners(unexplained: int, of: int = 10, scans: int = SCANS + FRESH) -> tuple[IntArray, ...]:
    one = np.array([-1] * unexplained + list(range(of - unexplained)), np.int64)
    return (one,) * scans


def test_detections_that_nothing_explains_make_it_lost_and_less_of_them_found() -> None:
    monitor = Monitor().after(owners(5))
    assert not monitor.is_lost
    assert monitor.unexplained == pytest.approx(0.5)
    monitor = monitor.after(owners(7))
    assert monitor.is_lost
    assert monitor.after(owners(5)).is_lost, "found again only when it is clearly better"
    assert not monitor.after(owners(3)).is_lost


def test_the_newest_scans_and_few_detections_say_nothing() -> None:
    explained, fresh = owners(0, scans=SCANS), owners(10, scans=FRESH)
    assert not Monitor().after(explained + fresh).is_lost
    for few in ((), owners(10, scans=FRESH), owners(1, of=1, scans=FRESH + 3)):
        assert not Monitor().after(few).is_lost
        assert Monitor(is_lost=True).after(few).is_lost, "what it was before"


@pytest.mark.parametrize("kind", [ODOMETRY, SMOOTH])
def test_an_opened_step_deviates_so_many_times_more(kind: int) -> None:
    parameters: FloatArray = np.array([1.0, 0.1, 0.2, *(np.eye(3) * 5.0).ravel()])
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.3, 0.4, 0.3]])
    _, tight, _ = terms(kind, parameters, poses)
    _, wide, _ = terms(kind, opened(Step(kind, parameters)).parameters, poses)
    np.testing.assert_allclose(wide * OPENING, tight)


def test_a_standstill_stays_one() -> None:
    parameters = np.array([1e-3, 1e-3, *np.zeros(10)])
    np.testing.assert_array_equal(opened(Step(STILL, parameters)).parameters, parameters)
