"""Which scenes a comparison draws: a sweep, its cells, and one seeded case per scene."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from mht_slam.arrays import finite_number, one_of, whole_number
from mht_slam.errors import OptionError
from mht_slam.evaluation.bench.case import Assumptions, Case
from mht_slam.measurements import MIN_RUN_SCANS
from mht_slam.models import ObservationModel
from mht_slam.simulation import Scene, Sensor, simulate_scene
from mht_slam.simulation.scenes import SceneKind

Noise: TypeAlias = Literal["uniform", "gaussian"]

UNIFORM_RATIO = math.sqrt(3.0)
"""Epsilon over sigma of noise uniform inside epsilon."""
MOST_MISSED, MOST_FALSE = 3, 3
"""Missed and false detections of a table, where a cell has any."""
MORE_DETECTIONS = 2
"""Detections of a scan beyond the number of landmarks at which a scene is drawn again."""
FEWEST_DETECTIONS = 3
MOST_DRAWS = 1000

_WORDS = 8


@dataclass(frozen=True)
class Cell:
    """One kind of scene at one setting; angles are radians, lengths baselines.

    Attributes
    ----------
    kind : layout of the landmarks, or "model": scenes drawn from the model that judges them.
    landmarks : how many; where detections are missed or false, how many the model expects.
    noise : uniform inside `epsilon`, or Gaussian of `sigma`, never clipped.
    epsilon, sigma : what methods assume of a bearing's error, and what it is.
    n_scans : scans of a run.
    step : every step after the first one; None draws them as `simulate_scene` does.
    heading_sigma : independent deviation of every heading.
    detection_probability, false_alarms : chance that a landmark is detected; false alarms a scan.
    landmark_sigma : of the prior that judges (and of the scenes, for kind "model").
    seed : of the sweep.
    """

    kind: SceneKind
    landmarks: int
    noise: Noise
    epsilon: float
    sigma: float
    n_scans: int
    step: float | None
    heading_sigma: float
    detection_probability: float
    false_alarms: float
    landmark_sigma: float
    seed: int

    @property
    def key(self) -> str:
        """The cell as one line of JSON: names its scenes in a store and seeds them."""
        return json.dumps(asdict(self), sort_keys=True, separators=(",", ":"))

    @property
    def name(self) -> str:
        """What the cell is and which prior judges it, for a reader; angles in degrees."""
        epsilon, sigma = math.degrees(self.epsilon), math.degrees(self.sigma)
        size = f"epsilon {epsilon:.4g}" if self.noise == "uniform" else f"sigma {sigma:.4g}"
        parts = [f"{self.kind} n={self.landmarks}", f"{self.noise} {size} deg"]
        parts += [f"{self.n_scans} scans"] if self.n_scans != MIN_RUN_SCANS else []
        parts += [f"step {self.step:g}"] if self.step is not None else []
        parts += (
            [f"headings {math.degrees(self.heading_sigma):.4g} deg"] if self.heading_sigma else []
        )
        if self.has_clutter:
            parts.append(
                f"detection {self.detection_probability:g}, {self.false_alarms:g} false a scan"
            )
        return ", ".join([*parts, f"prior {self.landmark_sigma:g}"])

    @property
    def has_clutter(self) -> bool:
        """Whether detections are missed or false."""
        return self.detection_probability < 1.0 or self.false_alarms > 0.0

    @property
    def columns(self) -> dict[str, Any]:
        """The cell's columns in tables; angles in degrees, the step empty where drawn."""
        return {
            "cell": self.name,
            "kind": self.kind,
            "landmarks": self.landmarks,
            "noise": self.noise,
            "epsilon_deg": _degrees(self.epsilon),
            "sigma_deg": _degrees(self.sigma),
            "scans": self.n_scans,
            "step": self.step,
            "heading_sigma_deg": _degrees(self.heading_sigma),
            "detection_probability": self.detection_probability,
            "false_alarms": self.false_alarms,
            "landmark_sigma": self.landmark_sigma,
            "seed": self.seed,
        }

    @property
    def model(self) -> ObservationModel:
        """The model that methods assume; scenes of kind "model" are drawn from it."""
        clutter = self.has_clutter
        return ObservationModel(
            sigma=self.sigma,
            heading_sigma=self.heading_sigma,
            landmark_sigma=self.landmark_sigma,
            detection_probability=self.detection_probability if clutter else None,
            false_alarm_rate=self.false_alarms / (2.0 * math.pi) if clutter else None,
            expected_landmarks=float(self.landmarks) if clutter else None,
        )

    def case(self, scene: int) -> Case:
        """Draw the scene of this number. It depends on the cell and the number, nothing else."""
        drawn = self._draw(np.random.default_rng(self._entropy(scene)))
        missed, false = (MOST_MISSED, MOST_FALSE) if self.has_clutter else (0, 0)
        return Case(
            run=drawn.run,
            truth=drawn.truth,
            assumptions=Assumptions(self.epsilon, self.model, missed, false),
            poses=drawn.poses,
            landmarks=drawn.landmarks,
        )

    def _entropy(self, scene: int) -> np.random.SeedSequence:
        digest = hashlib.sha256(self.key.encode()).digest()
        words = np.frombuffer(digest, dtype=">u4")[:_WORDS].tolist()
        return np.random.SeedSequence([*words, scene])

    def _draw(self, rng: np.random.Generator) -> Scene:
        """Draw until every scan has as many detections as are judged: a choice by what is seen."""
        for _ in range(MOST_DRAWS):
            scene = self._simulate(rng)
            counts = scene.run.n_detections
            most = self.landmarks + MORE_DETECTIONS
            if not self.has_clutter or all(FEWEST_DETECTIONS <= c <= most for c in counts):
                return scene
        raise OptionError(
            f"{self.name}: none of {MOST_DRAWS} scenes has {FEWEST_DETECTIONS} to "
            f"{self.landmarks + MORE_DETECTIONS} detections in every scan: give more landmarks, "
            "fewer misses or fewer false alarms"
        )

    def _simulate(self, rng: np.random.Generator) -> Scene:
        steps = None if self.step is None else [self.step] * (self.n_scans - 2)
        if self.kind == "model":
            return simulate_scene(
                "model",
                None if self.has_clutter else self.landmarks,
                rng,
                model=self.model,
                n_scans=self.n_scans,
                steps=steps,
            )
        uniform = self.noise == "uniform"
        sensor = Sensor(
            spread=self.epsilon if uniform else self.sigma,
            noise=self.noise,
            detection_probability=self.detection_probability,
            false_alarm_rate=self.false_alarms / (2.0 * math.pi),
        )
        return simulate_scene(
            self.kind,
            self.landmarks,
            rng,
            sensor=sensor,
            n_scans=self.n_scans,
            steps=steps,
            heading_sigma=self.heading_sigma,
        )


