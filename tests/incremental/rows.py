"""A robot that passes a row of landmarks, with the owners one likes: runs to read again."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

import mht_slam as ms
from mht_slam.arrays import FloatArray, IntArray
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.steps import Step, frame_step, next_step
from mht_slam.incremental.whole_run import WholeRun, smooth_whole_run

SIGMA = math.radians(0.5)
CONFIG = SlamConfig(motion="odometry")
STRAY = 99
"""Number of the landmark that may be another."""


class Row:
    """Twelve scans along a row of landmarks, all of which every scan sees; the stray is added."""

    def __init__(
        self,
        stray_at: FloatArray | None,
        scans: range,
        seed: int = 3,
        config: SlamConfig = CONFIG,
    ) -> None:
        self.config = config
        rng = np.random.default_rng(seed)
        self.landmarks = np.array([[2.0, 3.0], [5.0, -3.0], [9.0, 4.0], [12.0, -4.0], [6.0, 6.0]])
        self.poses = np.column_stack([np.arange(12.0), np.zeros((12, 2))])
        self.owners: list[IntArray] = []
        self.bearings: list[FloatArray] = []
        for k, pose in enumerate(self.poses):
            places, numbers = self.landmarks, np.arange(len(self.landmarks))
            if stray_at is not None and k in scans:
                places, numbers = np.vstack([places, stray_at]), np.append(numbers, STRAY)
            away = places - pose[:2]
            self.bearings.append(
                np.arctan2(away[:, 1], away[:, 0]) + SIGMA * rng.normal(size=len(places))
            )
            self.owners.append(numbers)

    @property
    def sigmas(self) -> list[FloatArray]:
        return [np.full(len(b), SIGMA) for b in self.bearings]

    @property
    def steps(self) -> list[Step]:
        step = ms.Odometry(1.0, 0.0, 0.0, [1e-4, 1e-4, 1e-5])
        moved = [ms.BearingScan(b, odometry=step) for b in self.bearings]
        model = self.config.observation_model
        later = [next_step(model, moved[k], k, False, None) for k in range(1, len(moved))]
        return [frame_step(), *later]

    def smoothed(
        self, owners: Sequence[IntArray] | None = None, start: WholeRun | None = None
    ) -> WholeRun:
        model = self.config.observation_model
        points = (
            {} if start is None else dict(zip(start.numbers.tolist(), start.points, strict=True))
        )
        return smooth_whole_run(
            self.steps, self.owners if owners is None else owners, self.bearings, self.sigmas,
            self.poses, points, dof=model.bearing_dof, landmark_sigma=model.landmark_sigma,
        )  # fmt: skip


def renamed(row: Row, landmark: int, scans: range) -> Row:
    """The row with some of a landmark's sightings given to the stray."""
    for k in scans:
        row.owners[k] = np.where(row.owners[k] == landmark, STRAY, row.owners[k])
    return row
