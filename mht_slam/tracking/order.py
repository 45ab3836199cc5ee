"""Visual order and apparent angles: in which sequence a robot sees landmarks all around it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mht_slam.arrays import FloatArray, IntArray, finite_array
from mht_slam.errors import MeasurementError

TURN = 2.0 * np.pi


def visual_order(bearings: npt.ArrayLike) -> IntArray:
    """Indices of the bearings in counter-clockwise sequence, beginning with index 0, (n,).

    `bearings` (n,) are radians in any frame. The sequence is cyclic: it begins with index 0, so
    that a turn of the robot changes nothing, whatever bearing lies straight ahead. Equal bearings
    follow each other by index. Raises `MeasurementError` for anything but a list of finite numbers.
    Source: the paper's section 2; docs/method.md, section 6.

    >>> visual_order([0.1, -0.2, 3.0]).tolist()
    [0, 2, 1]
    """
    angles = _bearings(bearings)
    from_first = np.mod(angles - angles[:1], TURN)
    return np.argsort(from_first, kind="stable").astype(np.int64)


def apparent_angles(bearings: npt.ArrayLike) -> FloatArray:
    """Angles between neighbours in the visual order, cyclic, (n,) radians in [0, 2 pi].

    Entry k lies between entries k and k + 1 of `visual_order`, the last one between its last entry
    and its first; they sum to 2 pi. A single bearing is its own neighbour, a whole turn away.
    Raises `MeasurementError` as `visual_order`. Source: the paper's section 2.

    >>> apparent_angles([0.0, 1.0, 3.0]).round(3).tolist()
    [1.0, 2.0, 3.283]
    """
    angles = _bearings(bearings)
    from_first = np.sort(np.mod(angles - angles[:1], TURN))
    return np.diff(from_first, append=TURN) if len(angles) else from_first


def _bearings(bearings: npt.ArrayLike) -> FloatArray:
    angles = finite_array(
        bearings, "bearings", MeasurementError, remedy="give finite numbers of radians"
    )
    if angles.ndim != 1:
        raise MeasurementError(f"bearings has shape {angles.shape}: give one dimension")
    return angles
