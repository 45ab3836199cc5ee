"""Readings of a whole dense run differ where prediction alone cannot tell who is who."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import mht_slam as ms
from mht_slam.errors import OptionError
from mht_slam.tracking.options import TrackerConfig
from mht_slam.tracking.tracker import OrderTracker
from mht_slam.tracking.whole_run import SUREST, _config, tracked_alternatives

SIGMA = math.radians(0.5)
MODEL = ms.ObservationModel(sigma=SIGMA, motion="smooth", landmark_sigma=60.0)
YARD = np.array([[2.0, 4.0], [4.0, -3.0], [8.0, 5.0], [1.0, -2.0], [9.0, -4.0], [5.0, 2.0]])
"""Metres; the path runs along x, a tenth of a metre a scan."""


def dense_run(
    landmarks: np.ndarray, n_scans: int, seed: int, missed: float = 0.0
) -> tuple[ms.StraightRun, ms.Association]:
    rng = np.random.default_rng(seed)
    scans, labels = [], []
    for k in range(n_scans):
        exact = np.arctan2(landmarks[:, 1], landmarks[:, 0] - 0.1 * k)
        seen = rng.permutation(np.flatnonzero(rng.random(len(landmarks)) >= missed))
        noise = SIGMA * rng.standard_normal(len(seen))
        scans.append(ms.BearingScan(exact[seen] + noise))
        labels.append(seen.tolist())
    return ms.StraightRun(scans), ms.Association.from_labels(labels)


@pytest.mark.parametrize("seed", range(3))
def test_the_first_reading_is_the_trackers_own(seed: int) -> None:
    run, _ = dense_run(YARD, 60, seed, missed=0.05)
    tracker = OrderTracker(TrackerConfig(sigma=SIGMA))
    for scan in run.scans:
        tracker.update(scan)
    readings = tracker.alternatives(10)
    assert readings[0] == tracker.association
    assert len(set(readings)) == len(readings) <= 10
    assert tracker.alternatives(1) == readings[:1]


def test_a_meeting_just_now_leaves_both_ways_to_read_it() -> None:
    """Two landmarks, one far behind the other, end up on one bearing."""
    meeting = 4.0
    near, far = np.array([6.0, 2.0]), np.array([8.0, 4.0])
    landmarks = np.array([near, far, [3.0, -4.0], [-2.0, 3.0]])
    run, truth = dense_run(landmarks, round(meeting / 0.1) + 4, 0)
    readings = tracked_alternatives(run, MODEL, 20)
    ends = [set(map(tuple, a.table[:, [0, -1]].tolist())) for a in (truth, *readings)]
    assert ends[0] in ends[1:]  # one reading keeps the identities
    assert any(other != ends[0] for other in ends[1:])  # and another exchanges them
    last = run.scans[-1].bearings[truth.table[:, -1]]
    others = {tuple(row) for row in truth.table[np.abs(last - math.pi / 4.0) > 0.2].tolist()}
    assert len(others) == 2
    assert all(others <= set(map(tuple, reading.table.tolist())) for reading in readings)


def test_a_model_of_misses_is_the_trackers_too() -> None:
    weighs = replace(
        MODEL, detection_probability=0.7, false_alarm_rate=0.2, expected_landmarks=6.0,
        stay_probability=1.0,
    )  # fmt: skip
    config = _config(weighs, 60, 5)
    assert (config.detection_probability, config.false_alarm_rate) == (0.7, 0.2)
    assert config.stay_probability == SUREST
    without = _config(MODEL, 60, 5)
    assert without.detection_probability == TrackerConfig().detection_probability
    assert (without.turn_sigma, without.drift_sigma) == (MODEL.turn_sigma, MODEL.drift_sigma)
    assert (without.window, without.n_alternatives) == (60, 5)


def test_known_identities_are_refused() -> None:
    run = ms.StraightRun([ms.BearingScan([0.1, 1.0], labels=["a", None])] * 3)
    with pytest.raises(OptionError, match="labels"):
        tracked_alternatives(run, MODEL, 3)


def test_no_reading_at_all_is_refused() -> None:
    with pytest.raises(OptionError, match="most"):
        OrderTracker().alternatives(0)


def test_before_the_first_scan_nothing_is_one_reading() -> None:
    assert OrderTracker().alternatives(3) == (ms.Association([], []),)
