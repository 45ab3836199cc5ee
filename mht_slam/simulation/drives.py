"""Drives past look-alike landmarks: straight, wandering, or round after round in a yard."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from mht_slam.arrays import FloatArray, finite_number, freeze, one_of, whole_number
from mht_slam.datasets.drive import Drive
from mht_slam.datasets.drive_odometry import relative_motions
from mht_slam.errors import OptionError
from mht_slam.measurements import BearingScan, Odometry, wrap_angle
from mht_slam.simulation import trajectories
from mht_slam.simulation.sensors import Sensor, bearings_and_ranges

DriveKind: TypeAlias = Literal["straight", "smooth", "loop"]
DRIVE_KINDS: tuple[DriveKind, ...] = ("straight", "smooth", "loop")

IN_VIEW = 8.0
"""Landmarks within range on average, where the caller states no range and there are as many."""
CLEARANCE = 1.0
"""Landmarks keep at least this distance from the path: baselines, or metres."""
MOST_ASIDE = 15.0
"""Landmarks lie at most this far beside the path or beyond its ends: baselines, or metres."""
LANDMARK_RADIUS = 0.1
"""Of the disc that hides what lies behind it: baselines, or metres."""
STEP_SIGMA = 0.2
"""Standard deviation of ln(step) on a straight drive."""
SMOOTH = {"turn_sigma": math.radians(4.0), "drift_sigma": math.radians(2.0)}
"""How a wandering drive turns from scan to scan."""
STEP_CHANGE_SIGMA = 0.05
"""How its steps change, ln(next step / step)."""
LOOP_STEP = 1.0
"""Metres between the scans of a loop."""
LOOP_WAVES = ((2, 0.2), (3, 0.1))
"""Cycles a round and relative amplitude of what makes a yard's round no circle."""
LOOP_WANDER = 0.3
"""Standard deviation of the distance between one round and the next, metres."""


@dataclass(frozen=True)
class OdometryNoise:
    """Independent Gaussian errors of an odometer's steps.

    Raises `OptionError` naming the field, for a value out of its range.
    """

    step_share: float = 0.03
    """Standard deviation of forward motion, as a share of the distance."""
    lateral_share: float = 0.01
    """Standard deviation of sideways motion, as a share of the distance."""
    turn_sigma: float = math.radians(1.0)
    """Standard deviation of a change of heading, radians."""

    def __post_init__(self) -> None:
        for name in ("step_share", "lateral_share", "turn_sigma"):
            finite_number(getattr(self, name), name, above=0.0)

    def measure(self, motion: FloatArray, rng: np.random.Generator) -> Odometry:
        """Return what the odometer says of a motion (dx, dy, dtheta), in the frame it starts in."""
        distance = math.hypot(motion[0], motion[1])
        sigmas = np.array(
            [self.step_share * distance, self.lateral_share * distance, self.turn_sigma]
        )
        dx, dy, dtheta = (motion + sigmas * rng.standard_normal(3)).tolist()
        return Odometry(dx, dy, dtheta, sigmas**2)


