"""Cells of the calibration study: which scenes are drawn, and which model judges them.

A *cell* is one kind of scene at one size and noise. In `model` cells scenes are drawn from the very
model that judges them, so probabilities must come true; in mismatch cells they need not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from mht_slam import ObservationModel
from mht_slam.simulation import Scene, simulate_scene, trajectories, worlds
from mht_slam.simulation.scenes import observe_scene
from mht_slam.simulation.sensors import Sensor

Kind: TypeAlias = Literal["model", "uniform noise", "annulus", "one_sided"]

DETECTION_PROBABILITY = 0.9
FALSE_ALARMS_A_SCAN = 0.3
DETECTIONS_JUDGED = (2, 4)
"""Scans with fewer or more detections are drawn again; a choice by what is seen, not by truth."""


@dataclass(frozen=True)
class Cell:
    """One kind of scene.

    Attributes
    ----------
    kind : "model"; "uniform noise": a model's scene, its noise uniform inside epsilon; or a layout.
    n : landmarks; with misses and clutter the number expected.
    epsilon_deg : bound of uniform noise; sigma is epsilon / sqrt(3), the standard deviation of
        noise uniform inside epsilon, whatever the noise.
    landmark_sigma : of the prior that judges, baselines.
    heading_sigma_deg : independent deviation of every heading.
    detections : whether there are misses and false alarms.
    """

    kind: Kind
    n: int
    epsilon_deg: float
    landmark_sigma: float = 30.0
    heading_sigma_deg: float = 0.0
    detections: bool = False

    @property
    def name(self) -> str:
        """Name that keys the rows."""
        extras = [f"heading={self.heading_sigma_deg:g}"] if self.heading_sigma_deg else []
        extras += ["misses+clutter"] if self.detections else []
        size = f"{self.kind} n={self.n} epsilon={self.epsilon_deg:g} prior={self.landmark_sigma:g}"
        return " ".join([size, *extras])

    @property
    def from_model(self) -> bool:
        """Whether scenes are drawn from the model that judges them."""
        return self.kind == "model"

    @cached_property
    def model(self) -> ObservationModel:
        """What the scenes are judged under."""
        return ObservationModel(
            sigma=math.radians(self.epsilon_deg) / math.sqrt(3.0),
            heading_sigma=math.radians(self.heading_sigma_deg),
            landmark_sigma=self.landmark_sigma,
            detection_probability=DETECTION_PROBABILITY if self.detections else None,
            false_alarm_rate=FALSE_ALARMS_A_SCAN / (2.0 * math.pi) if self.detections else None,
            expected_landmarks=float(self.n) if self.detections else None,
        )

    @property
    def spread(self) -> float:
        """Standard deviation of a bearing from the direction of travel, radians: with jitter."""
        return math.hypot(self.model.sigma, self.model.heading_sigma)

    def simulate(self, seed: int) -> Scene:
        """Draw the scene of this seed; it depends on nothing else but the cell."""
        rng = np.random.default_rng([seed, *self.name.encode()])
        if self.kind == "model":
            return self._from_model(rng)
        if self.kind == "uniform noise":
            return self._with_uniform_noise(rng)
        return simulate_scene(self.kind, self.n, rng, sigma=self.model.sigma)

    def _from_model(self, rng: np.random.Generator) -> Scene:
        fewest, most = DETECTIONS_JUDGED
        while True:
            # The number of landmarks is Poisson where the model says so.
            n = None if self.detections else self.n
            scene = simulate_scene("model", n, rng, model=self.model)
            counts = scene.run.n_detections
            if not self.detections or all(fewest <= count <= most for count in counts):
                return scene

    def _with_uniform_noise(self, rng: np.random.Generator) -> Scene:
        model = self.model
        steps = trajectories.draw_steps(
            1, rng, log_mean=model.log_step_mean, log_sigma=model.log_step_sigma
        )
        poses = trajectories.nearly_straight(steps, rng, heading_sigma=0.0, lateral_sigma=0.0)
        landmarks = worlds.from_prior(self.n, rng, model)
        sensor = Sensor(spread=math.radians(self.epsilon_deg), noise="uniform")
        return observe_scene(self.kind, "straight", poses, landmarks, sensor, rng)
