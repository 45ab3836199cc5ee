"""The directions of a run's unknowns of which its prior says more than its bearings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.graph.problem import Problem

ANY_DIRECTION_SIGMA = math.pi / math.sqrt(3.0)
"""Standard deviation of an angle of which nothing is known, radians."""
LEAST_PRECISION = 2.0
"""How many times more precise than the prior bearings must be to decide a direction.

Above 1, because the estimate is pulled by the prior until both are about equal: a landmark whose
bearings are exactly parallel ends up where its bearings are exactly as precise as its prior,
whatever the noise and the prior.
"""
NEAREST = 1e-9
"""Range, in baselines, below which a landmark's bearing has no derivative."""
LARGEST = 1e100
"""Derivatives beyond this, from sigmas of nothing, are cut here so that squares stay finite."""
TIES = 6
"""Decimals to which two names fit a direction equally well; the first one wins."""


@dataclass(frozen=True)
class PoseCoordinates:
    """Unknowns of the poses with unit normal priors.

    Attributes
    ----------
    names : d names.
    motion : (m, 3, d) derivatives of x, y, theta of every pose.
    """

    names: tuple[str, ...]
    motion: FloatArray


def free_directions(
    problem: Problem,
    table: IntArray,
    poses: FloatArray,
    landmarks: FloatArray,
    scans: Sequence[int],
) -> tuple[str, ...]:
    """Name the directions that the prior decides, the most clearly named first.

    Parameters
    ----------
    problem : the scans, their noise and the model.
    table : (n, m) association table.
    poses : (m, 3) and landmarks : (n, 2), where everything is linearised.
    scans : (m,) what the scans are called in the names.

    In coordinates in which the prior is a unit normal, J holds the derivatives of the bearings
    divided by their noise; its singular values are the precisions of bearings in those of the
    prior. Directions below `LEAST_PRECISION` are free. They span a subspace, which is named axis by
    axis, each time by the name with most of its length in what is left.
    """
    coordinates = pose_coordinates(problem, poses, scans)
    jacobian = whitened_jacobian(problem, table, poses, landmarks, coordinates)
    if jacobian.shape[1] == 0:
        return ()
    values, right = np.linalg.svd(jacobian)[1:]
    precision = np.zeros(len(right))
    precision[: len(values)] = values
    rounding = np.finfo(np.float64).eps * max(jacobian.shape) * precision.max()
    free = right[precision < max(LEAST_PRECISION, rounding)]
    names, axes = _named_axes(problem, table, poses, landmarks, coordinates)
    return _names_of_subspace(free, names, axes)


def pose_coordinates(problem: Problem, poses: FloatArray, scans: Sequence[int]) -> PoseCoordinates:
    """Return coordinates of (m, 3) poses under the problem's motion model, linearised there.

    `scans` names the poses.
    """
    if problem.second_run is not None:
        moves = _moves_of_two_runs(problem, poses, scans)
    elif problem.model.motion == "straight":
        moves = _moves_on_line(problem, poses, scans)
    else:
        moves = _moves_of_chain(problem, poses, scans)
    moves += _moves_of_headings(problem, scans)
    motion = np.zeros((len(poses), 3, len(moves)))
    for d, (_, move) in enumerate(moves):
        motion[:, :, d] = move
    return PoseCoordinates(tuple(name for name, _ in moves), motion)


def whitened_jacobian(
    problem: Problem,
    table: IntArray,
    poses: FloatArray,
    landmarks: FloatArray,
    coordinates: PoseCoordinates,
) -> FloatArray:
    """(N, d + 2 n) derivatives of the bearings by all coordinates, divided by their noise.

    The information of Student's t is (dof + 1) / (dof + 3) of the Gaussian's of its scale.
    """
    rows, columns = np.nonzero(table != MISSED)
    offset = landmarks[rows] - poses[columns, :2]
    # Divided twice: the square of a range of 1e180 baselines is beyond floats.
    reach = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), NEAREST * problem.baseline)[:, None]
    by_landmark = np.column_stack([-offset[:, 1], offset[:, 0]]) / reach / reach
    by_pose = np.column_stack([-by_landmark, np.full(len(rows), -1.0)])
    n_poses = len(coordinates.names)
    jacobian = np.zeros((len(rows), n_poses + 2 * len(landmarks)))
    jacobian[:, :n_poses] = np.einsum("ni,nid->nd", by_pose, coordinates.motion[columns])
    for axis in range(2):
        places = n_poses + 2 * rows + axis
        jacobian[np.arange(len(rows)), places] = problem.model.landmark_sigma * by_landmark[:, axis]
    dof = problem.model.bearing_dof
    share = 1.0 if dof is None else math.sqrt((dof + 1.0) / (dof + 3.0))
    noise = problem.sightings(table).sigmas[rows, columns]
    with np.errstate(over="ignore"):
        return np.clip(share * jacobian / noise[:, None], -LARGEST, LARGEST)


