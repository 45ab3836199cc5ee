"""Peers: Stone Soup's GNN and JPDA trackers of still landmarks, from poses that are given."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

import numpy as np
from peer_registry import POSES_GIVEN, peer
from posed_scenes import given_poses
from scipy.optimize import linear_sum_assignment

from mht_slam import Association, StraightRun
from mht_slam.arrays import FloatArray
from mht_slam.association import MISSED
from mht_slam.evaluation.bench.case import Assumptions

START_RANGE = 3.0
"""Baselines from O1 at which a landmark is first believed to be, on its ray; with this and the
spread below most of other scenes come right."""
RANGE_SPREAD = 1.0
"""Standard deviation of that, in ranges."""
MISSED_DISTANCE = 5.0
"""Standard deviations beyond which GNN leaves a landmark without a detection."""
CLUTTER_DENSITY = 1e-3
"""Per radian, and the chance to be seen: nothing is false or missed here, and zero is not taken."""
DETECTION_PROBABILITY = 0.999
_BEGIN = datetime(2000, 1, 1)
_SECOND = timedelta(seconds=1.0)


@peer("Stone Soup GNN", tier=POSES_GIVEN, needs=("stonesoup",))
def stone_soup_gnn(run: StraightRun, assumptions: Assumptions) -> list[tuple[Association, float]]:
    """Assign every later scan at once to tracks begun by the first, by Mahalanobis distance."""
    from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
    from stonesoup.hypothesiser.distance import DistanceHypothesiser
    from stonesoup.measures import Mahalanobis

    tracking = _Tracking(run, assumptions)
    associator = GNNWith2DAssignment(
        DistanceHypothesiser(
            tracking.predictor, tracking.updater, Mahalanobis(), missed_distance=MISSED_DISTANCE
        )
    )
    for scan in range(1, len(run)):
        detections = tracking.detections(scan)
        found = associator.associate(set(tracking.tracks), set(detections), tracking.time(scan))
        for row, track in enumerate(tracking.tracks):
            if found[track]:
                track.append(tracking.updater.update(found[track]))
                tracking.rows[row][scan] = detections.index(found[track].measurement)
            else:
                track.append(found[track].prediction)
    return tracking.answer


@peer("Stone Soup JPDA", tier=POSES_GIVEN, needs=("stonesoup",))
def stone_soup_jpda(run: StraightRun, assumptions: Assumptions) -> list[tuple[Association, float]]:
    """Weigh all joint assignments of every later scan; each track moves to the weighted mean.

    JPDA names probabilities, not an association: that is the assignment of the largest product of
    a scan's marginal ones.
    """
    from stonesoup.dataassociator.probability import JPDA
    from stonesoup.hypothesiser.probability import PDAHypothesiser

    tracking = _Tracking(run, assumptions)
    associator = JPDA(
        PDAHypothesiser(
            tracking.predictor,
            tracking.updater,
            clutter_spatial_density=CLUTTER_DENSITY,
            prob_detect=DETECTION_PROBABILITY,
        )
    )
    for scan in range(1, len(run)):
        detections = tracking.detections(scan)
        found = associator.associate(set(tracking.tracks), set(detections), tracking.time(scan))
        costs = np.full((len(tracking.tracks), len(detections)), 1e9)
        for row, track in enumerate(tracking.tracks):
            for hypothesis in found[track]:
                if hypothesis:
                    column = detections.index(hypothesis.measurement)
                    costs[row, column] = -float(np.log(max(float(hypothesis.probability), 1e-300)))
            track.append(_mixture(tracking.updater, found[track]))
        for row, column in zip(*linear_sum_assignment(costs), strict=True):
            if costs[row, column] < 1e9:
                tracking.rows[row][scan] = int(column)
    return tracking.answer


class _Tracking:
    """Tracks of still landmarks begun on the first scan's rays, and what updates them."""

    def __init__(self, run: StraightRun, assumptions: Assumptions) -> None:
        from stonesoup.models.transition.linear import (
            CombinedLinearGaussianTransitionModel,
            RandomWalk,
        )
        from stonesoup.predictor.kalman import KalmanPredictor
        from stonesoup.types.state import GaussianState
        from stonesoup.types.track import Track
        from stonesoup.updater.kalman import UnscentedKalmanUpdater

        self._run, self._sigma = run, assumptions.model.sigma
        self._poses = given_poses(assumptions)
        still = CombinedLinearGaussianTransitionModel([RandomWalk(1e-12), RandomWalk(1e-12)])
        self.predictor = KalmanPredictor(still)
        self.updater = UnscentedKalmanUpdater()
        self.rows = [[i] + [MISSED] * (len(run) - 1) for i in range(len(run.scans[0]))]
        self.tracks = [
            Track([GaussianState(mean, covariance, timestamp=_BEGIN)])
            for mean, covariance in map(self._on_ray, run.scans[0].bearings)
        ]

    @property
    def answer(self) -> list[tuple[Association, float]]:
        """The association that the rows say."""
        return [(Association(self.rows, self._run.n_detections), 1.0)]

    def time(self, scan: int) -> datetime:
        """Return a time for each scan."""
        return _BEGIN + scan * _SECOND

    def detections(self, scan: int) -> list[Any]:
        """Return the bearings of a scan as Stone Soup has them, in their order."""
        from stonesoup.models.measurement.nonlinear import Cartesian2DToBearing
        from stonesoup.types.angle import Bearing
        from stonesoup.types.array import StateVector
        from stonesoup.types.detection import Detection

        x, y, heading = self._poses[scan]
        model = Cartesian2DToBearing(
            ndim_state=2,
            mapping=(0, 1),
            noise_covar=np.array([[self._sigma**2]]),
            translation_offset=np.array([[x], [y]]),
            rotation_offset=np.array([[0.0], [0.0], [heading]]),
        )
        return [
            Detection(StateVector([Bearing(b)]), timestamp=self.time(scan), measurement_model=model)
            for b in self._run.scans[scan].bearings
        ]

    def _on_ray(self, bearing: float) -> tuple[FloatArray, FloatArray]:
        """Mean (2, 1) and covariance (2, 2) of a landmark of which one bearing is known."""
        x, y, heading = self._poses[0]
        direction = heading + bearing
        along = np.array([np.cos(direction), np.sin(direction)])
        across = np.array([-along[1], along[0]])
        mean = np.array([x, y]) + START_RANGE * along
        spreads = (RANGE_SPREAD * START_RANGE) ** 2, (self._sigma * START_RANGE) ** 2
        covariance = spreads[0] * np.outer(along, along) + spreads[1] * np.outer(across, across)
        return mean[:, None], covariance


def _mixture(updater: Any, hypotheses: Any) -> Any:
    """Return the Gaussian with mean and covariance of a track's weighted updates."""
    from stonesoup.functions import gm_reduce_single
    from stonesoup.types.array import StateVectors
    from stonesoup.types.update import GaussianStateUpdate

    states = [updater.update(h) if h else h.prediction for h in hypotheses]
    weights = np.array([float(h.probability) for h in hypotheses])
    mean, covariance = gm_reduce_single(
        StateVectors([state.state_vector for state in states]),
        np.stack([state.covar for state in states], axis=2),
        weights / weights.sum(),
    )
    return GaussianStateUpdate(mean, covariance, hypotheses, hypotheses[0].prediction.timestamp)
