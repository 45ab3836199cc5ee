"""A dense run is tracked, and graphs weigh what tracking leaves open."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import mht_slam as ms
from mht_slam.simulation import simulate_scene


def dense_scene(missed: float) -> tuple[ms.StraightRun, ms.Association]:
    """Six landmarks, seen over 55 steps of a tenth of a metre."""
    rng = np.random.default_rng(3)
    landmarks = np.array([[2.0, 4.0], [4.0, -3.0], [8.0, 5.0], [1, -2.0], [9.0, -4.0], [5.0, 2.0]])
    scans, labels = [], []
    for k in range(55):
        exact = np.arctan2(landmarks[:, 1], landmarks[:, 0] - 0.1 * k)
        seen = rng.permutation(np.flatnonzero(rng.random(len(landmarks)) >= missed))
        scans.append(ms.BearingScan(exact[seen] + np.deg2rad(0.3) * rng.standard_normal(len(seen))))
        labels.append(seen.tolist())
    return ms.StraightRun(scans), ms.Association.from_labels(labels)


DENSE_MODEL = ms.ObservationModel(
    sigma=math.radians(0.3), motion="smooth", landmark_sigma=60.0, step_change_sigma=0.05
)


@pytest.mark.parametrize("missed", [0.0, 0.05])
def test_a_dense_run_is_tracked_and_the_graph_weighs_what_tracking_left_open(missed: float) -> None:
    run, truth = dense_scene(missed)
    model = DENSE_MODEL
    if missed:
        model = replace(
            model, detection_probability=0.95, false_alarm_rate=0.01, expected_landmarks=6.0
        )
    solution = ms.solve(run, epsilon=math.radians(1.0), model=model)
    assert solution.tracked
    best = solution.posterior[0]
    assert best.failure is None
    assert best.association.f1(truth) > 0.97
    assert sum(h.probability for h in solution.posterior) == pytest.approx(1.0)
    assert best.poses is not None
    assert best.poses[-1] == pytest.approx([54.0, 0.0, 0.0], abs=4.0)


def test_sparse_runs_and_known_identities_are_not_tracked() -> None:
    run, truth = dense_scene(0.0)
    assert not ms.solve(
        simulate_scene("corridor", 4, np.random.default_rng(0), sigma=0.005, n_scans=5).run,
        epsilon=0.05,
        model=DENSE_MODEL,
    ).tracked
    rows = truth.landmark_of_detection()
    labelled = ms.StraightRun(
        ms.BearingScan(scan.bearings, labels=[f"cone {row}" for row in of_scan])
        for scan, of_scan in zip(run.scans, rows, strict=True)
    )
    solution = ms.solve(labelled, epsilon=0.05, model=DENSE_MODEL)
    assert not solution.tracked
    assert solution.posterior[0].association == truth
