"""Ceilings: what an association could be at best, were poses and map known."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from mht_slam.arrays import BoolArray, FloatArray, finite_array, finite_number, whole_number
from mht_slam.association import MISSED, Association
from mht_slam.datasets.drive import Drive
from mht_slam.errors import OptionError
from mht_slam.measurements import StraightRun, wrap_angle


def assignment_given_truth(
    run: StraightRun | Drive,
    poses: npt.ArrayLike,
    landmarks: npt.ArrayLike,
    sigma: float,
    gate: float,
    *,
    in_view: npt.ArrayLike | None = None,
) -> Association:
    """Assign each scan's detections to the true landmarks, seen from the true pose.

    A linear assignment of least squared bearing residuals, scan by scan; no other scan and no range
    helps. It is a practical ceiling and no bound: what several scans tell together may resolve two
    landmarks that one scan cannot, and a hidden landmark takes the detection of another that lies
    in the same direction, unless `in_view` tells.

    Parameters
    ----------
    poses : (m, 3) true x, y and theta (radians, forward along it) of the m scans, any unit.
    landmarks : (n, 2) true positions in the frame of the poses.
    sigma : standard deviation of a bearing, radians.
    gate : largest residual of an assignment, in standard deviations; a detection beyond it is a
        false alarm.
    in_view : (n, m) bool, which landmarks each scan may see (`seen_span`); None: all of them.

    Returns
    -------
    Association
        Its rows are those landmarks that got a detection.

    Raises `OptionError` for a wrong shape or a number out of range.
    """
    robot = _checked(poses, "poses", (len(run), 3))
    points = finite_array(landmarks, "landmarks", OptionError, remedy="give positions")
    points = _checked(points, "landmarks", (len(points) if points.ndim else 0, 2))
    finite_number(sigma, "sigma", above=0.0)
    finite_number(gate, "gate", above=0.0)
    mask = np.ones((len(points), len(run)), dtype=np.bool_) if in_view is None else in_view
    if np.shape(mask) != (len(points), len(run)):
        raise OptionError(f"in_view has shape {np.shape(mask)}: give {(len(points), len(run))}")
    visible = np.asarray(mask, dtype=np.bool_)
    table = np.full((len(points), len(run)), MISSED, dtype=np.int64)
    for k, (scan, (x, y, theta)) in enumerate(zip(run.scans, robot, strict=True)):
        expected = np.arctan2(points[:, 1] - y, points[:, 0] - x) - theta
        residual: FloatArray = wrap_angle(expected[:, None] - scan.bearings) / sigma
        gain = np.where(visible[:, k, None], np.maximum(gate**2 - residual**2, 0.0), 0.0)
        for i, j in zip(*linear_sum_assignment(gain, maximize=True), strict=True):
            if gain[i, j] > 0.0:
                table[i, k] = j
    return Association(table[(table != MISSED).any(axis=1)], run.n_detections)


def seen_span(truth: Association, max_gap: int | None = None) -> BoolArray:
    """Return (n_landmarks, m): whether the scan is between two detections of a landmark.

    `max_gap` is the most scans that these two may lie apart: on a long drive that comes back, a
    landmark was not in view all the time. None: between the first and the last.

    >>> seen_span(Association([[-1, 0, -1, 0, -1]], (0, 1, 0, 1, 0))).tolist()
    [[False, True, True, True, False]]
    >>> seen_span(Association([[0, -1, 0, -1, -1, 0]], (1, 0, 1, 0, 0, 1)), max_gap=2).tolist()
    [[True, True, True, False, False, True]]
    """
    seen = truth.table != MISSED
    scans = np.arange(seen.shape[1])
    last = np.maximum.accumulate(np.where(seen, scans, -np.inf), axis=1)
    following = np.minimum.accumulate(np.where(seen, scans, np.inf)[:, ::-1], axis=1)[:, ::-1]
    gap = np.inf if max_gap is None else whole_number(max_gap, "max_gap", at_least=1)
    return np.asarray(np.isfinite(last) & np.isfinite(following) & (following - last <= gap))


def _checked(value: npt.ArrayLike, name: str, shape: tuple[int, int]) -> FloatArray:
    array = finite_array(value, name, OptionError, remedy="give the reference of the run")
    if array.shape != shape:
        raise OptionError(f"{name} has shape {array.shape}: give {shape}")
    return array
