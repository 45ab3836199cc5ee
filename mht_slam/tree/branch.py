"""One association of the scans so far with its graph, its estimate and its score."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from mht_slam import factors
from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.evidence.visibility import sightlines
from mht_slam.graph.log_range import optimise_in_log_range
from mht_slam.graph.motion import log_density_outside, motion_factors
from mht_slam.graph.problem import Problem
from mht_slam.graph.residuals import ranges_and_residuals
from mht_slam.graph.solve import NEAREST_RANGE
from mht_slam.measurements import wrap_angle
from mht_slam.tree.pattern import log_pattern
from mht_slam.tree.setting import Setting


@dataclass(frozen=True, eq=False)
class Branch:
    """An association of the first k scans, solved.

    Attributes
    ----------
    landmarks : (n,) numbers of the landmarks seen twice or more, increasing.
    table : (n, k) their detections.
    singles : (s, 2) scan and detection of those in no row: landmarks seen once, or false alarms.
    graph, values, log_normaliser : the factors, the optimum, and the sum of normalisers.
    poses : (k, 3); points : (n, 2).
    covariance : (2 n + 3, 2 n + 3) of the points and the last pose, the latter in its own frame.
    log_score : evidence of the graph and of the pattern of detections.
    """

    landmarks: IntArray
    table: IntArray
    singles: IntArray
    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    log_normaliser: float
    poses: FloatArray
    points: FloatArray
    covariance: FloatArray
    log_score: float

    @property
    def seen(self) -> BoolArray:
        """(n, k) whether a scan sees a landmark."""
        return np.asarray(self.table != MISSED)


def _parameters() -> gtsam.LevenbergMarquardtParams:
    parameters = gtsam.LevenbergMarquardtParams.CeresDefaults()
    parameters.setRelativeErrorTol(1e-4)
    parameters.setAbsoluteErrorTol(1e-3)
    return parameters


PARAMETERS = _parameters()
"""Diagonal damping, and an end where a step gains less than a thousandth of a nat."""
MAX_ROUNDS = 8
SETTLED = 0.02
"""Change of a landmark's log range below which the linearised volumes are taken as exact."""


class LostError(ArithmeticError):
    """A branch whose graph has no usable optimum."""


def first_branch(setting: Setting) -> Branch:
    """Return the branch of the first scan: every detection on its own."""
    count = len(setting.problem.scans[0])
    graph = gtsam.NonlinearFactorGraph()
    values = gtsam.Values()
    values.insert(X(0), gtsam.Pose2())
    return Branch(
        landmarks=np.empty(0, np.int64),
        table=np.empty((0, 1), np.int64),
        singles=np.stack([np.zeros(count, np.int64), np.arange(count)], axis=1),
        graph=graph,
        values=values,
        log_normaliser=0.0,
        poses=np.zeros((1, 3)),
        points=np.empty((0, 2)),
        covariance=np.zeros((3, 3)),
        log_score=0.0,
    )


def extend(
    setting: Setting,
    parent: Branch,
    motion: FloatArray,
    of_landmarks: Sequence[tuple[int, int]],
    of_singles: Sequence[tuple[int, int]],
) -> Branch:
    """Add the next scan and solve from the parent's estimate.

    Parameters
    ----------
    motion : (3,) forward, leftward, turn from the last pose: where the optimiser starts.
    of_landmarks : (row, detection) pairs.
    of_singles : (index among the parent's singles, detection) pairs: each becomes a landmark.

    Raises `LostError` where the optimiser ends nowhere.
    """
    try:
        return _extended(setting, parent, motion, of_landmarks, of_singles)
    except (ArithmeticError, ValueError) as cause:  # numbers beyond floats, in whatever formula
        raise LostError(str(cause)) from cause


