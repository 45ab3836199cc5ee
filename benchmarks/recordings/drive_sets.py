"""The drives that estimators are compared on: recordings and simulations, and what is assumed."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from itertools import product

import numpy as np

from mht_slam.datasets import (
    Drive,
    car_park_drive,
    dlr_drive,
    mrclam_drive,
    victoria_park_drive,
    victoria_park_windows,
    windows,
)
from mht_slam.evaluation.splits import halves
from mht_slam.models import ObservationModel
from mht_slam.simulation import OdometryNoise, simulate_drive
from mht_slam.simulation.drives import SMOOTH, STEP_CHANGE_SIGMA, STEP_SIGMA, DriveKind

WINDOW = 100
"""Scans of a window of the DLR recording."""
SIMULATED_SIGMA = math.radians(0.5)
SIMULATED = tuple((n, m) for n in (10, 20, 40) for m in (30, 100))
"""Landmarks and scans of the simulated drives."""
N_SEEDS = 20

HALVES = ("tuning", "scored")


def simulated(kind: DriveKind) -> list[Drive]:
    """Return `N_SEEDS` drives of every size: even seeds, at even places, are for tuning."""
    noise = OdometryNoise() if kind == "loop" else None
    drives = []
    for pair in range(0, N_SEEDS, 2):
        for (n, m), seed in product(SIMULATED, (pair, pair + 1)):
            rng = np.random.default_rng([seed, n, m])
            drive = simulate_drive(kind, n, m, rng, sigma=SIMULATED_SIGMA, odometry=noise)
            drives.append(replace(drive, name=f"{kind} n={n} m={m} seed {seed}"))
    return drives


READERS: dict[str, Callable[[], list[Drive]]] = {
    "dlr-windows": lambda: windows(dlr_drive(), WINDOW),
    "dlr": lambda: [dlr_drive()],
    "victoria-park-windows": victoria_park_windows,
    "victoria-park": lambda: [victoria_park_drive()],
    "car-park": lambda: [car_park_drive()],
    "mrclam": lambda: [mrclam_drive(robot) for robot in range(1, 6)],
    "straight": lambda: simulated("straight"),
    "smooth": lambda: simulated("smooth"),
    "loop": lambda: simulated("loop"),
}
"""The sets, and how their drives are read."""

TUNED_ON = {
    "dlr": "dlr-windows",
    "victoria-park": "victoria-park-windows",
    "car-park": "victoria-park-windows",
}
"""The set whose tuning half chooses the options of a set that is a single drive."""

_CAMERA = ObservationModel(
    sigma=math.radians(0.25),
    bearing_dof=4.0,
    motion="odometry",
    landmark_sigma=5.0,
    detection_probability=0.9,
    false_alarm_rate=0.07,
    expected_landmarks=8.0,
    stay_probability=0.9,
    field_of_view=math.radians(110.0),
)
_LASER = ObservationModel(
    sigma=math.radians(0.15),
    bearing_dof=4.0,
    motion="odometry",
    landmark_sigma=30.0,
    detection_probability=0.8,
    false_alarm_rate=0.15,
    expected_landmarks=15.0,
    stay_probability=0.95,
    field_of_view=math.radians(182.0),
)
_SIMULATED = ObservationModel(
    sigma=SIMULATED_SIGMA,
    landmark_sigma=15.0,
    detection_probability=0.9,
    false_alarm_rate=0.06,
    expected_landmarks=8.0,
    stay_probability=0.97,
)
MODELS = {
    "dlr-windows": _CAMERA,
    "dlr": _CAMERA,
    "victoria-park-windows": _LASER,
    "victoria-park": _LASER,
    "car-park": replace(_LASER, sigma=math.radians(0.25), expected_landmarks=4.0),
    "mrclam": ObservationModel(
        sigma=math.radians(0.35),
        bearing_dof=3.0,
        motion="odometry",
        landmark_sigma=5.0,
        detection_probability=0.5,
        false_alarm_rate=0.25,
        expected_landmarks=2.0,
        stay_probability=0.95,
        field_of_view=math.radians(66.0),
    ),
    "straight": replace(_SIMULATED, motion="straight", log_step_sigma=STEP_SIGMA),
    "smooth": replace(_SIMULATED, motion="smooth", step_change_sigma=STEP_CHANGE_SIGMA, **SMOOTH),
    "loop": replace(_SIMULATED, motion="odometry"),
}
"""What every estimator may assume of a set: noise from the recording's published description, the
rest round values; simulations have the truth where the model has a field for it. Of MRCLAM, where
round values were far off, what the labels of the tuning robots say, rounded."""


@lru_cache(maxsize=2)
def drives_of(set_name: str) -> tuple[Drive, ...]:
    """Return the drives of a set, read once in a process."""
    return tuple(READERS[set_name]())


def half_of(set_name: str, place: int) -> str:
    """Name the half that a drive belongs to; a set of a single drive is scored only."""
    n = len(drives_of(set_name))
    return "scored" if n == 1 or place in halves(range(n))[1] else "tuning"
