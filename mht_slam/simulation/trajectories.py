"""Where the robot goes: poses of straight, nearly straight and free runs.

Poses are (m, 3) arrays x, y, theta: baselines and radians. A run has its own frame, O1 = (0, 0)
and O2 = (1, 0); headings are measured from the direction of travel O1 -> O2.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mht_slam.arrays import FloatArray, finite_array, finite_number, whole_number
from mht_slam.errors import OptionError
from mht_slam.measurements import wrap_angle


def straight(steps: npt.ArrayLike) -> FloatArray:
    """Poses of a straight run with a common heading (docs/method.md, section 2).

    `steps` are the m - 2 steps |O_k O_k+1| after the first one, in baselines, positive. Returns
    (m, 3) with y and theta zero. Raises `OptionError` for a step that is none.
    """
    lengths = _validated_steps(steps)
    poses = np.zeros((len(lengths) + 2, 3))
    poses[1:, 0] = np.cumsum([1.0, *lengths])
    return poses


def nearly_straight(
    steps: npt.ArrayLike,
    rng: np.random.Generator,
    *,
    heading_sigma: float = 0.0,
    lateral_sigma: float = 0.0,
) -> FloatArray:
    """Poses of a run whose headings wander and whose later points leave the line, (m, 3).

    Every heading, the first included, is N(0, heading_sigma) radians; the points from the third
    on lie N(0, lateral_sigma) baselines beside the line through O1 and O2. O1 and O2 are exact,
    since they define the frame.
    """
    finite_number(heading_sigma, "heading_sigma", at_least=0.0)
    finite_number(lateral_sigma, "lateral_sigma", at_least=0.0)
    poses = straight(steps)
    poses[2:, 1] = lateral_sigma * rng.standard_normal(len(poses) - 2)
    poses[:, 2] = wrap_angle(heading_sigma * rng.standard_normal(len(poses)))
    return poses


def smooth(
    n_scans: int,
    rng: np.random.Generator,
    *,
    turn_sigma: float,
    drift_sigma: float,
    step_change_sigma: float,
) -> FloatArray:
    """Poses whose every motion resembles the one before, (n_scans, 3): the ``smooth`` motion model.

    Headings change by N(0, turn_sigma) from scan to scan; a step leaves the heading at its start
    by N(0, drift_sigma); steps are |O1 O2| = 1 and then walk, ln(next / step) ~
    N(0, step_change_sigma). O1 and O2 are exact, since they define the frame. Angles in radians.
    """
    whole_number(n_scans, "n_scans", at_least=2)
    finite_number(turn_sigma, "turn_sigma", at_least=0.0)
    finite_number(drift_sigma, "drift_sigma", at_least=0.0)
    finite_number(step_change_sigma, "step_change_sigma", at_least=0.0)
    turns = turn_sigma * rng.standard_normal(n_scans - 1)
    drifts = drift_sigma * rng.standard_normal(n_scans - 1)
    changes = step_change_sigma * rng.standard_normal(n_scans - 2)
    headings = np.concatenate([[0.0], np.cumsum(turns)]) - drifts[0]
    directions = headings[:-1] + drifts
    lengths = np.exp(np.concatenate([[0.0], np.cumsum(changes)]))
    moves = lengths[:, None] * np.column_stack([np.cos(directions), np.sin(directions)])
    points = np.vstack([np.zeros((1, 2)), np.cumsum(moves, axis=0)])
    return np.column_stack([points, wrap_angle(headings)])


def draw_steps(
    n_steps: int, rng: np.random.Generator, *, log_mean: float = 0.0, log_sigma: float = 1.0
) -> FloatArray:
    """Draw log-normal steps in baselines: ln(step) ~ N(log_mean, log_sigma), (n_steps,)."""
    whole_number(n_steps, "n_steps", at_least=0)
    finite_number(log_mean, "log_mean")
    finite_number(log_sigma, "log_sigma", at_least=0.0)
    return np.exp(rng.normal(log_mean, log_sigma, n_steps))


def free(
    n_scans: int, rng: np.random.Generator, *, step: float = 1.0, turn_sigma: float = 0.5
) -> FloatArray:
    """Poses of a free run, (n_scans, 3), from the origin: turn by N(0, turn_sigma), then go ahead.

    Steps are uniform between half and one and a half times `step`; the robot looks where it
    has just gone.
    """
    whole_number(n_scans, "n_scans", at_least=1)
    finite_number(step, "step", above=0.0)
    finite_number(turn_sigma, "turn_sigma", at_least=0.0)
    turns = turn_sigma * rng.standard_normal(n_scans - 1)
    lengths = step * rng.uniform(0.5, 1.5, n_scans - 1)
    headings = np.concatenate([[0.0], np.cumsum(turns)])
    moves = lengths[:, None] * np.column_stack([np.cos(headings[1:]), np.sin(headings[1:])])
    points = np.vstack([np.zeros((1, 2)), np.cumsum(moves, axis=0)])
    return np.column_stack([points, wrap_angle(headings)])


def _validated_steps(steps: npt.ArrayLike) -> FloatArray:
    lengths = finite_array(steps, "steps", OptionError, remedy="give lengths in baselines")
    if lengths.ndim != 1:
        raise OptionError(f"steps has shape {lengths.shape}: give one dimension")
    bad = np.flatnonzero(lengths <= 0.0)
    if len(bad):
        raise OptionError(f"steps[{bad[0]}] is {lengths[bad[0]]}: a run's steps are above zero")
    return lengths
