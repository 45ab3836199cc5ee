"""Dense simulated runs: a robot among look-alike landmarks, many scans a metre."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.simulation import Scene, Sensor, observe_scene

PATHS = ("straight", "curved", "lawnmower")
WORLDS = ("yard", "scatter")
"""Landmarks along the edge of a yard that the robot drives in, or anywhere round its path."""
N_SCANS = 100
SURROUNDINGS = 5.0
"""Metres round the path that landmarks stand in."""
CLEARANCE = 0.5
"""Metres that the robot keeps from landmarks: it does not drive over them."""
DETECTION_PROBABILITY = 0.95
FALSE_SHARE = 0.03
"""False alarms as a share of the landmarks in view."""

YARD_MARGIN, YARD_DEPTH = 3.0, 1.3
"""Metres from the path's box to the edge of the yard, and how far outside that landmarks reach."""
YARD_JITTER = 0.25
"""Landmarks along the edge are this share of their spacing off at most."""

CURVE_HEADING, CURVE_LENGTH = np.deg2rad(40.0), 8.0
"""A curved path weaves: largest heading, and metres of a period."""
LANE_LENGTH, TURN_RADIUS = 3.0, 1.0
"""A lawnmower's lanes and half circles, metres."""


@dataclass(frozen=True)
class Setting:
    """One row of the study: the path, how dense the scans are and how hard they are to read."""

    world: str
    path: str
    step: float
    n_landmarks: int
    sigma_deg: float

    @property
    def name(self) -> str:
        """Short name for tables and seeds."""
        scans = f"{self.step:g} m, {self.n_landmarks} landmarks, {self.sigma_deg:g} deg"
        return f"{self.world}, {self.path}, {scans}"


def dense_scene(setting: Setting, rng: np.random.Generator, n_scans: int = N_SCANS) -> Scene:
    """Simulate one run; poses and landmarks in metres, the first pose is the frame."""
    poses = path_poses(setting.path, setting.step, n_scans)
    layout = yard_landmarks if setting.world == "yard" else scattered_landmarks
    landmarks = layout(poses[:, :2], setting.n_landmarks, rng)
    sensor = Sensor(
        spread=np.deg2rad(setting.sigma_deg),
        noise="gaussian",
        detection_probability=DETECTION_PROBABILITY,
        false_alarm_rate=FALSE_SHARE * setting.n_landmarks / (2.0 * np.pi),
    )
    return observe_scene("dense", "free", poses, landmarks, sensor, rng)


def path_poses(path: str, step: float, n_scans: int) -> FloatArray:
    """Poses (n_scans, 3) along a path, `step` metres apart; the robot looks where it goes."""
    travelled = step * (np.arange(n_scans) + 0.5)
    if path == "straight":
        headings = np.zeros(n_scans)
    elif path == "curved":
        headings = CURVE_HEADING * np.sin(2.0 * np.pi * travelled / CURVE_LENGTH)
    else:
        headings = lawnmower_heading(travelled)
    moves = step * np.column_stack([np.cos(headings), np.sin(headings)])
    points = np.vstack([np.zeros((1, 2)), np.cumsum(moves[:-1], axis=0)])
    return np.column_stack([points, headings])


def lawnmower_heading(travelled: FloatArray) -> FloatArray:
    """Heading after so many metres: lanes there and back, half circles left and right between."""
    half_circle = np.pi * TURN_RADIUS
    lap, inside = np.divmod(travelled, LANE_LENGTH + half_circle)
    turned = np.clip(inside - LANE_LENGTH, 0.0, half_circle) / TURN_RADIUS
    there = lap % 2 == 0
    return np.where(there, turned, np.pi - turned)


def scattered_landmarks(points: FloatArray, n: int, rng: np.random.Generator) -> FloatArray:
    """Landmarks uniform round the path, none closer to it than `CLEARANCE`."""
    low, high = points.min(axis=0) - SURROUNDINGS, points.max(axis=0) + SURROUNDINGS
    kept: list[FloatArray] = []
    while len(kept) < n:
        place = rng.uniform(low, high)
        if np.hypot(*(points - place).T).min() >= CLEARANCE:
            kept.append(place)
    return np.array(kept)


def yard_landmarks(points: FloatArray, n: int, rng: np.random.Generator) -> FloatArray:
    """Landmarks all around, evenly along an ellipse that the path stays well inside of."""
    low, high = points.min(axis=0), points.max(axis=0)
    axes = (0.5 * (high - low) + YARD_MARGIN) * np.sqrt(2.0)
    angles = (np.arange(n) + rng.uniform(-YARD_JITTER, YARD_JITTER, n)) * 2.0 * np.pi / n
    angles += rng.uniform(0.0, 2.0 * np.pi)
    depth = rng.uniform(1.0, YARD_DEPTH, n)
    around = depth[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    return 0.5 * (low + high) + axes * around
