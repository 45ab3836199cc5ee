"""Whole scenes, from a kind and a seed to scans with their true association."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np
import numpy.typing as npt

from mht_slam.arrays import (
    BoolArray,
    FloatArray,
    finite_array,
    finite_number,
    freeze,
    whole_number,
)
from mht_slam.association import MISSED, Association
from mht_slam.errors import OptionError
from mht_slam.measurements import MIN_RUN_SCANS, BearingScan, RunPair, StraightRun, wrap_angle
from mht_slam.models import ObservationModel
from mht_slam.simulation import trajectories, worlds
from mht_slam.simulation.sensors import Observation, Sensor

Motion: TypeAlias = Literal["straight", "pair", "free"]
WorldKind: TypeAlias = Literal["annulus", "one_sided", "corridor", "clusters"]
SceneKind: TypeAlias = Literal["annulus", "one_sided", "corridor", "clusters", "model"]

STEP_RANGE = (0.5, 2.0)
"""Steps after the first, baselines, uniform in their logarithm; not for one-sided and `model`."""

SECOND_RUN_REACH = 0.5
"""How far the midpoint of a pair's second run may lie from that of the first, baselines."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Scans with everything that is true of them.

    Attributes
    ----------
    kind : the layout of the landmarks.
    motion : "straight" (one run, read as `run`), "pair" (two runs, read as `pair`) or "free".
    scans : m `BearingScan` in order of travel; the order of detections is random.
    truth : the true association over all scans.
    poses : (m, 3) x, y, theta of each scan. The frame is the (first) run's, O1 = (0, 0) and
        O2 = (1, 0), in baselines; for a free scene it is the first pose's.
    landmarks : (n, 2), **row l is the landmark of row l of truth.table**: those seen at least once.
    unseen_landmarks : (k, 2), those that no scan detected.
    sensor : what made the scans; `sensor.spread` is epsilon for uniform noise and sigma otherwise.
    model : the `ObservationModel` the scene was drawn from, None for other kinds.
    """

    kind: str
    motion: Motion
    scans: tuple[BearingScan, ...]
    truth: Association
    poses: FloatArray
    landmarks: FloatArray
    unseen_landmarks: FloatArray
    sensor: Sensor
    model: ObservationModel | None = None

    @property
    def run(self) -> StraightRun:
        """The scans as one straight run; an `OptionError` for a scene that is none."""
        self._expect("straight")
        return StraightRun(self.scans)

    @property
    def pair(self) -> RunPair:
        """The four scans as two straight runs; an `OptionError` for a scene that is none."""
        self._expect("pair")
        return RunPair(self.scans[:2], self.scans[2:])

    def _expect(self, motion: Motion) -> None:
        if self.motion != motion:
            raise OptionError(f"the scene's motion is {self.motion!r}: read its scans instead")


def simulate_scene(
    kind: SceneKind,
    n_landmarks: int | None,
    rng: np.random.Generator,
    *,
    epsilon: float | None = None,
    sigma: float | None = None,
    sensor: Sensor | None = None,
    model: ObservationModel | None = None,
    n_scans: int = 3,
    steps: npt.ArrayLike | None = None,
    heading_sigma: float = 0.0,
    lateral_sigma: float = 0.0,
) -> Scene:
    """Simulate one straight, or nearly straight, run past look-alike landmarks.

    Parameters
    ----------
    kind : "annulus", "one_sided" (with steps 4 and 5 of its unit, see `worlds.one_sided`),
        "corridor", "clusters", or "model": everything drawn from `model` (docs/method.md,
        section 4): landmarks, how long each is in view, poses, noise, misses, false alarms.
        Detection terms that the model leaves out mean that every landmark is seen. Its motion is
        ``straight`` or ``smooth``; steps are given or drawn for ``straight`` only.
    n_landmarks : number of landmarks, over all scans. For a `model` that states
        `expected_landmarks` it may be None: then it is Poisson.
    epsilon, sigma, sensor : give one, and none for kind "model". Uniform noise strictly inside
        epsilon radians; Gaussian noise of sigma radians; or a `Sensor`. The first two see
        every landmark.
    n_scans : at least 3.
    steps : the n_scans - 2 steps after the first, baselines; drawn when None.
    heading_sigma, lateral_sigma : as in `trajectories.nearly_straight`, radians and baselines;
        kind "model" has its own.

    Raises `OptionError` for options that contradict each other or make no sense.

    >>> scene = simulate_scene("annulus", 4, np.random.default_rng(1), epsilon=0.05)
    >>> scene.truth.n_landmarks, len(scene.run)
    (4, 3)
    """
    whole_number(n_scans, "n_scans", at_least=MIN_RUN_SCANS)
    if kind not in get_args(SceneKind):
        raise OptionError(f"kind is {kind!r}: give one of {get_args(SceneKind)}")
    if kind == "model":
        if (epsilon, sigma, sensor) != (None, None, None) or heading_sigma or lateral_sigma:
            raise OptionError(
                "kind 'model' takes noise and deviations from model: leave epsilon, sigma, "
                "sensor, heading_sigma and lateral_sigma out"
            )
        return _scene_of_model(n_landmarks, rng, model, n_scans, steps)
    if model is not None:
        raise OptionError(f"model is given with kind {kind!r}: only kind 'model' draws from it")
    chosen = _chosen_sensor(epsilon, sigma, sensor)
    lengths = _steps(kind, steps, n_scans, rng)
    poses = trajectories.nearly_straight(
        lengths, rng, heading_sigma=heading_sigma, lateral_sigma=lateral_sigma
    )
    landmarks = _world(kind, n_landmarks, rng, length=float(poses[-1, 0]))
    return observe_scene(kind, "straight", poses, landmarks, chosen, rng)


def simulate_pair(
    kind: WorldKind,
    n_landmarks: int,
    rng: np.random.Generator,
    *,
    epsilon: float | None = None,
    sigma: float | None = None,
    sensor: Sensor | None = None,
) -> Scene:
    """Simulate two straight runs of two scans past the same landmarks; read it as `Scene.pair`.

    The second run has a step in `STEP_RANGE`, any direction, and its midpoint within
    `SECOND_RUN_REACH` of the first one's. Options and errors as in `simulate_scene`.
    """
    chosen = _chosen_sensor(epsilon, sigma, sensor)
    landmarks = _world(kind, n_landmarks, rng, length=1.0)
    first = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    heading = rng.uniform(-math.pi, math.pi)
    half_step = 0.5 * float(_draw_steps(1, rng)[0])
    direction = np.array([math.cos(heading), math.sin(heading)])
    offset = SECOND_RUN_REACH * math.sqrt(rng.random())
    bearing = rng.uniform(-math.pi, math.pi)
    middle = np.array([0.5, 0.0]) + offset * np.array([math.cos(bearing), math.sin(bearing)])
    second = [[*(middle + sign * half_step * direction), heading] for sign in (-1.0, 1.0)]
    poses = np.vstack([first, second])
    return observe_scene(kind, "pair", poses, landmarks, chosen, rng)


def simulate_free(
    n_landmarks: int,
    rng: np.random.Generator,
    *,
    epsilon: float | None = None,
    sigma: float | None = None,
    sensor: Sensor | None = None,
    n_scans: int = 10,
    turn_sigma: float = 0.5,
) -> Scene:
    """Simulate a free run, unit steps on average, past landmarks uniform over its surroundings.

    The surroundings are the box around the trajectory, widened by two steps on every side. Options
    and errors as in `simulate_scene`.
    """
    chosen = _chosen_sensor(epsilon, sigma, sensor)
    whole_number(n_landmarks, "n_landmarks", at_least=0)
    poses = trajectories.free(n_scans, rng, turn_sigma=turn_sigma)
    low, high = poses[:, :2].min(axis=0) - 2.0, poses[:, :2].max(axis=0) + 2.0
    landmarks = rng.uniform(low, high, (n_landmarks, 2))
    return observe_scene("free", "free", poses, landmarks, chosen, rng)


def observe_scene(
    kind: str,
    motion: Motion,
    poses: FloatArray,
    landmarks: FloatArray,
    sensor: Sensor,
    rng: np.random.Generator,
    model: ObservationModel | None = None,
    present: BoolArray | None = None,
) -> Scene:
    """Look at `landmarks` (n, 2) from every pose (m, 3) and keep the truth, as a `Scene`.

    `present` (m, n) says which landmark is there when; None means all of them always.
    """
    if present is None:
        present = np.ones((len(poses), len(landmarks)), dtype=np.bool_)
    observations = [
        _observe_present(sensor, pose, landmarks, there, rng)
        for pose, there in zip(poses, present, strict=True)
    ]
    truth = Association.from_labels(
        [
            [None if label == MISSED else label for label in seen.landmark_of_detection.tolist()]
            for seen in observations
        ]
    )
    rows = _landmark_of_row(truth, observations)
    unseen = np.setdiff1d(np.arange(len(landmarks)), rows)
    return Scene(
        kind=kind,
        motion=motion,
        scans=tuple(seen.scan for seen in observations),
        truth=truth,
        poses=freeze(np.column_stack([poses[:, :2], wrap_angle(poses[:, 2])])),
        landmarks=freeze(landmarks[rows]),
        unseen_landmarks=freeze(landmarks[unseen]),
        sensor=sensor,
        model=model,
    )


def _observe_present(
    sensor: Sensor,
    pose: FloatArray,
    landmarks: FloatArray,
    there: BoolArray,
    rng: np.random.Generator,
) -> Observation:
    """Look at the landmarks that are there; their indices stay those among all."""
    seen = sensor.observe(pose, landmarks[there], rng)
    real = seen.landmark_of_detection != MISSED
    labels = np.full(len(real), MISSED, dtype=np.int64)
    labels[real] = np.flatnonzero(there)[seen.landmark_of_detection[real]]
    return Observation(seen.scan, freeze(labels))


def _landmark_of_row(truth: Association, observations: list[Observation]) -> list[int]:
    """Index of the landmark behind each row of the truth, which sorts its rows."""
    rows = []
    for row in truth.table:
        scan = int(np.flatnonzero(row != MISSED)[0])
        rows.append(int(observations[scan].landmark_of_detection[row[scan]]))
    return rows


def _scene_of_model(
    n_landmarks: int | None,
    rng: np.random.Generator,
    model: ObservationModel | None,
    n_scans: int,
    steps: npt.ArrayLike | None,
) -> Scene:
    if model is None:
        raise OptionError("kind 'model' needs model: give the ObservationModel to draw from")
    leave = 1.0 - model.stay_probability
    if n_landmarks is None:
        if model.expected_landmarks is None:
            raise OptionError(
                "n_landmarks is None and model states no expected_landmarks: give one of them"
            )
        ever_there = 1.0 + (n_scans - 1) * leave
        n_landmarks = int(rng.poisson(model.expected_landmarks * ever_there))
    landmarks = worlds.from_prior(n_landmarks, rng, model)
    poses = _poses_of_model(rng, model, n_scans, steps)
    present = worlds.stretches(n_landmarks, n_scans, rng, leave=leave) if leave else None
    sensor = Sensor.of_model(model)
    return observe_scene("model", "straight", poses, landmarks, sensor, rng, model, present)


def _poses_of_model(
    rng: np.random.Generator,
    model: ObservationModel,
    n_scans: int,
    steps: npt.ArrayLike | None,
) -> FloatArray:
    if model.motion == "straight":
        lengths = (
            trajectories.draw_steps(
                n_scans - 2, rng, log_mean=model.log_step_mean, log_sigma=model.log_step_sigma
            )
            if steps is None
            else _given_steps(steps, n_scans)
        )
        return trajectories.nearly_straight(
            lengths, rng, heading_sigma=model.heading_sigma, lateral_sigma=model.lateral_sigma
        )
    if model.motion != "smooth":
        raise OptionError(
            f"motion is {model.motion!r}: kind 'model' draws runs of motion 'straight' or 'smooth'"
        )
    if steps is not None:
        raise OptionError("steps are given: motion 'smooth' draws its own; leave them out")
    return trajectories.smooth(
        n_scans,
        rng,
        turn_sigma=model.turn_sigma,
        drift_sigma=model.drift_sigma,
        step_change_sigma=model.step_change_sigma,
    )


def _world(
    kind: str, n_landmarks: int | None, rng: np.random.Generator, length: float
) -> FloatArray:
    if n_landmarks is None:
        raise OptionError(f"n_landmarks is None: kind {kind!r} needs a number")
    if kind == "one_sided":
        return worlds.one_sided(n_landmarks, rng)
    layouts: dict[str, Callable[[int, np.random.Generator, float], FloatArray]] = {
        "annulus": worlds.annulus,
        "corridor": worlds.corridor,
        "clusters": worlds.clusters,
    }
    if kind not in layouts:
        raise OptionError(f"kind is {kind!r}: give one of {get_args(WorldKind)}")
    return layouts[kind](n_landmarks, rng, length)


def _steps(
    kind: str, steps: npt.ArrayLike | None, n_scans: int, rng: np.random.Generator
) -> FloatArray:
    if steps is not None:
        return _given_steps(steps, n_scans)
    if kind == "one_sided":
        first, second = worlds.LONG_STEPS
        return np.full(n_scans - 2, second / first)
    return _draw_steps(n_scans - 2, rng)


def _draw_steps(n: int, rng: np.random.Generator) -> FloatArray:
    shortest, longest = STEP_RANGE
    return np.exp(rng.uniform(math.log(shortest), math.log(longest), n))


def _given_steps(steps: npt.ArrayLike, n_scans: int) -> FloatArray:
    lengths = finite_array(steps, "steps", OptionError, remedy="give lengths in baselines")
    if lengths.shape != (n_scans - 2,):
        raise OptionError(
            f"steps has shape {lengths.shape}: give the {n_scans - 2} steps after the first one, "
            "in units of the first"
        )
    return lengths


def _chosen_sensor(epsilon: float | None, sigma: float | None, sensor: Sensor | None) -> Sensor:
    options = {"epsilon": epsilon, "sigma": sigma, "sensor": sensor}
    given = [name for name, value in options.items() if value is not None]
    if len(given) != 1:
        raise OptionError(
            f"{' and '.join(given) or 'no noise'} given: give one of epsilon, sigma and sensor"
        )
    if sensor is not None:
        return sensor
    if epsilon is not None:
        return Sensor(spread=finite_number(epsilon, "epsilon", at_least=0.0), noise="uniform")
    return Sensor(spread=finite_number(sigma, "sigma", at_least=0.0), noise="gaussian")