def simulate_drive(
    kind: DriveKind,
    n_landmarks: int,
    n_scans: int,
    rng: np.random.Generator,
    *,
    sigma: float,
    miss: float = 0.1,
    false_alarms: float = 0.05,
    max_range: float | None = None,
    field_of_view: float = 2.0 * math.pi,
    occlusion: bool = True,
    odometry: OdometryNoise | None = None,
    rounds: float = 2.0,
) -> Drive:
    """Simulate a drive with misses, false alarms, limited range and occlusion.

    Parameters
    ----------
    kind : "straight" (one line, one heading, uneven steps) and "smooth" (heading and steps walk,
        `trajectories.smooth`) are in the frame and unit of the first step, O1 = (0, 0) and
        O2 = (1, 0). "loop" goes `rounds` times round a yard in metres, from the origin along x, a
        scan every `LOOP_STEP`; it needs `odometry`, which gives the scale.
    n_landmarks, n_scans : landmarks lie beside the path all along it, most of them near.
    sigma : standard deviation of the Gaussian bearing noise, radians.
    miss : chance that a landmark in view is not detected.
    false_alarms : expected share of the detections that are false. Their rate is the same in every
        scan and direction.
    max_range : how far landmarks are seen, more than twice `CLEARANCE`, or infinity; None chooses
        it so that about `IN_VIEW` of them are within it, or all where there are fewer.
    field_of_view : full angle about forward, radians.
    occlusion : whether a landmark's disc of `LANDMARK_RADIUS` hides those behind it.
    odometry : the odometer's noise, or None without one.

    Returns
    -------
    Drive
        Identities are indices of landmarks. The reference is the truth, those landmarks included
        that no scan detects.

    Raises `OptionError` for options that make no sense.

    >>> drive = simulate_drive("straight", 12, 30, np.random.default_rng(1), sigma=0.01)
    >>> len(drive), len(drive.reference_landmarks), drive.has_odometry
    (30, 12, False)
    """
    _check(kind, n_landmarks, n_scans, odometry)
    finite_number(miss, "miss", at_least=0.0, below=1.0)
    finite_number(false_alarms, "false_alarms", at_least=0.0, below=1.0)
    finite_number(rounds, "rounds", above=0.0)
    if max_range is not None and max_range != math.inf:
        finite_number(max_range, "max_range", above=2.0 * CLEARANCE)
    path, closed = _path(kind, n_scans, rounds, rng), kind == "loop" and rounds >= 1.0
    beaten = path[: math.ceil(n_scans / rounds) + 1] if closed else path
    reach = _reach(beaten, n_landmarks, closed=closed) if max_range is None else max_range
    landmarks = _beside(beaten, n_landmarks, reach, rng, closed=closed)
    sensor = Sensor(
        spread=sigma,
        field_of_view=field_of_view,
        max_range=reach,
        detection_probability=1.0 - miss,
        landmark_radius=LANDMARK_RADIUS if occlusion else 0.0,
    )
    sensor = _with_false_alarms(sensor, path, landmarks, false_alarms)
    seen = [sensor.observe(pose, landmarks, rng) for pose in path]
    steps: list[Odometry | None] = [None] * n_scans
    if odometry is not None:
        steps[1:] = [odometry.measure(motion, rng) for motion in relative_motions(path)]
    return Drive(
        name=f"{kind} drive",
        scans=tuple(
            BearingScan(look.scan.bearings, time=float(k), odometry=step)
            for k, (look, step) in enumerate(zip(seen, steps, strict=True))
        ),
        identities=tuple(look.landmark_of_detection for look in seen),
        reference_poses=freeze(path),
        reference_landmarks=dict(enumerate(map(tuple, landmarks.tolist()))),
    )


def _check(kind: DriveKind, n_landmarks: int, n_scans: int, odometry: OdometryNoise | None) -> None:
    one_of(kind, "kind", DRIVE_KINDS)
    whole_number(n_landmarks, "n_landmarks", at_least=1)
    whole_number(n_scans, "n_scans", at_least=3)
    if kind == "loop" and odometry is None:
        raise OptionError("odometry is None: a loop is in metres, give it an OdometryNoise")


def _path(kind: DriveKind, n_scans: int, rounds: float, rng: np.random.Generator) -> FloatArray:
    """Return the true poses, (n_scans, 3)."""
    if kind == "straight":
        return trajectories.straight(
            trajectories.draw_steps(n_scans - 2, rng, log_sigma=STEP_SIGMA)
        )
    if kind == "smooth":
        return trajectories.smooth(n_scans, rng, step_change_sigma=STEP_CHANGE_SIGMA, **SMOOTH)
    return _loop(n_scans, rounds, rng)


