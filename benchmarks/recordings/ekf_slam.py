"""Bearing-only EKF-SLAM with delayed landmarks: what the classical baselines have in common.

One Gaussian over pose and landmarks. Who decides which detection is which landmark is handed in;
that is all in which the baselines differ. A detection of no landmark goes to a candidate: a ray
with a few ranges on it, which becomes a landmark once its sightings lie far enough apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from drive_scores import Answer, NotApplicableError, answer_of
from scipy.optimize import linear_sum_assignment

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED, Association
from mht_slam.datasets import Drive
from mht_slam.errors import NoEstimateError
from mht_slam.evaluation.known_association import known_association, moved
from mht_slam.measurements import BearingScan, Odometry, wrap_angle
from mht_slam.models import ObservationModel

N_RANGES = 40
"""Ranges at which a candidate may lie, evenly spaced in their logarithm."""
NEAREST = 0.02
"""The nearest of them, as a share of the farthest."""
FARTHEST = 2.0
"""The farthest, in standard deviations of the landmark prior; also how far landmarks are seen."""
LASTING = 10
"""Scans that a candidate survives unseen."""
LEAST_SIGHTINGS = 3
"""Of a candidate that becomes a landmark."""
MOST_SCANS = 3000
"""A longer drive takes hours: every scan costs the square of the number of landmarks so far."""
MARGIN = math.radians(3.0)
"""How far outside the view a landmark may be predicted and still be paired."""
PARALLAXES_DEG = (1, 3)
"""Options of all filters: sooner and less certain, or later."""
CANDIDATE_GATE = 3.0
"""Standard deviations between a candidate's nearest prediction and its next sighting."""

Pairing: TypeAlias = Callable[[FloatArray, FloatArray], IntArray]
"""From (d, n) innovations and the (n, n) covariance of the predicted bearings of n landmarks,
without the noise of the detections, to the (d,) landmark of each detection, -1 for none; noise is
in standard deviations, so that its covariance is the identity."""


@dataclass
class Candidate:
    """A ray that may become a landmark.

    Attributes
    ----------
    row : of the association.
    poses, bearings : of its sightings.
    points, costs : (N_RANGES, 2) where it may be and (N_RANGES,) what its sightings say of that.
    turned, drifted : variance of the turns and of the ways, per axis, since it was last seen.
    turned_before, drifted_before : between its first and its last sighting.
    unseen : scans since the last.
    """

    row: int
    poses: list[FloatArray]
    bearings: list[float]
    points: FloatArray
    costs: FloatArray = field(default_factory=lambda: np.zeros(N_RANGES))
    turned: float = 0.0
    drifted: float = 0.0
    turned_before: float = 0.0
    drifted_before: float = 0.0
    unseen: int = 0

    def see(self, pose: FloatArray, bearing: float, squares: FloatArray) -> None:
        """Add a sighting with its squared deviations at every range."""
        self.poses.append(pose)
        self.bearings.append(bearing)
        self.costs = self.costs + squares
        self.turned_before += self.turned
        self.drifted_before += self.drifted
        self.turned = self.drifted = 0.0
        self.unseen = 0


def run(drive: Drive, model: ObservationModel, pair: Pairing, parallax: float) -> Answer:
    """Drive through, and return the association with the graph's estimate of it.

    `parallax` is how far apart a candidate's directions lie, radians, when it becomes a landmark.

    The estimate of the graph of the same association is better than the filter's, whose
    linearisation is of its time; where it has none the filter's own poses are returned.
    """
    if not drive.has_odometry:
        raise NotApplicableError(f"{drive.name} has no odometry to predict with")
    if len(drive) > MOST_SCANS:
        raise NotApplicableError(f"{drive.name} has {len(drive)} scans: too large a covariance")
    ekf = EkfSlam(model, pair, parallax)
    for scan in drive.scans:
        ekf.update(scan)
    association = ekf.association(drive)
    try:
        return answer_of(association, known_association(drive.scans, association, model))
    except NoEstimateError:
        return Answer(association, np.array(ekf.poses))


