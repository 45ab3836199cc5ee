"""Where the robot may be at the next scan: a few motions that cover the motion prior."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.graph.problem import Problem
from mht_slam.measurements import wrap_angle

TURNS = np.linspace(-2.5, 2.5, 13)
"""Changes of heading tried, in standard deviations of the prior."""
STEP_CHANGES = np.array([-1.2, 0.0, 1.2])
"""Steps tried where the last one tells roughly, in standard deviations of the prior."""
UNKNOWN_STEPS = np.linspace(-2.5, 2.5, 31)
"""Steps tried where nothing tells, in standard deviations of the prior."""


@dataclass(frozen=True)
class Proposals:
    """Motions from the last pose, in its frame.

    Attributes
    ----------
    motions : (G, 3) forward, leftward, turn.
    log_prior : (G,) of each, up to a constant.
    turn_spread : (G,) deviation in heading, radians, that a motion stands for: half the spacing.
    side_spread : (G,) deviation in position across the motion.
    """

    motions: FloatArray
    log_prior: FloatArray
    turn_spread: float
    side_spread: FloatArray


def propose(problem: Problem, poses: FloatArray) -> Proposals:
    """Return motions to scan k = len(poses) that cover what the motion model expects."""
    model = problem.model
    if model.motion == "odometry":
        return _about_odometry(problem, len(poses))
    first = len(poses) == 1
    last_heading = float(poses[-1, 2])
    if model.motion == "smooth":
        k = len(poses) - 1
        if k not in problem.moves:
            return Proposals(np.zeros((1, 3)), np.zeros(1), 0.0, np.zeros(1))
        turns, side, direction = model.turn_sigma * TURNS, model.drift_sigma, 0.0
        steps, changes = np.array([problem.baseline]), np.zeros(1)
        before = [i for i in problem.moves if i < k]
        if before:
            i = before[-1]
            length = float(np.linalg.norm(poses[i + 1, :2] - poses[i, :2]))
            changes = STEP_CHANGES if i == k - 1 else UNKNOWN_STEPS
            spread = model.step_change_sigma if i == k - 1 else 1.0
            steps = length * np.exp(spread * changes)
    else:
        turns = problem.heading_sigma * TURNS if model.heading_sigma > 0.0 else np.zeros(1)
        turns = turns - last_heading
        side = 0.0
        changes = np.zeros(1) if first else UNKNOWN_STEPS
        steps = (
            np.array([problem.baseline])
            if first
            else np.exp(model.log_step_mean + model.log_step_sigma * changes)
        )
        direction = -last_heading
    turn, step = np.meshgrid(turns, steps, indexing="ij")
    cost = np.add.outer((TURNS if len(turns) > 1 else np.zeros(1)) ** 2, changes**2)
    motions = np.stack(
        [step * math.cos(direction), step * math.sin(direction), turn], axis=-1
    ).reshape(-1, 3)
    spread = float(turns[1] - turns[0]) / 2.0 if len(turns) > 1 else 0.0
    along = 0.5 * float(np.log(steps[1] / steps[0])) if len(steps) > 1 else 0.0
    return Proposals(
        motions=motions,
        log_prior=-0.5 * cost.ravel(),
        turn_spread=spread,
        side_spread=step.ravel() * math.hypot(side, along),
    )


def _about_odometry(problem: Problem, k: int) -> Proposals:
    motion = problem.odometry[k - 1]
    assert motion.covariance is not None  # noqa: S101 - `make_problem` refuses such scans
    sigma = math.sqrt(motion.covariance[2, 2])
    turns = sigma * TURNS
    motions = np.tile([motion.dx, motion.dy, motion.dtheta], (len(turns), 1))
    motions[:, 2] = wrap_angle(motions[:, 2] + turns)
    side = math.sqrt(float(np.trace(motion.covariance[:2, :2])))
    return Proposals(
        motions=motions,
        log_prior=-0.5 * TURNS**2,
        turn_spread=float(turns[1] - turns[0]) / 2.0,
        side_spread=np.full(len(turns), side),
    )