def _extended(
    setting: Setting,
    parent: Branch,
    motion: FloatArray,
    of_landmarks: Sequence[tuple[int, int]],
    of_singles: Sequence[tuple[int, int]],
) -> Branch:
    k = len(parent.poses)
    pose = _moved(parent.poses[-1], motion)
    values = gtsam.Values(parent.values)
    values.insert(X(k), gtsam.Pose2(*pose.tolist()))
    poses = np.concatenate([parent.poses, pose[None]])
    graph = gtsam.NonlinearFactorGraph(parent.graph)
    log_normaliser = parent.log_normaliser
    for factor in newest_motion_factors(setting.problem, poses):
        graph.push_back(factor)
        log_normaliser += factors.log_normaliser(factor)

    rows = [*parent.table.tolist()]
    landmarks = [*parent.landmarks.tolist()]
    columns = [MISSED] * len(rows)
    new: list[tuple[gtsam.NonlinearFactor, float]] = []
    for row, detection in of_landmarks:
        columns[row] = detection
        new.append(setting.pool.bearing(landmarks[row], k, detection))
    paired = set()
    for index, detection in of_singles:
        scan, other = parent.singles[index].tolist()
        number = setting.number(scan, other)
        rows.append([other if i == scan else MISSED for i in range(k)])
        columns.append(detection)
        landmarks.append(number)
        paired.add(index)
        point = triangulated(setting, poses, (scan, other), (k, detection))
        values.insert(L(number), point)
        new.append(setting.pool.prior(number))
        new.append(setting.pool.bearing(number, scan, other))
        new.append(setting.pool.bearing(number, k, detection))
    for factor, normaliser in new:
        graph.push_back(factor)
        log_normaliser += normaliser

    used = {detection for _, detection in (*of_landmarks, *of_singles)}
    kept = [s for i, s in enumerate(parent.singles.tolist()) if i not in paired]
    fresh = [[k, d] for d in range(len(setting.problem.scans[k])) if d not in used]
    order = np.argsort(np.array(landmarks, dtype=np.int64))
    table = np.array(
        [[*row, column] for row, column in zip(rows, columns, strict=True)], dtype=np.int64
    ).reshape(-1, k + 1)
    return solved(
        setting,
        landmarks=np.array(landmarks, dtype=np.int64)[order],
        table=table[order],
        singles=np.array([*kept, *fresh], dtype=np.int64).reshape(-1, 2),
        graph=graph,
        values=values,
        log_normaliser=log_normaliser,
    )


def anew(
    setting: Setting, table: IntArray, singles: IntArray, poses: FloatArray, points: FloatArray
) -> Branch:
    """Solve an association from a given start, with every factor linearised there.

    Parameters
    ----------
    table : (n, k) landmarks seen twice or more, no two with the same first detection.
    singles : (s, 2) scan and detection of the others.
    poses, points : (k, 3) and (n, 2) to start from.

    The motion factors of a branch that grew scan by scan were linearised when its scans came;
    here the optimum is sought again until they stand still. Raises `LostError`.
    """
    try:
        with np.errstate(all="ignore"):
            return _anew(setting, table, singles, poses, points)
    except (ArithmeticError, ValueError) as cause:  # numbers beyond floats, in whatever formula
        raise LostError(str(cause)) from cause


def _anew(
    setting: Setting, table: IntArray, singles: IntArray, poses: FloatArray, points: FloatArray
) -> Branch:
    k = table.shape[1]
    problem = setting.problem.part(0, k)
    first = (table != MISSED).argmax(axis=1)
    numbers = np.array(
        [setting.number(int(a), int(row[a])) for a, row in zip(first, table, strict=True)],
        dtype=np.int64,
    )
    order = np.argsort(numbers)
    table, numbers, points = table[order], numbers[order], points[order]
    measured = gtsam.NonlinearFactorGraph()
    measured_normaliser = 0.0
    for row, number in zip(table.tolist(), numbers.tolist(), strict=True):
        parts = [setting.pool.prior(number)]
        parts += [setting.pool.bearing(number, i, d) for i, d in enumerate(row) if d != MISSED]
        for factor, normaliser in parts:
            measured.push_back(factor)
            measured_normaliser += normaliser
    keys = tuple(X(i) for i in range(k))
    for _ in range(MAX_ROUNDS):
        graph = gtsam.NonlinearFactorGraph(measured)
        log_normaliser = measured_normaliser
        for factor in motion_factors(problem, keys, poses):
            graph.push_back(factor)
            log_normaliser += factors.log_normaliser(factor)
        values = gtsam.Values()
        for key, (x, y, theta) in zip(keys, poses.tolist(), strict=True):
            values.insert(key, gtsam.Pose2(x, y, theta))
        for number, point in zip(numbers.tolist(), points, strict=True):
            values.insert(L(number), point)
        branch = solved(
            setting,
            landmarks=numbers,
            table=table,
            singles=singles,
            graph=graph,
            values=values,
            log_normaliser=log_normaliser,
        )
        before = problem.free_lengths(poses)
        poses, points = branch.poses, branch.points
        if np.abs(problem.free_lengths(poses) / before - 1.0).max(initial=0.0) < SETTLED:
            break
    return branch


