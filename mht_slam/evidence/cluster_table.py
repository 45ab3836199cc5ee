"""Log integrals of clusters as functions of the log step ratio, each on knots of its own.

Where a cluster's three bearings determine the ratio, its integral is a narrow bump in ln r;
elsewhere it is smooth. So every cluster gets its own knots, halved until a cubic through the
neighbours predicts the next one.
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.evidence.cells import Cells
from mht_slam.evidence.cluster_integral import log_cluster_integrals
from mht_slam.measurements import BearingScan
from mht_slam.models import ObservationModel
from mht_slam.parallel import ordered_map

PRIOR_REACH = 8.0
"""Log ratios beyond this many standard deviations of their prior do not exist here."""
FARTHEST = 100.0
"""Log ratios beyond this are taken for it: O3 lies on O2, or infinitely far out, either way."""
FIRST_KNOTS = np.array([0.0, 0.5, 1.0, 1.7, 2.5, 3.4, 4.5, 6.0, PRIOR_REACH])
"""Where the halving starts, on either side of the prior's mean, in its standard deviations."""
TOLERANCE = 1e-3
"""Nats by which a knot may differ from its prediction where its cluster counts.

The knot is then used itself, which leaves about a sixteenth of that. `DROP_SCALE` nats below the
best cluster of its detections the tolerance is twice as large, and it grows with the square of that
drop: what nobody would choose need not be known well.
"""
DROP_SCALE = 15.0
MAX_HALVINGS = 16
NARROWEST = 0.05
"""Standard deviation of the narrowest bump in ln r, as a share of the smallest sigma.

From D nats down its flank the top is sqrt(2 D) standard deviations away. An interval too short to
hide a top in its middle is left as it is, however rough.
"""
CHUNK = 4096
"""Integrals taken at a time, by whatever worker: so the table hangs on no executor."""


@dataclass(frozen=True)
class ClusterTable:
    """Log integrals of C clusters of detections, as functions of ln r.

    Attributes
    ----------
    entries : (C, 3) detection of each scan, -1 where missed.
    first_knot : (C + 1,) where each cluster's knots begin in `knots` and `values`.
    knots : (K,) log ratios, ascending within a cluster, from the same first to the same last.
    values : (K,) log integrals there.
    levels : (C,) the most that the worst off of a cluster's detections reaches with any cluster.
    """

    entries: IntArray
    first_knot: IntArray
    knots: FloatArray
    values: FloatArray
    levels: FloatArray

    @classmethod
    def of_knots(
        cls, entries: IntArray, owner: IntArray, knots: FloatArray, values: FloatArray
    ) -> ClusterTable:
        """Return the table of knots that are sorted by their clusters, `owner` (K,)."""
        first_knot = np.searchsorted(owner, np.arange(len(entries) + 1))
        tops = np.maximum.reduceat(values, first_knot[:-1]) if len(entries) else np.empty(0)
        return cls(entries, first_knot, knots, values, _best_of_detections(entries, tops))

    @property
    def n_clusters(self) -> int:
        """Number of clusters."""
        return len(self.entries)

    @property
    def reach(self) -> tuple[float, float]:
        """First and last log ratio."""
        return float(self.knots[0]), float(self.knots[-1])

    @property
    def owner(self) -> IntArray:
        """(K,) cluster of each knot."""
        return np.repeat(np.arange(self.n_clusters), np.diff(self.first_knot))

    def at(self, clusters: IntArray, log_ratios: FloatArray) -> FloatArray:
        """Return the (c, q) log integrals of some clusters at q log ratios inside the reach."""
        if len(clusters) == 0:
            return np.empty((0, len(log_ratios)))
        span = 2.0 * (self.knots[-1] - self.knots[0]) + 1.0
        offset = span * np.arange(self.n_clusters)
        keys = self.knots + np.repeat(offset, np.diff(self.first_knot))
        wanted = np.asarray(log_ratios)[None, :] + offset[clusters][:, None]
        right = np.searchsorted(keys, wanted, side="right")
        left = np.clip(
            right - 1,
            self.first_knot[clusters][:, None],
            self.first_knot[clusters + 1][:, None] - 2,
        )
        owner = np.broadcast_to(clusters[:, None], left.shape)
        return self._cubic(owner, left, np.broadcast_to(log_ratios, left.shape))

    def curvature(self) -> FloatArray:
        """(K,) magnitude of the second derivative about each knot, by divided differences."""
        left = np.clip(
            np.arange(len(self.knots)) - 1,
            self.first_knot[self.owner],
            self.first_knot[self.owner + 1] - 3,
        )
        x, f = (array[left[:, None] + np.arange(3)] for array in (self.knots, self.values))
        slopes = np.diff(f, axis=1) / np.diff(x, axis=1)
        return np.asarray(np.abs(2.0 * (slopes[:, 1] - slopes[:, 0]) / (x[:, 2] - x[:, 0])))

    def _cubic(self, owner: IntArray, left: IntArray, at: FloatArray) -> FloatArray:
        """Cubics through the two knots on either side of `at`, which follows knot `left`.

        Where the slopes on both sides do not announce an extremum, none is made up: a cubic next
        to a jump would overshoot by as much. And a top that they do announce never rises more than
        half of the way to what the cluster's detections reach elsewhere, and a nat: the halving saw
        to it that nothing higher hides between knots, while integrals of bearings that contradict
        each other by thousands of nats are rough.
        """
        first, last = self.first_knot[owner], self.first_knot[owner + 1] - 1
        start = np.clip(left - 1, first, last - 3)
        x = [self.knots[start + i] for i in range(4)]
        cubic = np.zeros(left.shape)
        for i in range(4):
            weight = self.values[start + i].copy()
            for j in range(4):
                if j != i:
                    weight *= (at - x[j]) / (x[i] - x[j])
            cubic += weight
        steps, width = self._slopes(), self.knots[left + 1] - self.knots[left]
        after = steps[np.minimum(left + 1, last - 1)]
        before = steps[np.maximum(left - 1, first)]
        margin = width * np.minimum(np.abs(before), np.abs(after))
        low = np.minimum(self.values[left], self.values[left + 1])
        high = np.maximum(self.values[left], self.values[left + 1])
        below = np.where((before < 0.0) & (after > 0.0), margin, 0.0)
        highest = 1.0 + 0.5 * np.maximum(self.levels[owner] - high, 0.0)
        above = np.where((before > 0.0) & (after < 0.0), np.minimum(margin, highest), 0.0)
        return np.asarray(np.clip(cubic, low - below, high + above))

    def _slopes(self) -> FloatArray:
        """(K - 1,) slopes between knots; those from one cluster to the next mean nothing."""
        apart = np.diff(self.knots)
        return np.diff(self.values) / np.where(apart > 0.0, apart, 1.0)


