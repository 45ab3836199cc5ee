"""Over which step ratios evidence is summed: trapezoids for one association, panels for all."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.evidence.cluster_table import ClusterTable
from mht_slam.models import ObservationModel

NEGLIGIBLE = 45.0
"""Nats below the best association at which ratios, and clusters at them, are left out."""
SPREAD_STEP = 0.5
"""Trapezoidal step, in the narrowest spread that the posterior of ln r has anywhere that counts."""
COUNTS = 14.0
"""Nats below its top within which the shape of a posterior counts."""
MOST_NODES = 20_000
PANEL_NODES = 10
PANEL_SPREADS = 5.0
"""Widest panel, in the narrowest spread of any association that counts: two nodes a spread."""
FIRST_PANELS = 32
MAX_SPLITS = 16
MOST_PANELS = 500
"""From so many panels on none is halved any more: an ordinary scene has dozens.

Where scans contradict each other by millions of nats, the clusters' tables are rough and every
ratio may count, which would fill the memory.
"""


@dataclass(frozen=True)
class RatioGrid:
    """Log ratios (Q,) ascending, and the log of quadrature weight times step prior (Q,)."""

    log_ratios: FloatArray
    log_weights: FloatArray

    def __len__(self) -> int:
        return len(self.log_ratios)


def log_step_prior(log_ratios: FloatArray, model: ObservationModel) -> FloatArray:
    """Log density of ln r."""
    deviation = (log_ratios - model.log_step_mean) / model.log_step_sigma
    constant = math.log(model.log_step_sigma * math.sqrt(2.0 * math.pi))
    return np.asarray(-0.5 * deviation**2 - constant)


def association_log_evidence(
    table: ClusterTable, clusters: IntArray, model: ObservationModel
) -> float:
    """Log Int p(ln r) prod_clusters E(r) d ln r of one association, by the trapezoidal rule.

    The step is half the posterior's spread, read off the curvature of the clusters' integrals
    where the product is within `COUNTS` nats of its top; the ends are negligible.
    """
    if len(clusters) == 0:
        return 0.0
    owned = np.concatenate(
        [np.arange(table.first_knot[c], table.first_knot[c + 1]) for c in clusters]
    )
    knots = np.unique(table.knots[owned])
    values = table.at(clusters, knots).sum(axis=0) + log_step_prior(knots, model)
    top = values.max()
    if not np.isfinite(top):
        return -math.inf
    counted = values >= top - COUNTS
    low, high = knots[counted][[0, -1]]
    precision = 1.0 / model.log_step_sigma**2
    curvature = table.curvature()
    for c in clusters:
        own = slice(table.first_knot[c], table.first_knot[c + 1])
        inside = np.flatnonzero((table.knots[own] >= low) & (table.knots[own] <= high))
        about = np.unique(np.clip([inside - 1, inside, inside + 1], 0, None)) if len(inside) else ()
        last = table.first_knot[c + 1] - table.first_knot[c] - 1
        nearest = np.clip(np.searchsorted(table.knots[own], [low, high]), 0, last)
        chosen = np.unique(np.minimum(np.concatenate([about, nearest]).astype(np.int64), last))
        precision += float(curvature[own][chosen].max())
    kept = np.flatnonzero(values >= top - NEGLIGIBLE)
    start, end = knots[max(kept[0] - 1, 0)], knots[min(kept[-1] + 1, len(knots) - 1)]
    count = math.ceil((end - start) * math.sqrt(precision) / SPREAD_STEP) + 1
    grid = np.linspace(start, end, min(max(count, 64), MOST_NODES))
    terms = table.at(clusters, grid).sum(axis=0) + log_step_prior(grid, model)
    return float(logsumexp(terms) + math.log(grid[1] - grid[0]))


def panel_grid(
    table: ClusterTable,
    log_weights: FloatArray,
    rows: IntArray,
    is_required: BoolArray,
    row_alternative: FloatArray,
    model: ObservationModel,
    best: float,
) -> RatioGrid:
    """Gauss-Legendre panels on which every association that counts is resolved.

    Parameters
    ----------
    table : the clusters.
    log_weights : (C,) what each cluster weighs besides its integral.
    rows : (C,) the row each cluster belongs to; an association takes at most one of each row.
    is_required : (R,) whether a row must be taken, by a cluster or its alternative.
    row_alternative : (R,) log weight of taking no cluster of a row; -inf where impossible.
    best : log evidence that some association is known to have.

    A panel is left out where even the best cluster of every row together stays `NEGLIGIBLE` nats
    below `best`. It is halved while it is wider than `PANEL_SPREADS` of the narrowest posterior
    that the clusters alive in it could make.
    """
    low, high = table.reach
    edges = np.linspace(low, high, FIRST_PANELS + 1)
    open_panels = np.stack([edges[:-1], edges[1:]], axis=1)
    curvature = table.curvature()
    done = []
    for split in range(MAX_SPLITS + 1):
        if len(open_panels) == 0:
            break
        top = _panel_maxima(table, table.values, open_panels) + log_weights[:, None]
        sharpest = _panel_maxima(table, curvature, open_panels)
        row_top = np.repeat(row_alternative[:, None], len(open_panels), axis=1)
        np.maximum.at(row_top, rows, top)
        chosen = np.where(is_required[:, None], row_top, np.maximum(row_top, 0.0))
        bound = chosen.sum(axis=0) + log_step_prior(
            np.clip(model.log_step_mean, open_panels[:, 0], open_panels[:, 1]), model
        )
        width = open_panels[:, 1] - open_panels[:, 0]
        kept = bound + np.log(width) >= best - NEGLIGIBLE
        alive = bound - chosen[rows] + top >= best - NEGLIGIBLE
        row_precision = np.zeros_like(row_top)
        np.maximum.at(row_precision, rows, np.where(alive, sharpest, 0.0))
        precision = row_precision.sum(axis=0) + 1.0 / model.log_step_sigma**2
        last = split == MAX_SPLITS or len(open_panels) > MOST_PANELS
        resolved = (width * np.sqrt(precision) <= PANEL_SPREADS) | last
        done.append(open_panels[kept & resolved])
        rest = open_panels[kept & ~resolved]
        middle = rest.mean(axis=1)
        open_panels = np.concatenate(
            [np.stack([rest[:, 0], middle], axis=1), np.stack([middle, rest[:, 1]], axis=1)]
        )
    panels = np.concatenate(done)
    panels = panels[np.argsort(panels[:, 0])]
    x, w = np.polynomial.legendre.leggauss(PANEL_NODES)
    half = 0.5 * (panels[:, 1] - panels[:, 0])[:, None]
    log_ratios = (panels.mean(axis=1)[:, None] + half * x).ravel()
    log_steps = np.log(half * w).ravel()
    return RatioGrid(log_ratios, log_steps + log_step_prior(log_ratios, model))


def _panel_maxima(table: ClusterTable, values: FloatArray, panels: FloatArray) -> FloatArray:
    """Largest of the knots' values in each panel and next to it, (C, P)."""
    span = 2.0 * (table.knots[-1] - table.knots[0]) + 1.0
    offset = span * np.arange(table.n_clusters)
    keys = table.knots + np.repeat(offset, np.diff(table.first_knot))
    ends = offset[:, None, None] + panels
    first = np.searchsorted(keys, ends[:, :, 0], side="right") - 1
    last = np.searchsorted(keys, ends[:, :, 1], side="left")
    first = np.maximum(first, table.first_knot[:-1, None])
    last = np.minimum(last, table.first_knot[1:, None] - 1)
    bounds = np.stack([first, last + 1], axis=-1).ravel()
    padded = np.append(values, -np.inf)
    return np.asarray(np.maximum.reduceat(padded, bounds)[::2].reshape(first.shape))