def _loop(n_scans: int, rounds: float, rng: np.random.Generator) -> FloatArray:
    """Go round a yard whose length `rounds` times is that of the drive, from the origin along x."""
    radius = (n_scans - 1) * LOOP_STEP / rounds / (2.0 * math.pi)
    phases = rng.uniform(-math.pi, math.pi, len(LOOP_WAVES))
    # Each round has its own distance from the yard's shape, and goes over from one to the next.
    n_rounds = math.ceil(rounds) + 2
    wander = LOOP_WANDER * rng.standard_normal(n_rounds)
    angles = np.linspace(0.0, 2.0 * math.pi * rounds, 20 * n_scans)
    waves = sum(
        a * np.cos(n * angles + phase) for (n, a), phase in zip(LOOP_WAVES, phases, strict=True)
    )
    aside = np.interp(angles / (2.0 * math.pi), np.arange(n_rounds), wander)
    distance = radius * (1.0 + waves) + aside
    dense = np.column_stack([distance * np.cos(angles), distance * np.sin(angles)])
    travelled = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(dense, axis=0), axis=1))]
    direction = np.unwrap(np.arctan2(*np.gradient(dense, axis=0).T[::-1]))
    at = np.linspace(0.0, travelled[-1], n_scans)
    points = np.column_stack([np.interp(at, travelled, dense[:, i]) for i in range(2)])
    heading = np.interp(at, travelled, direction)
    c, s = math.cos(heading[0]), math.sin(heading[0])
    moved = (points - points[0]) @ np.array([[c, -s], [s, c]])
    # The waves make the round a little longer than the circle.
    moved *= LOOP_STEP * (n_scans - 1) / travelled[-1]
    return np.column_stack([moved, wrap_angle(heading - heading[0])])


def _reach(beaten: FloatArray, n_landmarks: int, *, closed: bool) -> float:
    """Range within which about `IN_VIEW` landmarks lie, of those that `_beside` places.

    A landmark near the path is in view along twice the range; there is one every length / n. An
    open path has landmarks for half the range before its start and after its end too.
    """
    ends = 0.0 if closed else IN_VIEW
    spare = max(2.0 * n_landmarks - ends, IN_VIEW)
    return max(IN_VIEW * _length(beaten) / spare, 4.0 * CLEARANCE)


def _length(points: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1).sum())


def _beside(
    beaten: FloatArray, n: int, reach: float, rng: np.random.Generator, *, closed: bool
) -> FloatArray:
    """Place n landmarks to either side of the path: evenly along it, most of them near, (n, 2)."""
    steps = np.linalg.norm(np.diff(beaten[:, :2], axis=0), axis=1)
    travelled = np.r_[0.0, np.cumsum(steps)]
    headings = np.unwrap(beaten[:, 2])
    before = 0.0 if closed else min(0.5 * reach, MOST_ASIDE)
    width = (travelled[-1] + 2.0 * before) / n
    farthest = min(reach, MOST_ASIDE)
    landmarks = np.empty((n, 2))
    for i in range(n):
        while True:
            along = (i + rng.random()) * width - before
            aside = CLEARANCE * (farthest / CLEARANCE) ** rng.random() * rng.choice([-1.0, 1.0])
            x, y, heading = (np.interp(along, travelled, c) for c in (*beaten.T[:2], headings))
            ahead = along - min(max(along, 0.0), travelled[-1])  # beyond an end: straight on
            c, s = math.cos(heading), math.sin(heading)
            landmarks[i] = x + c * ahead - s * aside, y + s * ahead + c * aside
            if np.linalg.norm(beaten[:, :2] - landmarks[i], axis=1).min() >= CLEARANCE:
                break
    return landmarks


def _with_false_alarms(
    sensor: Sensor, path: FloatArray, landmarks: FloatArray, share: float
) -> Sensor:
    """Give the sensor the rate at which `share` of all detections are expected to be false."""
    hits = [sensor.visible(*bearings_and_ranges(pose, landmarks)).sum() for pose in path]
    true = float(np.mean(hits)) * sensor.detection_probability
    return replace(sensor, false_alarm_rate=true * share / (1.0 - share) / sensor.field_of_view)
