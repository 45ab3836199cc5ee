"""The study of live probabilities names landmarks by what the estimator has given them so far."""

from __future__ import annotations

import math
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from mht_slam.datasets import Drive
from mht_slam.evaluation.calibration import top_forecast
from mht_slam.measurements import BearingScan
from mht_slam.simulation import OdometryNoise, simulate_drive

STUDY = Path(__file__).parents[2] / "benchmarks" / "recordings"
SIGMA = math.radians(0.5)


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(STUDY))
    return import_module("live_calibration")


def _loop() -> Drive:
    rng = np.random.default_rng(4)
    return simulate_drive("loop", 6, 16, rng, sigma=SIGMA, odometry=OdometryNoise(), rounds=1.0)


def test_a_landmark_is_who_most_of_its_detections_are(study: ModuleType) -> None:
    who = tuple(np.array(ids) for ids in ([-1, 4], [3, 4], [3, 5], [3, 5]))
    scans = tuple(BearingScan([-0.5, 0.5]) for _ in who)
    drive = replace(_loop(), scans=scans, identities=who, reference_poses=np.zeros((4, 3)))
    owners = [np.array(owner) for owner in ([10, 11], [10, 11], [10, 11], [10, 11])]
    assert study.majorities(drive, owners[:1]) == {10: -1, 11: 4}
    assert study.majorities(drive, owners) == {10: 3, 11: 4}


def test_what_is_right_is_summed_and_none_is_right_for_what_is_new(study: ModuleType) -> None:
    owners, who = {7: 0.5, 8: 0.2, 9: 0.1, -1: 0.1}, {7: 3, 8: 3, 9: 4, -1: -1}
    known = study._forecast(3, True, owners, who)
    assert known.truth == 0
    np.testing.assert_allclose(sorted(known.probabilities), [0.1, 0.1, 0.7])
    assert known.rest == pytest.approx(0.1)
    for truth, met in ((-1, True), (5, False)):
        new = study._forecast(truth, met, owners, who)
        np.testing.assert_allclose(new.probabilities[new.truth], 0.1)
    assert study._forecast(5, True, owners, who).truth is None


def test_every_detection_after_the_first_scan_is_one_forecast(
    study: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = _loop()
    monkeypatch.setattr(study, "drives_of", lambda _: (drive,))
    first, later = study.forecasts_of(("loop", 0))
    counts = [len(scan) for scan in drive.scans]
    for found, expected in ((first, sum(counts[1:10])), (later, sum(counts[10:]))):
        assert len(found.stated) == len(found.undoubted) == len(found.by_first) == expected
    doubted, sure = top_forecast(later.stated), top_forecast(later.undoubted)
    assert doubted.accuracy > 0.8
    assert doubted.mean_probability < sure.mean_probability