def tabulate(
    scans: tuple[BearingScan, ...],
    sigmas: tuple[FloatArray, ...],
    model: ObservationModel,
    entries: IntArray,
    executor: Executor | None = None,
) -> ClusterTable:
    """Integrate (C, 3) clusters of three scans at as many ratios as each needs.

    `sigmas` has the standard deviations of each scan's detections, radians. Each interval between
    knots is halved until its middle is what the neighbours say, to `TOLERANCE`. The executor
    shares the integrals out; the table is the same with any.

    Source: docs/method.md, section 4.
    """
    seen = entries != MISSED
    rays, spreads = np.zeros(entries.shape), np.ones(entries.shape)
    for k, (scan, sigma) in enumerate(zip(scans, sigmas, strict=True)):
        rays[seen[:, k], k] = scan.bearings[entries[seen[:, k], k]]
        spreads[seen[:, k], k] = sigma[entries[seen[:, k], k]]

    integrate = partial(
        log_cluster_integrals,
        prior_centre=model.landmark_centre,
        prior_sigma=model.landmark_sigma,
    )

    def integrals(owner: IntArray, log_ratios: FloatArray) -> FloatArray:
        positions = np.zeros((len(owner), 3))
        positions[:, 1] = 1.0
        positions[:, 2] = 1.0 + np.exp(np.clip(log_ratios, -FARTHEST, FARTHEST))
        cells = Cells(positions, rays[owner], spreads[owner], seen[owner])
        parts = [cells.take(index) for index in _chunks(len(cells))]
        return np.concatenate([np.empty(0), *ordered_map(executor, integrate, parts)])

    def log_prior(log_ratios: FloatArray) -> FloatArray:
        return np.asarray(-0.5 * ((log_ratios - model.log_step_mean) / model.log_step_sigma) ** 2)

    first = np.concatenate([-FIRST_KNOTS[:0:-1], FIRST_KNOTS])
    first = model.log_step_mean + model.log_step_sigma * first
    count = len(entries)
    if count == 0:
        nothing = np.empty(0)
        return ClusterTable.of_knots(entries, np.empty(0, np.int64), nothing, nothing)
    narrowest = NARROWEST * min(float(sigma.min(initial=np.pi)) for sigma in sigmas)
    owner = np.repeat(np.arange(count), len(first))
    knots = np.tile(first, count)
    values = integrals(owner, knots)
    is_open = np.tile(np.arange(len(first)) < len(first) - 1, count)
    for _ in range(MAX_HALVINGS):
        if not is_open.any():
            break
        table = ClusterTable.of_knots(entries, owner, knots, values)
        weighed = values + log_prior(knots)
        top = _best_of_detections(entries, np.maximum.reduceat(weighed, table.first_knot[:-1]))
        left = np.flatnonzero(is_open)
        middle = 0.5 * (knots[left] + knots[left + 1])
        predicted = table._cubic(owner[left], left, middle)
        found = integrals(owner[left], middle)
        drop = np.maximum(top[owner[left]] - (found + log_prior(middle)), 0.0)
        wrong = ~(np.abs(found - predicted) <= TOLERANCE * (1.0 + (drop / DROP_SCALE) ** 2))
        wrong &= middle - knots[left] > narrowest * np.sqrt(2.0 * drop)
        is_open[left] = wrong
        owner = np.insert(owner, left + 1, owner[left])
        knots = np.insert(knots, left + 1, middle)
        values = np.insert(values, left + 1, found)
        is_open = np.insert(is_open, left + 1, wrong)
    return ClusterTable.of_knots(entries, owner, knots, values)


def _chunks(count: int) -> list[IntArray]:
    return [np.arange(i, min(i + CHUNK, count)) for i in range(0, count, CHUNK)]


def _best_of_detections(entries: IntArray, top: FloatArray) -> FloatArray:
    """For each cluster the best that the worst off of its detections can have, (C,)."""
    worst = np.full(len(entries), np.inf)
    for column in entries.T:
        seen = column != MISSED
        best = np.full(int(column.max(initial=MISSED)) + 1, -np.inf)
        np.maximum.at(best, column[seen], top[seen])
        worst[seen] = np.minimum(worst[seen], best[column[seen]])
    return worst