@dataclass(frozen=True)
class Sweep:
    """Every combination of these settings, each with the same number of scenes.

    Angles are radians, lengths baselines. Each scene has a generator of its own, seeded by its
    cell and its number: more cells or more scenes change none of the others.

    Raises `OptionError`, naming the field, for values that make no sense or leave no cell.

    >>> sweep = Sweep(kinds=("annulus",), landmarks=(3, 4), epsilons=(0.02, 0.05), scenes=10)
    >>> len(sweep.cells), len(sweep.jobs)
    (8, 80)
    """

    kinds: tuple[SceneKind, ...] = ("annulus", "model")
    """Layouts of landmarks; "model" draws everything from the assumed model, with Gaussian noise
    whatever `noises` says."""
    landmarks: tuple[int, ...] = (3, 4)
    """Numbers of landmarks."""
    noises: tuple[Noise, ...] = ("uniform", "gaussian")
    """Uniform inside epsilon, or Gaussian of sigma and not clipped."""
    epsilons: tuple[float, ...] = ()
    """Vision errors; give these or `sigmas`. None of both means 1, 3 and 5 degrees."""
    sigmas: tuple[float, ...] = ()
    """Standard deviations of a bearing. Epsilon is sqrt(3) of them for uniform noise, and
    `coverage` of them for Gaussian noise."""
    coverage: float = 3.0
    """Epsilon over sigma of Gaussian noise: how much of it the polygon method's bound covers."""
    n_scans: tuple[int, ...] = (3,)
    """Scans of a run."""
    steps: tuple[float | None, ...] = (None,)
    """Every step after the first one; None draws them."""
    heading_sigmas: tuple[float, ...] = (0.0,)
    """Independent deviations of every heading from the direction of travel."""
    detection_probabilities: tuple[float, ...] = (1.0,)
    """Chances that a landmark is detected."""
    false_alarms: tuple[float, ...] = (0.0,)
    """Expected false alarms a scan."""
    landmark_sigma: float = 30.0
    """Scale of the landmark prior of the model that judges."""
    scenes: int = 100
    """Scenes of each cell."""
    seed: int = 0
    """Of everything random."""

    def __post_init__(self) -> None:
        for kind in self.kinds:
            one_of(kind, "kinds", get_args(SceneKind))
        for noise in self.noises:
            one_of(noise, "noises", get_args(Noise))
        for n in self.landmarks:
            whole_number(n, "landmarks", at_least=MIN_RUN_SCANS)
        for n in self.n_scans:
            whole_number(n, "n_scans", at_least=MIN_RUN_SCANS)
        if self.epsilons and self.sigmas:
            raise OptionError("epsilons and sigmas are given: give one of them")
        for name in ("epsilons", "sigmas"):
            for value in getattr(self, name):
                finite_number(value, name, above=0.0, below=math.pi / 2.0)
        for step in self.steps:
            if step is not None:
                finite_number(step, "steps", above=0.0)
        for value in self.heading_sigmas:
            finite_number(value, "heading_sigmas", at_least=0.0, below=math.pi)
        for value in self.detection_probabilities:
            finite_number(value, "detection_probabilities", above=0.0, at_most=1.0)
        for value in self.false_alarms:
            finite_number(value, "false_alarms", at_least=0.0)
        finite_number(self.coverage, "coverage", above=0.0)
        finite_number(self.landmark_sigma, "landmark_sigma", above=0.0)
        whole_number(self.scenes, "scenes", at_least=1)
        whole_number(self.seed, "seed", at_least=0)
        if not self.cells:
            raise OptionError("the sweep has no cell: give every setting at least one value")
        widest = max(cell.epsilon for cell in self.cells)
        finite_number(widest, "coverage times the largest sigma", below=math.pi / 2.0)

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Every different combination, in the order of the settings."""
        return tuple(dict.fromkeys(self._combinations()))

    @property
    def jobs(self) -> tuple[tuple[Cell, int], ...]:
        """Cell and number of every scene."""
        return tuple((cell, scene) for cell in self.cells for scene in range(self.scenes))

    def _combinations(self) -> Iterator[Cell]:
        for kind, n, noise, spread, n_scans, step, heading, detected, false in product(
            self.kinds,
            self.landmarks,
            self.noises,
            self.sigmas or self.epsilons or DEFAULT_EPSILONS,
            self.n_scans,
            self.steps,
            self.heading_sigmas,
            self.detection_probabilities,
            self.false_alarms,
        ):
            own: Noise = "gaussian" if kind == "model" else noise
            ratio = UNIFORM_RATIO if own == "uniform" else self.coverage
            cell = Cell(
                kind=kind,
                landmarks=n,
                noise=own,
                epsilon=float(spread),
                sigma=float(spread) / ratio,
                n_scans=n_scans,
                step=None if step is None else float(step),
                heading_sigma=float(heading),
                detection_probability=float(detected),
                false_alarms=float(false),
                landmark_sigma=float(self.landmark_sigma),
                seed=self.seed,
            )
            if self.sigmas:
                cell = replace(cell, epsilon=ratio * float(spread), sigma=float(spread))
            yield cell


DEFAULT_EPSILONS = tuple(math.radians(degrees) for degrees in (1.0, 3.0, 5.0))


def _degrees(angle: float) -> float:
    """Degrees without the last digits that the way through radians leaves."""
    return float(f"{math.degrees(angle):.12g}")