_Moves = list[tuple[str, FloatArray]]
"""Names, and (m, 3) what one standard deviation of the prior does to the poses."""


def _moves_on_line(problem: Problem, poses: FloatArray, scans: Sequence[int]) -> _Moves:
    model, m = problem.model, len(poses)
    moves: _Moves = []
    for a, b in problem.free_steps:
        move = np.zeros((m, 3))
        move[b:, 0] = model.log_step_sigma * (poses[b, 0] - poses[a, 0])
        moves.append((f"step from scan {scans[a]} to scan {scans[b]}", move))
    if model.lateral_sigma > 0.0:
        for k in range(2, m):
            move = np.zeros((m, 3))
            move[k, 1] = model.lateral_sigma
            moves.append((f"lateral position of scan {scans[k]}", move))
    return moves


def _moves_of_two_runs(problem: Problem, poses: FloatArray, scans: Sequence[int]) -> _Moves:
    """The second run is moved along x and y, turned about O3, and stretched."""
    place_x, place_y, turned, stretched = np.zeros((4, 4, 3))
    place_x[2:, 0] = place_y[2:, 1] = problem.model.landmark_sigma
    step = poses[3, :2] - poses[2, :2]
    turned[3, :2] = ANY_DIRECTION_SIGMA * np.array([-step[1], step[0]])
    turned[2:, 2] = ANY_DIRECTION_SIGMA
    stretched[3, :2] = problem.model.log_step_sigma * step
    return [
        ("x of the second run", place_x),
        ("y of the second run", place_y),
        ("direction of the second run", turned),
        (f"step from scan {scans[2]} to scan {scans[3]}", stretched),
    ]


def _moves_of_headings(problem: Problem, scans: Sequence[int]) -> _Moves:
    """Deviations of single headings from the line."""
    on_lines = problem.second_run is not None or problem.model.motion == "straight"
    if not on_lines or problem.model.heading_sigma == 0.0:
        return []
    moves: _Moves = []
    for k, scan in enumerate(scans):
        move = np.zeros((len(scans), 3))
        move[k, 2] = problem.model.heading_sigma
        moves.append((f"heading of scan {scan}", move))
    return moves


def _moves_of_chain(problem: Problem, poses: FloatArray, scans: Sequence[int]) -> _Moves:
    """Poses that follow each other; the first step is the unit and the x axis."""
    match problem.model.motion:
        case "smooth":
            return _moves_of_smooth_run(problem, poses, scans)
        case "free":
            return _moves_of_free_run(problem, poses, scans)
        case _:
            return _moves_of_odometry(problem, poses, scans)


def _moves_of_smooth_run(problem: Problem, poses: FloatArray, scans: Sequence[int]) -> _Moves:
    model, m = problem.model, len(poses)
    moves: _Moves = []
    for k in range(m - 1):
        lengths, directions, headings = np.zeros(m - 1), np.zeros(m - 1), np.zeros(m)
        if k == 0:  # the first step keeps its direction, so everything else turns back
            directions[1:] = headings[:] = -model.drift_sigma
        else:
            directions[k] = model.drift_sigma
        move = _moved_chain(poses, lengths, directions, headings)
        moves.append((f"drift from scan {scans[k]} to scan {scans[k + 1]}", move))
    for k in range(m - 1):
        lengths, directions, headings = np.zeros(m - 1), np.zeros(m - 1), np.zeros(m)
        directions[k + 1 :] = headings[k + 1 :] = model.turn_sigma
        move = _moved_chain(poses, lengths, directions, headings)
        moves.append((f"turn from scan {scans[k]} to scan {scans[k + 1]}", move))
    for k in range(1, m - 1):
        lengths, directions, headings = np.zeros(m - 1), np.zeros(m - 1), np.zeros(m)
        lengths[k:] = model.step_change_sigma
        move = _moved_chain(poses, lengths, directions, headings)
        moves.append((f"change of step at scan {scans[k]}", move))
    return moves


def _moves_of_free_run(problem: Problem, poses: FloatArray, scans: Sequence[int]) -> _Moves:
    m = len(poses)
    moves: _Moves = []
    for k in range(1, m - 1):
        of_step = f"step from scan {scans[k]} to scan {scans[k + 1]}"
        lengths, directions = np.zeros(m - 1), np.zeros(m - 1)
        lengths[k] = problem.model.log_step_sigma
        moves.append((of_step, _moved_chain(poses, lengths, directions, np.zeros(m))))
        lengths, directions = np.zeros(m - 1), np.zeros(m - 1)
        directions[k] = ANY_DIRECTION_SIGMA
        move = _moved_chain(poses, lengths, directions, np.zeros(m))
        moves.append((f"direction of the {of_step}", move))
    for k in range(m):
        headings = np.zeros(m)
        headings[k] = ANY_DIRECTION_SIGMA
        move = _moved_chain(poses, np.zeros(m - 1), np.zeros(m - 1), headings)
        moves.append((f"heading of scan {scans[k]}", move))
    return moves