def solved(
    setting: Setting,
    *,
    landmarks: IntArray,
    table: IntArray,
    singles: IntArray,
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    log_normaliser: float,
) -> Branch:
    """Optimise a graph and score what comes out; raises `LostError`."""
    k = table.shape[1]
    problem = setting.problem.part(0, k)
    first = (table != MISSED).argmax(axis=1).tolist()
    anchors = [(X(scan), L(n)) for scan, n in zip(first, landmarks.tolist(), strict=True)]
    try:
        values, with_volumes = optimise_in_log_range(
            graph, values, anchors, PARAMETERS, settled=SETTLED, max_rounds=MAX_ROUNDS
        )
        hessian = with_volumes.linearize(values).hessian()[0]
    except (RuntimeError, ValueError) as cause:
        raise LostError(str(cause).strip().splitlines()[0]) from cause
    if not np.isfinite(hessian).all():
        raise LostError("the Hessian is not finite")
    poses = np.array([[p.x(), p.y(), p.theta()] for p in (values.atPose2(X(i)) for i in range(k))])
    points = np.array([values.atPoint2(L(n)) for n in landmarks.tolist()]).reshape(-1, 2)
    bearings = sightlines(poses, points)
    _check(problem, table, poses, points)
    try:
        root = np.linalg.cholesky(hessian)
    except np.linalg.LinAlgError as cause:
        raise LostError("the Hessian is not positive definite") from cause
    size = len(hessian)
    wanted = np.r_[0 : 2 * len(points), size - 3 : size]
    half = np.linalg.solve(root, np.eye(size)[:, wanted])
    log_evidence = (
        log_normaliser
        - graph.error(values)
        + 0.5 * size * math.log(2.0 * math.pi)
        - float(np.log(np.diag(root)).sum())
        + log_density_outside(problem, poses)
    )
    score = log_evidence + log_pattern(setting, poses, table, singles, bearings)
    if not math.isfinite(score):
        raise LostError("its evidence is not finite")
    return Branch(
        landmarks=landmarks,
        table=table,
        singles=singles,
        graph=graph,
        values=values,
        log_normaliser=log_normaliser,
        poses=poses,
        points=points,
        covariance=half.T @ half,
        log_score=score,
    )


def newest_motion_factors(problem: Problem, poses: FloatArray) -> list[gtsam.NonlinearFactor]:
    """Motion factors that the last scan adds; with the second scan, those of both.

    No factor reaches back further than to the step before.
    """
    k = len(poses)
    before = [i for i in problem.moves if i < k - 2]
    start = before[-1] if before and k - 2 in problem.moves else max(0, k - 2)
    keys = tuple(X(i) for i in range(start, k))
    recent = motion_factors(problem.part(start, k), keys, poses[start:])
    return recent if k == 2 else [f for f in recent if keys[-1] in list(f.keys())]


def triangulated(
    setting: Setting, poses: FloatArray, one: tuple[int, int], other: tuple[int, int]
) -> FloatArray:
    """Where two rays meet; far out on the later one where they do not."""
    places, rays = [], []
    for scan, detection in (one, other):
        angle = poses[scan, 2] + setting.problem.scans[scan].bearings[detection]
        places.append(poses[scan, :2])
        rays.append(np.array([math.cos(angle), math.sin(angle)]))
    sine = rays[0][0] * rays[1][1] - rays[0][1] * rays[1][0]
    baseline = places[1] - places[0]
    farthest = setting.problem.model.landmark_sigma
    distance = farthest
    if abs(sine) > 1e-9:
        distance = float(baseline[0] * rays[0][1] - baseline[1] * rays[0][0]) / sine
        if not 0.0 < distance < farthest:
            distance = farthest
    return np.asarray(places[1] + distance * rays[1])


def _check(problem: Problem, table: IntArray, poses: FloatArray, points: FloatArray) -> None:
    if not (np.isfinite(poses).all() and np.isfinite(points).all()):
        raise LostError("the optimiser ended at numbers that are not finite")
    sightings = problem.sightings(table)
    ranges, residuals = ranges_and_residuals(poses, points, sightings.bearings, sightings.seen)
    if (np.abs(residuals) > 0.5 * math.pi).any():
        raise LostError("a landmark ends up on the far side of its bearing")
    if (ranges < NEAREST_RANGE * problem.baseline).any():
        raise LostError("a landmark ends up on an observation point")


def _moved(pose: FloatArray, motion: FloatArray) -> FloatArray:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.array(
        [
            pose[0] + c * motion[0] - s * motion[1],
            pose[1] + s * motion[0] + c * motion[1],
            wrap_angle(float(pose[2] + motion[2])),
        ]
    )
