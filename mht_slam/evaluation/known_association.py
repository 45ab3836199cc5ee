"""The graph of a drive whose association is given: the ceiling of maps and trajectories."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from mht_slam import factors
from mht_slam.arrays import FloatArray, IntArray, freeze
from mht_slam.association import MISSED, Association
from mht_slam.errors import NoEstimateError, OptionError
from mht_slam.graph.refine import refine
from mht_slam.measurements import BearingScan, Odometry, StraightRun, wrap_angle
from mht_slam.models import ObservationModel

PARALLAX = math.radians(3.0)
"""Change of direction over which a landmark has to be seen to get a position."""
START_SIGMA = 1e-3
"""Metres and radians within which the first pose is held at the origin."""


@dataclass(frozen=True)
class DriveEstimate:
    """Poses and landmarks of an association.

    Attributes
    ----------
    poses : (m, 3) x, y and theta of the scans, the first near the origin.
    landmarks : (n, 2) positions, in the frame of the poses.
    rows : (n,) row of the association's table that each landmark is; a landmark without enough
        parallax has no position and is not listed.
    """

    poses: FloatArray
    landmarks: FloatArray
    rows: IntArray


def known_association(
    scans: Sequence[BearingScan], association: Association, model: ObservationModel
) -> DriveEstimate:
    """Return poses and landmarks of a drive, given its association.

    With the true association this is the best that the same graph can make of a drive: the ceiling
    for maps and trajectories.

    Parameters
    ----------
    scans : m scans, with odometry and its covariance where the motion is ``odometry``.
    association : over all of them; detections of no landmark are left out.
    model : `sigma`, `bearing_dof`, `landmark_sigma` and the motion. With ``odometry`` the unit is
        the metre, and `landmark_sigma` is about where the robot was when it first saw the landmark.
        With other motions `refine` solves the graph, in first steps.

    With odometry the graph grows scan by scan (`DriveGraph`) and is optimised as a whole at the
    end: started from dead reckoning it would end in a poor local minimum on a long drive with heavy
    tails (docs/method.md, section 5).

    Raises `OptionError` for a scan without odometry, `NoEstimateError` where there is no solution.
    """
    if model.motion != "odometry":
        return _refined(scans, association, model)
    graph = DriveGraph(model)
    for scan, rows in zip(scans, association.landmark_of_detection(), strict=True):
        graph.update(scan, rows)
    return graph.optimised()


class DriveGraph:
    """A graph that grows scan by scan, with odometry, and detections whose landmark is given.

    GTSAM's ISAM2 keeps its estimate. A landmark enters with all its detections once it was seen
    from directions `PARALLAX` apart, at the point nearest to its rays.

    Attributes
    ----------
    update_seconds : time that ISAM2 took for each scan, without what Python does around it: what
        an estimator's time per scan is held against.
    """

    def __init__(self, model: ObservationModel) -> None:
        parameters = gtsam.ISAM2Params()
        parameters.relinearizeSkip = 1
        parameters.setRelinearizeThreshold(0.01)
        self.update_seconds: list[float] = []
        self._model = model
        self._solver = gtsam.ISAM2(parameters)
        self._graph = gtsam.NonlinearFactorGraph()
        self._n_scans = 0
        self._waiting: dict[int, list[tuple[int, float, float]]] = {}
        self._placed: list[int] = []

    def update(self, scan: BearingScan, landmarks: IntArray) -> None:
        """Take the next scan, with the landmark of each of its detections, -1 for none.

        Raises `OptionError` for a scan, after the first, without odometry and its covariance, and
        `NoEstimateError` where ISAM2 cannot go on, as with a landmark at a pose that sees it.
        """
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        pose = self._next_pose(scan.odometry, graph)
        values.insert(X(self._n_scans), gtsam.Pose2(*pose.tolist()))
        sigmas = np.full(len(scan), self._model.sigma) if scan.sigma is None else scan.sigma
        for landmark, bearing, sigma in zip(
            landmarks.tolist(), scan.bearings.tolist(), sigmas.tolist(), strict=True
        ):
            if landmark == MISSED:
                continue
            waiting = self._waiting.setdefault(landmark, [])
            waiting.append((self._n_scans, bearing, sigma))
            if landmark not in self._placed:
                self._place(landmark, pose, graph, values)
            if landmark in self._placed:
                for k, angle, spread in waiting:
                    dof = self._model.bearing_dof
                    graph.add(factors.bearing(X(k), L(landmark), angle, spread, dof))
                waiting.clear()
        start = time.perf_counter()
        try:
            self._solver.update(graph, values)
        except RuntimeError as cause:
            raise NoEstimateError(f"scan {self._n_scans} leaves no estimate: {cause}") from cause
        self.update_seconds.append(time.perf_counter() - start)
        self._graph.push_back(graph)
        self._n_scans += 1

    def pose(self, scan: int) -> FloatArray:
        """Estimated x, y and theta of a scan so far, (3,)."""
        estimate = self._solver.calculateEstimatePose2(X(scan))
        return np.array([estimate.x(), estimate.y(), estimate.theta()])

    def optimised(self) -> DriveEstimate:
        """Optimise the whole graph from what ISAM2 has, and return the result.

        Raises `NoEstimateError` where GTSAM finds none.
        """
        parameters = gtsam.LevenbergMarquardtParams()
        start = self._solver.calculateBestEstimate()
        try:
            values = gtsam.LevenbergMarquardtOptimizer(self._graph, start, parameters).optimize()
        except RuntimeError as cause:
            raise NoEstimateError(f"the graph of the drive cannot be solved: {cause}") from cause
        poses = [values.atPose2(X(k)) for k in range(self._n_scans)]
        rows = sorted(self._placed)
        points = [values.atPoint2(L(row)) for row in rows]
        return DriveEstimate(
            poses=freeze(np.array([[p.x(), p.y(), p.theta()] for p in poses]).reshape(-1, 3)),
            landmarks=freeze(np.array(points, dtype=np.float64).reshape(-1, 2)),
            rows=freeze(np.array(rows, dtype=np.int64)),
        )

    def _next_pose(
        self, odometry: Odometry | None, graph: gtsam.NonlinearFactorGraph
    ) -> FloatArray:
        """Add what leads to the next pose, and return where it leads."""
        k = self._n_scans
        if k == 0:
            noise = gtsam.noiseModel.Isotropic.Sigma(3, START_SIGMA)
            graph.add(gtsam.PriorFactorPose2(X(0), gtsam.Pose2(), noise))
            return np.zeros(3)
        if odometry is None or odometry.covariance is None:
            raise OptionError(f"scan {k} has no odometry with a covariance: give one in every scan")
        motion = odometry.dx, odometry.dy, odometry.dtheta
        graph.add(factors.odometry(X(k - 1), X(k), motion, odometry.covariance))
        return moved(self.pose(k - 1), odometry)

    def _place(
        self,
        landmark: int,
        pose: FloatArray,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
    ) -> None:
        """Give the landmark a position and a prior if its rays tell one."""
        sightings = self._waiting[landmark]
        poses = np.array([pose if k == self._n_scans else self.pose(k) for k, *_ in sightings])
        directions = poses[:, 2] + [bearing for _, bearing, _ in sightings]
        if np.abs(wrap_angle(directions - directions[0])).max() < PARALLAX:
            return
        point = _nearest_to_rays(poses[:, :2], directions)
        if point is None:
            return
        self._placed.append(landmark)
        values.insert(L(landmark), point)
        centre = float(poses[0, 0]), float(poses[0, 1])
        graph.add(factors.landmark_prior(L(landmark), centre, self._model.landmark_sigma))


def moved(pose: FloatArray, odometry: Odometry) -> FloatArray:
    """Return the pose (x, y, theta) after a motion in its frame, (3,)."""
    x, y, theta = pose.tolist()
    c, s = math.cos(theta), math.sin(theta)
    return np.array(
        [
            x + c * odometry.dx - s * odometry.dy,
            y + s * odometry.dx + c * odometry.dy,
            theta + odometry.dtheta,
        ]
    )


def _nearest_to_rays(origins: FloatArray, directions: FloatArray) -> FloatArray | None:
    """Point of least squared distances from the rays, or None where it lies behind one of them."""
    along = np.column_stack([np.cos(directions), np.sin(directions)])
    across = np.column_stack([-along[:, 1], along[:, 0]])
    point: FloatArray = np.linalg.solve(
        across.T @ across, across.T @ np.sum(across * origins, axis=1)
    )
    ahead = np.sum((point - origins) * along, axis=1)
    return point if ahead.min() > 0.0 else None


def _refined(
    scans: Sequence[BearingScan], association: Association, model: ObservationModel
) -> DriveEstimate:
    # The cost of misses does not change the estimate, and Laplace's evidence is not read.
    bare = replace(model, stay_probability=1.0)
    hypothesis = refine(StraightRun(scans), [association], model=bare, evidence="laplace")[0]
    if hypothesis.poses is None or hypothesis.landmarks is None or hypothesis.ranged is None:
        raise NoEstimateError(f"the graph of the drive cannot be solved: {hypothesis.failure}")
    rows = np.flatnonzero(hypothesis.ranged)
    return DriveEstimate(hypothesis.poses, freeze(hypothesis.landmarks[rows]), freeze(rows))
