"""Peer: filterpy's extended Kalman filter as bearing-only SLAM with gated nearest neighbours."""

from __future__ import annotations

import math

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from peer_registry import peer
from scipy.optimize import linear_sum_assignment

from mht_slam import Association, StraightRun
from mht_slam.arrays import FloatArray
from mht_slam.association import MISSED
from mht_slam.evaluation.bench.case import Assumptions
from mht_slam.measurements import wrap_angle
from mht_slam.models import ObservationModel

GATE = 4.0
"""Standard deviations of an innovation beyond which a detection is not a landmark's."""
_FORBIDDEN = 1e9


@peer("EKF-SLAM, nearest neighbour, delayed initialisation")
def ekf_slam(run: StraightRun, assumptions: Assumptions) -> list[tuple[Association, float]]:
    """Filter the run scan by scan; one association comes out, and nothing is ever taken back.

    The state is the logarithm of the second step, whose prior is normal in it, and the landmarks.
    A bearing waits for its landmark: rays of O1 and O2 are paired by nearest bearings, as far as
    they meet, and initialise a landmark where they do. At O3 the nearest pair of landmark and
    detection in Mahalanobis distance is updated first, then the nearest of the others, up to the
    gate.
    """
    model = assumptions.model
    first, second, third = (scan.bearings for scan in run.scans)
    pairs = _paired_rays(first, second)
    kalman = _initial_filter(first, second, pairs, model)
    rows = [[i, j, MISSED] for i, j in pairs]
    waiting = set(range(len(third)))
    while open_rows := [row for row, entry in enumerate(rows) if entry[2] == MISSED]:
        distances = {
            (_distance(kalman, row, third[k], model.sigma), row, k)
            for row in open_rows
            for k in waiting
        }
        distance, row, k = min(distances, default=(math.inf, 0, 0))
        if distance > GATE:
            break
        kalman.update(
            np.array([third[k]]), _jacobian, _predicted, args=(row,), hx_args=(row,),
            residual=_residual,
        )  # fmt: skip
        rows[row][2] = k
        waiting.discard(k)
    return [(Association(rows, run.n_detections), 1.0)]


def _paired_rays(first: FloatArray, second: FloatArray) -> list[tuple[int, int]]:
    """Pairs of rays that meet, the nearest bearings over all."""
    turn = np.abs(wrap_angle(second - first[:, None]))
    with np.errstate(divide="ignore"):
        along = np.sin(second) / np.sin(second - first[:, None])
        back = np.sin(first[:, None]) / np.sin(second - first[:, None])
    meet = (along > 0.0) & (back > 0.0) & np.isfinite(along)
    rows, columns = linear_sum_assignment(np.where(meet, turn, _FORBIDDEN))
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if meet[i, j]]


def _initial_filter(
    first: FloatArray, second: FloatArray, pairs: list[tuple[int, int]], model: ObservationModel
) -> ExtendedKalmanFilter:
    """Filter with the prior of the log step and one triangulated landmark for each pair."""
    kalman = ExtendedKalmanFilter(dim_x=1 + 2 * len(pairs), dim_z=1)
    kalman.x = np.zeros(1 + 2 * len(pairs))  # the default, a column, would broadcast silently
    kalman.x[0] = model.log_step_mean
    kalman.P = np.zeros((len(kalman.x), len(kalman.x)))
    kalman.P[0, 0] = model.log_step_sigma**2
    kalman.R = np.array([[model.sigma**2]])
    for row, (i, j) in enumerate(pairs):
        place = slice(1 + 2 * row, 3 + 2 * row)
        angles = np.array([first[i], second[j]])
        kalman.x[place] = _crossing(angles)
        spread = _crossing_jacobian(angles)
        kalman.P[place, place] = model.sigma**2 * spread @ spread.T
    return kalman


def _crossing(angles: FloatArray) -> FloatArray:
    """Where the rays of O1 and O2 with these two bearings meet."""
    along = np.sin(angles[1]) / np.sin(angles[1] - angles[0])
    return along * np.array([np.cos(angles[0]), np.sin(angles[0])])


def _crossing_jacobian(angles: FloatArray) -> FloatArray:
    """(2, 2) change of the place where two rays meet with their bearings."""
    a, b = angles
    parallax = np.sin(b - a)
    along, back = np.sin(b) / parallax, np.sin(a) / parallax
    by_first = along / parallax * np.array([np.cos(b), np.sin(b)])
    by_second = -back / parallax * np.array([np.cos(a), np.sin(a)])
    return np.column_stack([by_first, by_second])


def _distance(kalman: ExtendedKalmanFilter, row: int, bearing: float, sigma: float) -> float:
    """Innovation of a detection of the third scan in its standard deviations."""
    jacobian = _jacobian(kalman.x, row)[0]
    spread = math.sqrt(float(jacobian @ kalman.P @ jacobian) + sigma**2)
    return abs(float(_residual(np.array([bearing]), _predicted(kalman.x, row))[0])) / spread


def _predicted(state: FloatArray, row: int) -> FloatArray:
    """Bearing of a landmark from O3."""
    dx = state[1 + 2 * row] - 1.0 - np.exp(state[0])
    return np.array([np.arctan2(state[2 + 2 * row], dx)])


def _jacobian(state: FloatArray, row: int) -> FloatArray:
    step = np.exp(state[0])
    dx, dy = state[1 + 2 * row] - 1.0 - step, state[2 + 2 * row]
    squared = dx * dx + dy * dy
    jacobian = np.zeros((1, len(state)))
    jacobian[0, 0] = dy * step / squared
    jacobian[0, 1 + 2 * row], jacobian[0, 2 + 2 * row] = -dy / squared, dx / squared
    return jacobian


def _residual(measured: FloatArray, predicted: FloatArray) -> FloatArray:
    return np.asarray(wrap_angle(measured - predicted))
