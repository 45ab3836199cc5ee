"""Evidence of a whole run: a sum that is written out here, and what it prefers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mht_slam.incremental import place_integral
from mht_slam.incremental.place_integral import log_sightings
from mht_slam.incremental.run_evidence import log_run_evidence
from mht_slam.incremental.sightings import Sightings, sightings_of
from mht_slam.incremental.whole_run import WholeRun

from .rows import CONFIG, STRAY, Row, renamed


def evidence_of(row: Row) -> float:
    return log_run_evidence(row.smoothed(), row.bearings, row.sigmas, row.config)


def written_out(row: Row, whole: WholeRun) -> float:
    """Errors of the odometry, and every landmark's place integrated over a fine row of ranges."""
    model = row.config.observation_model
    total = 0.0
    for before, after in zip(whole.poses[:-1], whole.poses[1:], strict=True):
        c, s = np.cos(before[2]), np.sin(before[2])
        x, y = after[:2] - before[:2]
        error = np.array([c * x + s * y - 1.0, c * y - s * x, after[2] - before[2]])
        # The error of a pose is taken in the frame of the step's end, here nearly the same.
        total -= 0.5 * float((error**2 / [1e-4, 1e-4, 1e-5]).sum())
    new = model.expected_landmarks * model.detection_probability  # type: ignore[operator]
    total -= new + 11 * new * (1.0 - model.stay_probability)
    total -= 12 * model.false_alarm_rate * 2.0 * np.pi  # type: ignore[operator]
    sightings = Sightings(whole, row.config)
    for number, places in sightings_of(whole.owners).items():
        scans = [scan for scan, _ in places]
        z = np.array([row.bearings[scan][detection] for scan, detection in places])
        s = np.array([row.sigmas[scan][detection] for scan, detection in places])
        total += sightings.log_weight(number, scans) + log_sightings(
            whole.poses[scans], z, s, model.bearing_dof, model.landmark_sigma, 0.03
        )
    alone = [(k, owner) for k, owners in enumerate(whole.owners) for owner in owners if owner < 0]
    return total + sum(sightings.alone(k) for k, _ in alone)


@pytest.mark.parametrize(("dof", "off"), [(None, 0.1), (4.0, 1.2)])
@pytest.mark.parametrize("seed", range(4))
def test_the_evidence_is_the_sum_over_steps_landmarks_and_detections_alone(
    seed: int, dof: float | None, off: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Laplace's method is off by .02 nats a landmark, .2 where the noise has heavy tails."""
    monkeypatch.setattr(place_integral, "RANGES", 20_000)  # for ranges known to three digits
    config = replace(CONFIG, model=replace(CONFIG.model, bearing_dof=dof))
    row = Row(np.array([4.0, 9.0]), range(3, 6), seed, config)
    row.owners[2][1] = row.owners[8][3] = -1
    assert evidence_of(row) == pytest.approx(written_out(row, row.smoothed()), abs=off)


def test_misreadings_have_less_evidence() -> None:
    right = evidence_of(Row(None, range(0)))
    exchanged = Row(None, range(0))
    exchanged.owners[5][[0, 4]] = exchanged.owners[5][[4, 0]]
    alone = Row(None, range(0))
    alone.owners[5][2] = -1
    in_two = renamed(Row(None, range(0)), 1, range(6))
    for wrong in (exchanged, alone, in_two):
        assert evidence_of(wrong) < right - 1.0


def test_two_landmarks_taken_for_one_have_less_evidence() -> None:
    row = Row(np.array([3.0, 1.5]), range(4))
    apart = evidence_of(row)
    row.owners = [np.where(owner == STRAY, -1, owner) for owner in row.owners]
    assert evidence_of(row) < apart - 1.0


def test_a_landmark_that_one_scan_sees_is_a_detection_alone() -> None:
    row = Row(np.array([4.0, 9.0]), range(3, 4))
    single = evidence_of(row)
    row.owners = [np.where(owner == STRAY, -1, owner) for owner in row.owners]
    assert evidence_of(row) == pytest.approx(single, abs=1e-6)
