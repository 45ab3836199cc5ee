"""Cells: clusters of detections at given step ratios, and sums over the grids laid in them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray

CHUNK_NODES = 60_000
"""Grid points worked on together: what stays in the processor's cache."""
LOG_ROOT_TURN = 0.5 * math.log(2.0 * math.pi)


@dataclass(frozen=True)
class Cells:
    """B clusters, each at one ratio.

    Attributes
    ----------
    positions : (B, 3) of the observation points along the line of travel, baselines.
    rays, sigmas : (B, 3) bearings and standard deviations, radians; 0 and 1 where not seen.
    seen : (B, 3), at least one True a row.
    """

    positions: FloatArray
    rays: FloatArray
    sigmas: FloatArray
    seen: BoolArray

    def take(self, index: IntArray) -> Cells:
        """Return the cells with these indices."""
        return Cells(self.positions[index], self.rays[index], self.sigmas[index], self.seen[index])

    def __len__(self) -> int:
        return len(self.positions)


def chunks(n_cells: int, nodes: int) -> list[IntArray]:
    """Indices of cells, in parts that have about `CHUNK_NODES` grid points together."""
    size = max(1, CHUNK_NODES // nodes)
    return [np.arange(i, min(i + size, n_cells)) for i in range(0, n_cells, size)]


def log_sum(log_terms: FloatArray) -> FloatArray:
    """Log of the sum of exponentials over the last axis; -inf where all are."""
    top = log_terms.max(axis=-1)
    safe = np.where(np.isfinite(top), top, 0.0)
    total = np.exp(log_terms - safe[..., None]).sum(axis=-1)
    return np.asarray(np.where(np.isfinite(top), safe + np.log(total), -np.inf))


def wrapped(angle: FloatArray) -> FloatArray:
    """Move angles by whole turns into about [-pi, pi], cheaper than `wrap_angle`."""
    return np.asarray(angle - (2.0 * math.pi) * np.rint(angle * (0.5 / math.pi)))
