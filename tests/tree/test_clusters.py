"""A landmark's evidence at given poses, against its exact integral."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mht_slam import BearingScan, ObservationModel, StraightRun
from mht_slam.evidence.landmark_integral import log_landmark_integral
from mht_slam.graph.problem import make_problem
from mht_slam.tree.clusters import cluster_log_weights
from mht_slam.tree.setting import Setting

POSES = np.array([[0.0, 0.0, 0.02], [1.0, 0.0, -0.01], [2.1, 0.1, 0.0], [3.0, -0.1, 0.05]])
MODEL = ObservationModel(
    sigma=math.radians(0.5),
    motion="smooth",
    detection_probability=0.8,
    false_alarm_rate=0.1,
    expected_landmarks=5.0,
    landmark_sigma=20.0,
)


@pytest.mark.parametrize("place", [(3.0, 2.0), (-1.0, 4.0), (1.5, -2.5), (8.0, 6.0)])
@pytest.mark.parametrize("row", [(0, 0, 0, 0), (0, -1, 0, -1), (-1, 0, 0, 0)])
def test_a_cluster_with_parallax_weighs_what_its_exact_integral_says(
    place: tuple[float, float], row: tuple[int, ...]
) -> None:
    rng = np.random.default_rng(4)
    exact = np.arctan2(place[1] - POSES[:, 1], place[0] - POSES[:, 0]) - POSES[:, 2]
    bearings = exact + MODEL.sigma * rng.standard_normal(4)
    run = StraightRun(BearingScan([b]) for b in bearings)
    setting = Setting(make_problem(run, (0, 1, 2, 3), MODEL))
    rows = np.array([row])
    seen = [k for k, d in enumerate(row) if d >= 0]
    start = np.array([place]) * 1.3
    integral = log_landmark_integral(
        POSES[None, seen],
        bearings[seen],
        np.full(len(seen), MODEL.sigma),
        MODEL.landmark_centre,
        MODEL.landmark_sigma,
    )[0]
    pattern = math.log(5.0) + len(seen) * math.log(0.8) + (4 - len(seen)) * math.log(0.2)
    found = cluster_log_weights(setting, POSES, rows, start)[0]
    assert found == pytest.approx(integral + pattern, abs=0.05)
