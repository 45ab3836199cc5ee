"""The step before each scan: its factor, and the motions to try before the scan is understood."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.errors import MeasurementError
from mht_slam.incremental.motion_terms import (
    FREE,
    LONGEST,
    N_PARAMETERS,
    ODOMETRY,
    RESTART,
    SHORTEST,
    SMOOTH,
    STILL,
    STRAIGHT,
)
from mht_slam.measurements import BearingScan
from mht_slam.models import ObservationModel

FRAME_SIGMA = 1e-4
"""Deviation of the first pose from the origin, and of the first step from one baseline."""
STILL_SIGMA = 1e-3
"""How far a robot that stands still moves, in the model's unit, and turns, radians."""
RESTART_SIGMA = 1.0
"""Standard deviation of ln(step / step before) across a standstill."""
ANY_ANGLE = math.pi / math.sqrt(3.0)
"""Standard deviation of an angle that may be anything."""
ZERO_SIGMA = 1e-4
"""What a sigma of zero means here: radians, baselines."""
TURNS = np.linspace(-2.5, 2.5, 13)
"""Turns tried, in standard deviations."""
CHANGES = np.array([-1.2, 0.0, 1.2])
"""Step lengths tried where the last one tells roughly, in standard deviations of ln s."""
ANY_CHANGE = np.linspace(-2.5, 2.5, 31)
"""Step lengths tried where nothing tells."""


@dataclass(frozen=True, eq=False)
class Step:
    """The factor of the step before a scan, as `motion_terms` takes it.

    Attributes
    ----------
    kind : of `mht_slam.incremental.motion_terms`.
    parameters : (12,).
    """

    kind: int
    parameters: FloatArray


@dataclass(frozen=True, eq=False)
class Proposals:
    """Motions from the last pose, in its frame, that cover what the motion model expects.

    Attributes
    ----------
    motions : (G, 3) forward, leftward, turn.
    log_prior : (G,) of each, up to a constant.
    turn_spread : deviation in heading, radians, that a motion stands for: half the spacing.
    side_spreads : (G,) deviation in position.
    """

    motions: FloatArray
    log_prior: FloatArray
    turn_spread: float
    side_spreads: FloatArray


def frame_step(heading_sigma: float = 0.0) -> Step:
    """Return the made-up step that leads to the first pose, which carries the frame.

    `heading_sigma` is the deviation of the first heading from the frame's x axis, where that is the
    line of a straight run.
    """
    parameters = np.zeros(N_PARAMETERS)
    parameters[0] = 1.0
    sigmas = np.array([FRAME_SIGMA, FRAME_SIGMA, max(heading_sigma, FRAME_SIGMA)])
    parameters[3:12] = np.diag(1.0 / sigmas).ravel()
    return Step(ODOMETRY, parameters)


def next_step(
    model: ObservationModel, scan: BearingScan, number: int, still: bool, moved: float | None
) -> Step:
    """Return the step before scan `number`, the second one or a later one.

    Parameters
    ----------
    still : whether the bearings say that the robot did not move.
    moved : length of the last step that was one, where the step before was a standstill; else None.

    Raises `MeasurementError` where odometry is needed and missing, or out of all proportion.
    """
    parameters = np.zeros(N_PARAMETERS)
    if model.motion == "odometry":
        odometry = scan.odometry
        if odometry is None or odometry.covariance is None:
            raise MeasurementError(
                f"scan {number} has no odometry with a covariance: motion 'odometry' needs one in "
                "every scan but the first"
            )
        spreads = np.sqrt(np.linalg.eigvalsh(odometry.covariance))
        far = math.hypot(odometry.dx, odometry.dy)
        if not (far <= LONGEST and spreads[0] >= SHORTEST and spreads[2] <= LONGEST):
            raise MeasurementError(
                f"scan {number} has odometry of {far:.3g} m with deviations from {spreads[0]:.3g} "
                f"to {spreads[2]:.3g}: steps end at {LONGEST:g} m, deviations begin at "
                f"{SHORTEST:g} and end at {LONGEST:g}; check the units"
            )
        parameters[:3] = odometry.dx, odometry.dy, odometry.dtheta
        parameters[3:12] = np.linalg.inv(np.linalg.cholesky(odometry.covariance)).ravel()
        return Step(ODOMETRY, parameters)
    if still:
        parameters[:2] = STILL_SIGMA
        return Step(STILL, parameters)
    first = number == 1
    change = FRAME_SIGMA if first else model.log_step_sigma
    if model.motion == "smooth":
        parameters[:3] = model.turn_sigma, model.drift_sigma, model.step_change_sigma
        if first:
            parameters[2] = FRAME_SIGMA
        elif moved is not None:
            parameters[2], parameters[3] = RESTART_SIGMA, math.log(max(moved, SHORTEST))
            return Step(RESTART, parameters)
        return Step(SMOOTH, parameters)
    mean = 0.0 if first else model.log_step_mean
    if model.motion == "straight":
        heading = max(model.heading_sigma, ZERO_SIGMA)
        parameters[:4] = heading, max(model.lateral_sigma, ZERO_SIGMA), change, mean
        return Step(STRAIGHT, parameters)
    parameters[:4] = ANY_ANGLE, ANY_ANGLE, change, mean
    return Step(FREE, parameters)