def _moves_of_odometry(problem: Problem, poses: FloatArray, scans: Sequence[int]) -> _Moves:
    """One standard deviation along each principal axis of every motion's covariance."""
    moves: _Moves = []
    for k, odometry in enumerate(problem.odometry):
        assert odometry.covariance is not None  # noqa: S101 - checked when the problem was made
        cosine, sine = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        turned = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        errors = turned @ np.linalg.cholesky(odometry.covariance)
        after = poses[k + 1 :, :2] - poses[k + 1, :2]
        for axis, error in zip(("forward", "sideways", "turning"), errors.T, strict=True):
            move = np.zeros((len(poses), 3))
            move[k + 1 :] = error
            move[k + 1 :, :2] += error[2] * np.column_stack([-after[:, 1], after[:, 0]])
            moves.append((f"{axis} motion from scan {scans[k]} to scan {scans[k + 1]}", move))
    return moves


def _moved_chain(
    poses: FloatArray, log_lengths: FloatArray, directions: FloatArray, headings: FloatArray
) -> FloatArray:
    """(m, 3) motion of the poses when steps are stretched and turned, and headings turned."""
    steps = np.diff(poses[:, :2], axis=0)
    beside = np.column_stack([-steps[:, 1], steps[:, 0]])
    moved = np.zeros((len(poses), 3))
    moved[1:, :2] = np.cumsum(log_lengths[:, None] * steps + directions[:, None] * beside, axis=0)
    moved[:, 2] = headings
    return moved


def _named_axes(
    problem: Problem,
    table: IntArray,
    poses: FloatArray,
    landmarks: FloatArray,
    coordinates: PoseCoordinates,
) -> tuple[list[str], FloatArray]:
    """Names, and (names, d + 2 n) unit vectors: what moves together first, then each alone."""
    n_poses, n = len(coordinates.names), len(landmarks)
    names: list[str] = []
    axes: list[FloatArray] = []
    turned = np.zeros(poses.shape)
    turned[:, 2] = 1.0
    stretched = np.zeros(poses.shape)
    stretched[:, :2] = poses[:, :2] - poses[1, :2]
    stretched[0] = 0.0
    outwards = (landmarks - poses[1, :2]) / problem.model.landmark_sigma
    for name, target, moved in (
        ("common heading", turned, np.zeros((n, 2))),
        ("scale after the first step", stretched, outwards),
    ):
        weights = _weights_of(target, coordinates)
        if weights is not None:
            names.append(name)
            axes.append(_unit(np.concatenate([weights, moved.ravel()])))
    for d, name in enumerate(coordinates.names):
        names.append(name)
        axes.append(np.eye(n_poses + 2 * n)[d])
    for row in range(n):
        seen = poses[table[row] != MISSED, :2]
        away = _unit(landmarks[row] - seen.mean(axis=0))
        for name, direction in (
            (f"distance of landmark {row}", away),
            (f"direction of landmark {row}", np.array([-away[1], away[0]])),
        ):
            axis = np.zeros(n_poses + 2 * n)
            axis[n_poses + 2 * row : n_poses + 2 * row + 2] = direction
            names.append(name)
            axes.append(axis)
    return names, np.array(axes)


def _weights_of(target: FloatArray, coordinates: PoseCoordinates) -> FloatArray | None:
    """(d,) weights of the coordinates that move the poses by `target`; None where none do."""
    motion = coordinates.motion.reshape(-1, len(coordinates.names))
    weights = np.asarray(np.linalg.lstsq(motion, target.ravel())[0], dtype=np.float64)
    if np.count_nonzero(np.abs(weights) > 1e-6 * np.abs(weights).max(initial=0.0)) < 2:
        return None
    reached = motion @ weights
    exact = np.linalg.norm(reached - target.ravel()) <= 1e-6 * np.linalg.norm(target)
    return weights if exact else None


def _names_of_subspace(free: FloatArray, names: list[str], axes: FloatArray) -> tuple[str, ...]:
    """Name the (k, d) orthonormal rows by k of the unit vectors, `axes`."""
    chosen: list[str] = []
    while len(free):
        parts = axes @ free.T
        best = int(np.round((parts**2).sum(axis=1), TIES).argmax())
        chosen.append(names[best])
        # What is left of the subspace once the part along that name is taken out.
        free = np.linalg.svd(parts[best][None])[2][1:] @ free
    return tuple(chosen)


def _unit(vector: FloatArray) -> FloatArray:
    length = math.hypot(*vector)  # which squares nothing beyond floats
    return vector / length if length > 0.0 else np.eye(len(vector))[0]
