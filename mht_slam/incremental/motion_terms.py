"""Whitened residuals of one step of the robot, with their derivatives, for every motion model."""

from __future__ import annotations

import math

from mht_slam.arrays import FloatArray
from mht_slam.compiled import compiled

ODOMETRY, SMOOTH, RESTART, STILL, STRAIGHT, FREE = 0, 1, 2, 3, 4, 5
"""Kinds of step; `RESTART` is a smooth step after a standstill, from whose length none is known."""
N_PARAMETERS = 12
"""Length of a step's row of parameters, whatever its kind."""
SHORTEST, LONGEST = 1e-9, 1e9
"""Lengths between which steps are told apart, in the model's unit: doubles hold no more."""


@compiled
def wrapped(angle: float) -> float:
    """Return the angle moved by whole turns into [-pi, pi)."""
    if -math.pi <= angle < math.pi:
        return angle
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@compiled
def motion_terms(
    kind: int,
    parameters: FloatArray,
    before: FloatArray,
    here: FloatArray,
    there: FloatArray,
    residual: FloatArray,
    jacobian: FloatArray,
) -> float:
    """Fill the residual (3,) of a step and its derivatives (3, 9) by three consecutive poses.

    A residual is unit Gaussian. By kind, with the step of length s and direction phi in the frame
    of the pose that it leaves, and `parameters` in brackets:

    - odometry: W (dx - [0], dy - [1], dtheta - [2]), W the (3, 3) whitening in [3:12];
    - smooth: turn / [0], phi / [1], ln(s / step before) / [2];
    - restart: turn / [0], phi / [1], (ln s - [3]) / [2];
    - still: (dx, dy) / [0] and turn / [1];
    - straight: heading / [0], y / [1], (ln s - [3]) / [2];
    - free: as restart.

    Returns the log of the volume that takes the density to one over (x, y, theta): a density over
    ln s and an angle is divided by s^2, one over ln s alone by s.

    Source: docs/method.md, section 4; the factors of `mht_slam.factors.motion`.
    """
    jacobian[:, :] = 0.0
    dx, dy = there[0] - here[0], there[1] - here[1]
    turn = wrapped(there[2] - here[2])
    if kind == ODOMETRY:
        c, s = math.cos(here[2]), math.sin(here[2])
        forward, left = c * dx + s * dy, -s * dx + c * dy
        raw = (
            forward - parameters[0],
            left - parameters[1],
            wrapped(turn - parameters[2]),
        )
        for i in range(3):
            w0, w1, w2 = parameters[3 + 3 * i], parameters[4 + 3 * i], parameters[5 + 3 * i]
            residual[i] = w0 * raw[0] + w1 * raw[1] + w2 * raw[2]
            jacobian[i, 6] = w0 * c - w1 * s
            jacobian[i, 7] = w0 * s + w1 * c
            jacobian[i, 8] = w2
            jacobian[i, 3] = -jacobian[i, 6]
            jacobian[i, 4] = -jacobian[i, 7]
            jacobian[i, 5] = w0 * left - w1 * forward - w2
        return 0.0
    if kind == STILL:
        residual[0], residual[1] = dx / parameters[0], dy / parameters[0]
        residual[2] = turn / parameters[1]
        for i in range(3):
            slope = 1.0 / (parameters[0] if i < 2 else parameters[1])
            jacobian[i, 3 + i], jacobian[i, 6 + i] = -slope, slope
        return 0.0
    squared = max(dx * dx + dy * dy, SHORTEST * SHORTEST)
    log_step = 0.5 * math.log(squared)
    along_x, along_y = dx / squared, dy / squared
    residual[2] = (log_step - parameters[3]) / parameters[2]
    jacobian[2, 6], jacobian[2, 7] = along_x / parameters[2], along_y / parameters[2]
    jacobian[2, 3], jacobian[2, 4] = -jacobian[2, 6], -jacobian[2, 7]
    if kind == STRAIGHT:
        residual[0], residual[1] = wrapped(there[2]) / parameters[0], there[1] / parameters[1]
        jacobian[0, 8], jacobian[1, 7] = 1.0 / parameters[0], 1.0 / parameters[1]
        return -log_step
    residual[0] = turn / parameters[0]
    jacobian[0, 5], jacobian[0, 8] = -1.0 / parameters[0], 1.0 / parameters[0]
    residual[1] = wrapped(math.atan2(dy, dx) - here[2]) / parameters[1]
    jacobian[1, 6], jacobian[1, 7] = -along_y / parameters[1], along_x / parameters[1]
    jacobian[1, 3], jacobian[1, 4] = -jacobian[1, 6], -jacobian[1, 7]
    jacobian[1, 5] = -1.0 / parameters[1]
    if kind == SMOOTH:
        ox, oy = here[0] - before[0], here[1] - before[1]
        old = max(ox * ox + oy * oy, SHORTEST * SHORTEST)
        residual[2] = (log_step - 0.5 * math.log(old)) / parameters[2]
        jacobian[2, 0], jacobian[2, 1] = ox / old / parameters[2], oy / old / parameters[2]
        jacobian[2, 3] -= jacobian[2, 0]
        jacobian[2, 4] -= jacobian[2, 1]
    return -2.0 * log_step
