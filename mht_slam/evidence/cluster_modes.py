"""Where the bearings of a cell agree best: the mode that a grid may be laid about."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.evidence.cells import Cells, wrapped

COMPACT = 12.0
"""Change of some bearing per unit of log range, in sigmas, that makes a landmark compact.

A compact landmark is nearly Gaussian in two of its bearings, and its grid is laid about the mode.
"""
CLEAR = 7.0
"""Sigmas between the mode and the edges of those coordinates: no parallax, and the line of travel.
"""
MODE_ITERATIONS = 16
SAME_MODE = 1e-3
"""Nats within which two pairs have found the same mode."""
MODE_TOLERANCE = 1e-3
_PAIRS = ((0, 1, 2), (0, 2, 1), (1, 2, 0))
"""Two scans that span the bearing coordinates, and the third."""


@dataclass(frozen=True)
class Modes:
    """Where each cell's bearings agree best, in the bearings of two of its sightings.

    `first`, `second`, `third` are (B,) scans; `t` (B, 2) the deviations of the first two bearings
    in sigmas; `slope` (B, 2) how the residual of the third follows them; `sensitivity` (B,) the
    change of bearings per unit of log range, in sigmas, 0 where there is no mode; `nearest` (B,)
    the observation point closest to it, -1 without a mode; `usable` whether a grid may be laid
    there.
    """

    first: IntArray
    second: IntArray
    third: IntArray
    t: FloatArray
    slope: FloatArray
    sensitivity: FloatArray
    nearest: IntArray
    usable: BoolArray

    def take(self, index: IntArray) -> Modes:
        """Return the modes with these indices."""
        return Modes(
            self.first[index],
            self.second[index],
            self.third[index],
            self.t[index],
            self.slope[index],
            self.sensitivity[index],
            self.nearest[index],
            self.usable[index],
        )


def find_modes(cells: Cells) -> Modes:
    """Gauss-Newton in each pair's bearings; of the modes found, the best one.

    Where several pairs find it, the one whose third bearing follows them least is taken.
    """
    found = [_mode_of_pair(cells, *scans) for scans in _PAIRS]
    cost = np.stack([pair.cost for pair in found])
    steepness = np.stack([(pair.slope**2).sum(axis=1) for pair in found])
    steepness[~(cost <= cost.min(axis=0) + SAME_MODE)] = np.inf
    choice = steepness.argmin(axis=0)
    row = np.arange(len(cells))
    sensitivity = np.stack([pair.sensitivity for pair in found])[choice, row]
    first, second, third = np.array(_PAIRS)[choice].T
    return Modes(
        first,
        second,
        third,
        np.stack([pair.t for pair in found])[choice, row],
        np.stack([pair.slope for pair in found])[choice, row],
        sensitivity,
        np.stack([pair.nearest for pair in found])[choice, row],
        np.stack([pair.clear for pair in found])[choice, row] & (sensitivity > COMPACT),
    )


@dataclass(frozen=True)
class _PairModes:
    """What Gauss-Newton finds in the bearings of one pair; `cost` is infinite where nothing."""

    cost: FloatArray
    t: FloatArray
    slope: FloatArray
    sensitivity: FloatArray
    nearest: IntArray
    clear: BoolArray


def _mode_of_pair(cells: Cells, a: int, b: int, c: int) -> _PairModes:
    """Damped Gauss-Newton from where two rays meet as measured."""
    (ray_a, ray_b, ray_c) = (cells.rays[:, k] for k in (a, b, c))
    sigma_a, sigma_b, sigma_c = (cells.sigmas[:, k] for k in (a, b, c))
    x_a, x_b, x_c = (cells.positions[:, k] for k in (a, b, c))
    full = cells.seen[:, c]
    base = x_b - x_a
    share_a, share_b = (
        (x_b - x_c) / base * sigma_a / sigma_c,
        (x_c - x_a) / base * sigma_b / sigma_c,
    )

    def look(t: FloatArray) -> tuple[FloatArray, ...]:
        """Cost, residual and slopes of the third bearing, the point, its clearance in sigmas."""
        alpha, gamma = ray_a + sigma_a * t[:, 0], ray_b + sigma_b * t[:, 1]
        sine, sin_a, sin_b = np.sin(gamma - alpha), np.sin(alpha), np.sin(gamma)
        range_a = base * sin_b / sine
        x, y = x_a + range_a * np.cos(alpha), range_a * sin_a
        flat = y**2 / (y**2 + (x - x_c) ** 2)
        slope = np.stack([flat / sin_a**2 * share_a, flat / sin_b**2 * share_b], axis=1)
        residual = wrapped(np.arctan2(y, x - x_c) - ray_c) / sigma_c
        residual, slope = np.where(full, residual, 0.0), np.where(full[:, None], slope, 0.0)
        cost = 0.5 * ((t**2).sum(axis=1) + residual**2)
        meets = (range_a > 0.0) & (sin_a * sine > 0.0)
        clear = np.minimum(
            np.abs(sine) / np.hypot(sigma_a, sigma_b),
            np.minimum(np.abs(sin_a) / sigma_a, np.abs(sin_b) / sigma_b),
        )
        return np.where(meets, cost, np.inf), residual, slope, x, y, clear

    t = np.zeros((len(cells), 2))
    cost, residual, slope, x, y, clear = look(t)
    cost = np.where(cells.seen[:, a] & cells.seen[:, b], cost, np.inf)
    damping, change = np.ones(len(cells)), np.full(len(cells), np.inf)
    for _ in range(MODE_ITERATIONS):
        pull = (residual - (slope * t).sum(axis=1)) / (1.0 + (slope**2).sum(axis=1))
        step = -slope * pull[:, None] - t
        change = np.abs(step).max(axis=1)
        moving = np.isfinite(cost) & (change > MODE_TOLERANCE)
        if not moving.any():
            break
        tried = look(t + damping[:, None] * step)
        better = moving & (tried[0] <= cost)
        t = np.where(better[:, None], t + damping[:, None] * step, t)
        cost, residual, x, y, clear = (
            np.where(better, new, old)
            for new, old in zip(
                (tried[0], tried[1], *tried[3:]), (cost, residual, x, y, clear), strict=True
            )
        )
        slope = np.where(better[:, None], tried[2], slope)
        damping = np.where(better, np.minimum(2.0 * damping, 1.0), 0.3 * damping)
    found = np.isfinite(cost) & (change <= MODE_TOLERANCE)
    sensitivity, nearest = _sensitivity(cells, x, y)
    return _PairModes(
        np.where(found, cost, np.inf),
        t,
        slope,
        np.where(found, sensitivity, 0.0),
        np.where(found, nearest, -1),
        found & (clear > CLEAR),
    )


def _sensitivity(cells: Cells, x: FloatArray, y: FloatArray) -> tuple[FloatArray, IntArray]:
    """Largest change of a bearing per unit of log range from the nearest point, and that point."""
    away = x[:, None] - cells.positions
    ranges = np.where(cells.seen, np.hypot(away, y[:, None]), np.inf)
    nearest = ranges.argmin(axis=1)
    row = np.arange(len(cells))
    angles = np.arctan2(y[:, None], away)
    turn = np.abs(np.sin(angles - angles[row, nearest][:, None]))
    change = turn * ranges[row, nearest][:, None] / (ranges * cells.sigmas)
    change[~cells.seen] = 0.0
    change[row, nearest] = 0.0
    return change.max(axis=1), nearest
