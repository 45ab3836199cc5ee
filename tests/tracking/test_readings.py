"""Readings that agree by now are one, old decisions are final, and doubts do not pile up."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mht_slam.measurements import BearingScan
from mht_slam.tracking.options import TrackerConfig
from mht_slam.tracking.readings import N_RECENT, Reading, likely, still_right
from mht_slam.tracking.tracker import OrderTracker
from mht_slam.tracking.tracks import Track, begin, carry_on, see

CONFIG = TrackerConfig()


def seen_as(detections: list[int]) -> Track:
    """A track with these detections, one a scan."""
    track = begin(0, 0, detections[0], 1.0, 1e-4, CONFIG)
    for scan, detection in enumerate(detections[1:], start=1):
        track = see(carry_on(track, CONFIG), scan, detection, 1.0, 1e-4)
    return track


def test_readings_that_agree_on_the_last_scans_add_up() -> None:
    late = [0] * N_RECENT
    one, lent = seen_as([0, *late]), seen_as([1, *late])
    other = seen_as([0, *late[:-1], 1])
    group = [
        Reading(math.log(weight), (track,))
        for weight, track in ((0.4, one), (0.35, lent), (0.25, other))
    ]
    kept = likely(group, CONFIG)
    assert [reading.tracks for reading in kept] == [(one,), (other,)]
    assert [math.exp(reading.log_weight) for reading in kept] == pytest.approx([0.75, 0.25])


def test_two_doubtful_exchanges_may_undo_each_other() -> None:
    assert still_right(1.0, 0.3) == pytest.approx(0.7)
    assert still_right(0.7, 0.3) == pytest.approx(0.7 * 0.7 + 0.3 * 0.3)
    assert still_right(0.5, 0.3) == pytest.approx(0.5)


@pytest.mark.parametrize("window", [2, 5])
def test_readings_differ_within_the_window_alone(window: int) -> None:
    """Two landmarks that stay on one bearing may be exchanged at every scan."""
    rng = np.random.default_rng(1)
    tracker = OrderTracker(TrackerConfig(window=window, confirm=1))
    most = 0
    for k in range(25):
        tracker.update(BearingScan([1.0, 1.0, -1.0] + CONFIG.sigma * rng.standard_normal(3)))
        readings = tracker.alternatives(20)
        decided = range(max(0, k - window + 1))
        assert len({reading.restrict(decided) for reading in readings}) == 1
        most = max(most, len(readings))
    assert most > 1
