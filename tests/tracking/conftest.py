"""Dense runs for the tests of tracks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mht_slam.simulation import Scene, Sensor, observe_scene

DenseRun = Callable[..., Scene]


@pytest.fixture
def dense_run() -> DenseRun:
    """A robot that goes .1 m a scan past landmarks at a metre or more."""

    def simulate(
        seed: int,
        n_landmarks: int = 6,
        n_scans: int = 40,
        *,
        bend: float = 0.0,
        sensor: Sensor | None = None,
    ) -> Scene:
        rng = np.random.default_rng(seed)
        headings = bend * np.arange(n_scans)
        moves = 0.1 * np.column_stack([np.cos(headings), np.sin(headings)])
        points = np.vstack([np.zeros((1, 2)), np.cumsum(moves[:-1], axis=0)])
        landmarks: list[np.ndarray] = []
        while len(landmarks) < n_landmarks:
            place = rng.uniform(-5.0, 9.0, 2)
            if np.hypot(*(points - place).T).min() > 1.0:
                landmarks.append(place)
        return observe_scene(
            "dense",
            "free",
            np.column_stack([points, headings]),
            np.array(landmarks),
            sensor or Sensor(spread=0.0, noise="gaussian"),
            rng,
        )

    return simulate