class EkfSlam:
    """The filter.

    Attributes
    ----------
    poses : estimated pose of each scan, at its time.
    rows : for each scan the row of each detection.
    """

    def __init__(self, model: ObservationModel, pair: Pairing, parallax: float) -> None:
        self.poses: list[FloatArray] = []
        self.rows: list[IntArray] = []
        self._model, self._pair, self._parallax = model, pair, parallax
        self._mean, self._covariance = np.zeros(3), 1e-6 * np.eye(3)
        self._row_of_landmark: list[int] = []
        self._candidates: list[Candidate] = []
        self._n_rows = 0

    def update(self, scan: BearingScan) -> None:
        """Predict, pair, correct, and let candidates grow."""
        if scan.odometry is not None:
            self._predict(scan.odometry)
        rows = np.full(len(scan), MISSED, dtype=np.int64)
        if len(scan):
            self._see_landmarks(scan.bearings, rows)
            self._see_candidates(scan.bearings, rows)
            for j in np.flatnonzero(rows == MISSED).tolist():
                rows[j] = self._begin(float(scan.bearings[j]))
        self.poses.append(self._mean[:3].copy())
        self.rows.append(rows)
        self._grow()

    def association(self, drive: Drive) -> Association:
        """Return which detections went to one landmark, or to one candidate."""
        table = np.full((self._n_rows, len(drive)), MISSED, dtype=np.int64)
        for k, rows in enumerate(self.rows):
            table[rows, k] = np.arange(len(rows))
        return Association(table, drive.n_detections)

    def _predict(self, odometry: Odometry) -> None:
        theta = self._mean[2]
        c, s = math.cos(theta), math.sin(theta)
        along = np.array([[1.0, 0.0, -s * odometry.dx - c * odometry.dy],
                          [0.0, 1.0, c * odometry.dx - s * odometry.dy],
                          [0.0, 0.0, 1.0]])  # fmt: skip
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        self._mean[:3] = moved(self._mean[:3], odometry)
        self._covariance[:3] = along @ self._covariance[:3]
        self._covariance[:, :3] = self._covariance[:, :3] @ along.T
        noise = np.asarray(odometry.covariance)
        self._covariance[:3, :3] += turn @ noise @ turn.T
        for candidate in self._candidates:
            candidate.turned += float(noise[2, 2])
            candidate.drifted += 0.5 * float(noise[0, 0] + noise[1, 1])

    def _see_landmarks(self, bearings: FloatArray, rows: IntArray) -> None:
        """Pair detections with landmarks in view, and correct the state with all of them."""
        predicted, jacobian, ranges = self._bearings()
        sides = 0.5 * self._model.field_of_view + MARGIN
        reach = FARTHEST * self._model.landmark_sigma
        view = np.flatnonzero((np.abs(predicted) < sides) & (ranges < reach))
        if not len(view):
            return
        sigma, jacobian = self._model.sigma, jacobian[view]
        spread = _times(self._covariance, jacobian, view)
        joint = _of_bearings(spread, jacobian, view)
        innovations = wrap_angle(bearings[:, None] - predicted[view])
        paired = self._pair(innovations / sigma, joint / sigma**2)
        seen = np.flatnonzero(paired != MISSED)
        if not len(seen):
            return
        chosen = paired[seen]
        rows[seen] = np.array(self._row_of_landmark)[view[chosen]]
        spread = spread[:, chosen]
        innovation = joint[np.ix_(chosen, chosen)] + sigma**2 * np.eye(len(chosen))
        gain = np.linalg.solve(innovation, spread.T).T
        self._mean += gain @ innovations[seen, chosen]
        self._mean[2] = wrap_angle(float(self._mean[2]))
        self._covariance -= gain @ spread.T

    def _bearings(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Predicted bearings (n,), derivatives (n, 5) by pose and landmark, and ranges (n,)."""
        away = self._mean[3:].reshape(-1, 2) - self._mean[:2]
        square = np.maximum((away**2).sum(axis=1), 1e-12)
        predicted = wrap_angle(np.arctan2(away[:, 1], away[:, 0]) - self._mean[2])
        across = np.column_stack([-away[:, 1], away[:, 0]]) / square[:, None]
        return (
            predicted,
            np.column_stack([-across, np.full(len(away), -1.0), across]),
            np.sqrt(square),
        )

    def _see_candidates(self, bearings: FloatArray, rows: IntArray) -> None:
        """Assign what is left to candidates, by the nearest of their likely ranges."""
        left = np.flatnonzero(rows == MISSED)
        for candidate in self._candidates:
            candidate.unseen += 1
        if not len(left) or not self._candidates:
            return
        points = np.array([candidate.points for candidate in self._candidates])
        away = points - self._mean[:2]
        predicted = wrap_angle(np.arctan2(away[..., 1], away[..., 0]) - self._mean[2])
        turned, drifted = (
            np.array([[getattr(c, name)] for c in self._candidates])
            for name in ("turned", "drifted")
        )
        variance = 2.0 * self._model.sigma**2 + turned + drifted / (away**2).sum(axis=2)
        offset = wrap_angle(bearings[left][:, None, None] - predicted)
        squares = offset**2 / variance  # (left, candidates, ranges)
        costs = np.array([candidate.costs for candidate in self._candidates])
        nearest = (squares + costs - costs.min(axis=1, keepdims=True)).min(axis=2)
        gain = np.maximum(CANDIDATE_GATE**2 - nearest, 0.0)
        for a, i in zip(*linear_sum_assignment(gain, maximize=True), strict=True):
            if gain[a, i] > 0.0:
                candidate, j = self._candidates[i], left[a]
                rows[j] = candidate.row
                candidate.see(self._mean[:3].copy(), float(bearings[j]), squares[a, i])

    def _begin(self, bearing: float) -> int:
        """Begin a candidate, and return its row."""
        far = FARTHEST * self._model.landmark_sigma
        ranges = np.geomspace(NEAREST * far, far, N_RANGES)
        direction = self._mean[2] + bearing
        ray = np.array([math.cos(direction), math.sin(direction)])
        points = self._mean[:2] + ranges[:, None] * ray
        self._candidates.append(Candidate(self._n_rows, [self._mean[:3].copy()], [bearing], points))
        self._n_rows += 1
        return self._n_rows - 1

    def _grow(self) -> None:
        """Turn candidates with parallax into landmarks, and give up those unseen for long."""
        kept = []
        for candidate in self._candidates:
            if candidate.unseen == 0 and self._becomes_landmark(candidate):
                continue
            if candidate.unseen <= LASTING:
                kept.append(candidate)
        self._candidates = kept

    def _becomes_landmark(self, candidate: Candidate) -> bool:
        poses = np.array(candidate.poses)
        directions = poses[:, 2] + candidate.bearings
        parallax = np.abs(wrap_angle(directions - directions[0])).max()
        if len(poses) < LEAST_SIGHTINGS or parallax < self._parallax:
            return False
        across = np.column_stack([-np.sin(directions), np.cos(directions)])
        point = np.linalg.lstsq(across, np.sum(across * poses[:, :2], axis=1), rcond=None)[0]
        x, y, theta = self._mean[:3]
        distance = math.hypot(point[0] - x, point[1] - y)
        angle = theta + candidate.bearings[-1]
        if not 0.0 < distance < FARTHEST * self._model.landmark_sigma:
            return False
        c, s = math.cos(angle), math.sin(angle)
        if (point[0] - x) * c + (point[1] - y) * s <= 0.0:
            return False
        by_pose = np.array([[1.0, 0.0, -distance * s], [0.0, 1.0, distance * c]])
        by_polar = np.array([[c, -distance * s], [s, distance * c]])
        sigma = self._model.sigma
        # How far the ray from the first sighting may have turned and moved against this one.
        aside = 2.0 * sigma**2 + candidate.turned_before + candidate.drifted_before / distance**2
        polar = np.diag([aside * (distance / math.sin(parallax)) ** 2, sigma**2])
        crossed = by_pose @ self._covariance[:3]
        own = by_pose @ self._covariance[:3, :3] @ by_pose.T + by_polar @ polar @ by_polar.T
        self._covariance = np.block([[self._covariance, crossed.T], [crossed, own]])
        self._mean = np.concatenate([self._mean, [x + distance * c, y + distance * s]])
        self._row_of_landmark.append(candidate.row)
        return True


def _times(covariance: FloatArray, jacobian: FloatArray, view: IntArray) -> FloatArray:
    """Covariance of the whole state with the bearings of the landmarks in view, (size, n)."""
    columns = 3 + 2 * view
    return (
        covariance[:, :3] @ jacobian[:, :3].T
        + covariance[:, columns] * jacobian[:, 3]
        + covariance[:, columns + 1] * jacobian[:, 4]
    )


def _of_bearings(spread: FloatArray, jacobian: FloatArray, view: IntArray) -> FloatArray:
    """Covariance of these bearings among themselves, (n, n)."""
    rows = 3 + 2 * view
    joint = (
        jacobian[:, :3] @ spread[:3]
        + jacobian[:, 3, None] * spread[rows]
        + jacobian[:, 4, None] * spread[rows + 1]
    )
    return 0.5 * (joint + joint.T)