def propose(step: Step, poses: FloatArray) -> Proposals:
    """Return motions from the last of (p, 3) poses, p >= 2."""
    p = step.parameters
    if step.kind == STILL:
        return Proposals(np.zeros((1, 3)), np.zeros(1), float(p[1]), np.full(1, p[0]))
    if step.kind == ODOMETRY:
        root = np.linalg.inv(p[3:12].reshape(3, 3))
        covariance = root @ root.T
        turns = p[2] + math.sqrt(covariance[2, 2]) * TURNS
        # Where the heading is off, so is the place, as far as the odometer couples them.
        coupled = covariance[:2, 2] / math.sqrt(covariance[2, 2])
        places = p[:2] + TURNS[:, None] * coupled
        side = math.sqrt(max(float(np.trace(covariance[:2, :2])) - float(coupled @ coupled), 0.0))
        return Proposals(
            motions=np.column_stack([places, turns]),
            log_prior=-0.5 * TURNS**2,
            turn_spread=float(turns[1] - turns[0]) / 2.0,
            side_spreads=np.full(len(turns), side),
        )
    here = poses[-1]
    if step.kind == STRAIGHT:
        turns, directions, spread = p[0] * TURNS - here[2], np.array([-here[2]]), p[0]
        drift = 0.0
    elif step.kind == FREE:
        directions = turns = np.linspace(-np.pi, np.pi, 24, endpoint=False)
        spread, drift = p[0], float(directions[1] - directions[0]) / math.sqrt(3.0)
    else:
        turns, directions, spread, drift = p[0] * TURNS, np.zeros(1), p[0], float(p[1])
    mean = float(p[3])
    if step.kind == SMOOTH:
        mean = math.log(max(math.dist(poses[-1, :2], poses[-2, :2]), SHORTEST))
    changes = CHANGES if step.kind == SMOOTH else ANY_CHANGE
    if p[2] <= FRAME_SIGMA:
        changes = np.zeros(1)
    lengths = np.exp(np.clip(mean + p[2] * changes, math.log(SHORTEST), math.log(LONGEST)))
    direction, turn, change = np.meshgrid(directions, turns, np.arange(len(lengths)), indexing="ij")
    length = lengths[change]
    motions = np.stack([length * np.cos(direction), length * np.sin(direction), turn], axis=-1)
    away = turn + here[2] if step.kind == STRAIGHT else turn
    aside = direction / p[1] if step.kind == FREE else np.zeros_like(direction)
    along = p[2] * (float(changes[1] - changes[0]) / 2.0 if len(changes) > 1 else 1.0)
    return Proposals(
        motions=motions.reshape(-1, 3),
        log_prior=-0.5 * ((away / spread) ** 2 + aside**2 + changes[change] ** 2).ravel(),
        turn_spread=float(turns[1] - turns[0]) / 2.0,
        side_spreads=(length * math.hypot(drift, along)).ravel(),
    )
