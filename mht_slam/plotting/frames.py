"""Points moved between the run frame, a pair's F_R and F_L, with what is uncertain about them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from mht_slam.arrays import FloatArray
from mht_slam.association import Association
from mht_slam.hypotheses import Hypothesis


@dataclass(frozen=True, eq=False)
class TrueLayout:
    """Where everything really was, in one frame of any origin, orientation and unit.

    Attributes
    ----------
    poses : (m, 3) x, y, theta of each scan the figure speaks of.
    landmarks : (n, 2), row l is the landmark of row l of ``association.table``.
    association : the true association over these scans.
    """

    poses: FloatArray
    landmarks: FloatArray
    association: Association


@dataclass(frozen=True, eq=False)
class LandmarkFrameEstimate:
    """The factor graph's estimate in F_L.

    Attributes
    ----------
    landmarks : (n, 2); landmark_covariances : (n, 2, 2).
    points : (m, 2) observation points; point_covariances : (m, 2, 2).
    """

    landmarks: FloatArray
    landmark_covariances: FloatArray
    points: FloatArray
    point_covariances: FloatArray


def between(points: FloatArray, origin: FloatArray, unit: FloatArray) -> FloatArray:
    """Move (k, 2) `points` by the similarity that puts `origin` at (0, 0) and `unit` at (1, 0).

    The paper's z = (p3 - p1) / (p2 - p1); with two observation points it leads to F_R, with two
    landmarks to F_L (docs/method.md, section 3).

    >>> between(np.array([[2.0, 3.0]]), np.array([2.0, 1.0]), np.array([2.0, 3.0])).tolist()
    [[1.0, 0.0]]
    """
    z = (_complex(points) - _complex(origin)) / (_complex(unit) - _complex(origin))
    return np.column_stack([z.real, z.imag])


def estimate_in_landmark_frame(
    hypothesis: Hypothesis, base: tuple[int, int]
) -> LandmarkFrameEstimate:
    """Move a solved hypothesis into the F_L of two of its landmarks, to first order.

    `base` are the rows of its association at (0, 0) and (1, 0). The similarity depends on both
    base landmarks, so the covariance of z = (p - p1) / (p2 - p1) comes from the joint covariance
    of p, p1 and p2 that the graph's Hessian gives; the base landmarks end with none, and the
    gauge drops out. Raises `NoEstimateError` for a failed hypothesis. Source: docs/method.md,
    section 3.
    """
    graph, values, _ = hypothesis.to_gtsam()
    assert hypothesis.poses is not None  # noqa: S101 - narrows the type
    assert hypothesis.landmarks is not None  # noqa: S101 - narrows the type
    covariance = np.linalg.inv(graph.linearize(values).hessian()[0])
    n, m = len(hypothesis.landmarks), len(hypothesis.poses)
    positions = np.vstack([hypothesis.landmarks, hypothesis.poses[:, :2]])
    to_position = _tangent_to_position(hypothesis.poses[:, 2], n)
    images = _complex(positions)
    p1, p2 = images[base[0]], images[base[1]]
    z = (images - p1) / (p2 - p1)
    # dz = (dp - (1 - z) dp1 - z dp2) / (p2 - p1), one complex row per position.
    derivative = np.eye(n + m, dtype=np.complex128)
    derivative[:, base[0]] -= 1.0 - z
    derivative[:, base[1]] -= z
    derivative /= p2 - p1
    jacobian = _real_blocks(derivative) @ to_position
    joint = jacobian @ covariance @ jacobian.T
    blocks = joint.reshape(n + m, 2, n + m, 2)[np.arange(n + m), :, np.arange(n + m), :]
    xy = np.column_stack([z.real, z.imag])
    return LandmarkFrameEstimate(xy[:n], blocks[:n], xy[n:], blocks[n:])


def true_base(truth: TrueLayout, association: Association, base: tuple[int, int]) -> list[int]:
    """Rows of the truth's landmarks that the base detections of an association really are.

    The middle scan, column 1, names the base for all hypotheses alike; -1 for a false alarm.
    """
    rows = truth.association.landmark_of_detection()[1]
    return [int(rows[association.table[row, 1]]) for row in base]


def _complex(points: FloatArray) -> npt.NDArray[np.complex128]:
    z: npt.NDArray[np.complex128] = np.asarray(points[..., 0] + 1j * points[..., 1])
    return z


def _tangent_to_position(headings: FloatArray, n_landmarks: int) -> FloatArray:
    """(2 (n + m), 2 n + 3 m): GTSAM keeps a pose's uncertainty in its own frame, in key order."""
    n, m = n_landmarks, len(headings)
    matrix = np.zeros((2 * (n + m), 2 * n + 3 * m))
    matrix[: 2 * n, : 2 * n] = np.eye(2 * n)
    for k, theta in enumerate(headings.tolist()):
        c, s = np.cos(theta), np.sin(theta)
        row, column = 2 * (n + k), 2 * n + 3 * k
        matrix[row : row + 2, column : column + 2] = [[c, -s], [s, c]]
    return matrix


def _real_blocks(matrix: npt.NDArray[np.complex128]) -> FloatArray:
    """(2 k, 2 k) real matrix that multiplies (x, y) pairs as the complex one multiplies x + iy."""
    rows, columns = matrix.shape
    blocks = np.empty((rows, 2, columns, 2))
    blocks[:, 0, :, 0] = blocks[:, 1, :, 1] = matrix.real
    blocks[:, 1, :, 0] = matrix.imag
    blocks[:, 0, :, 1] = -matrix.imag
    return blocks.reshape(2 * rows, 2 * columns)
