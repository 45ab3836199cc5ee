"""Integrals of landmarks whose bearings say little of their range, in bearing and log range."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.evidence.cells import LOG_ROOT_TURN, Cells, chunks, log_sum, wrapped
from mht_slam.evidence.cluster_modes import COMPACT, Modes

BEARING_REACH = 7.0
"""Half-width of the bearings' grid about the anchor's ray, in sigmas."""
BEARING_STEP = 0.7
"""The posterior is at most root three narrower, and a trapezoidal sum then off by a millionth."""
RANGE_STEP = 0.8
"""Step in the log range, times the change of the bearings per unit of it, in sigmas."""
SHARED_RANGE_STEP = 0.5
"""The same about each of several anchors: the bearings turn unevenly between them."""
CONTRADICTION = 6.0
"""Nats by which bearings must contradict the anchor's for its grid to be shifted."""
SHIFT_ITERATIONS = 2
SURVEY_STEP = 0.35
SURVEY_DROP = 18.0
"""Nats below a survey's top at which the range grid ends."""
MIN_RANGE = 1e-6
"""Nearest landmark considered, as a share of the landmark prior's standard deviation."""
FARTHEST = 6.5
"""Farthest one, in standard deviations from the prior's centre."""
APPROACH_ANGLE = math.radians(30.0)
"""A landmark close to one observation point is within this angle of it, seen from the others."""
APPROACH_NATS = 20.0
"""Nats that being so close may cost."""
SHARE_POWER = 4.0
"""Power of the inverse range in an anchor's share of a point."""
MOST_SENSITIVE = 300.0
PARALLAX_MARGIN = 4.0
"""Sigmas by which the bearings may change more than seen, for their errors."""


def wide_integrals(
    cells: Cells, mode: Modes, prior_centre: tuple[float, float], prior_sigma: float
) -> FloatArray:
    """Sum over bearing and log range from one anchor, or from each of several."""
    if len(cells) == 0:
        return np.empty(0)
    anchored = _anchors(cells, mode.nearest)
    index, about = np.nonzero(anchored)
    partners = anchored[index]
    partners[np.arange(len(index)), about] = False
    polar = _Polar(
        cells.take(index), about, partners, mode.sensitivity[index], prior_centre, prior_sigma
    )
    result = np.full(len(cells), -np.inf)
    np.logaddexp.at(result, index, polar.integrals())
    return result


def _anchors(cells: Cells, nearest: IntArray) -> BoolArray:
    """Which observation points a cell's grids are laid about, (B, 3).

    All that the landmark may be close to, which those are where all others look. Else it is far
    from all of them compared to their distances, and the one nearest to the mode will do, or
    without a mode the one farthest ahead.
    """
    row = np.arange(len(cells))
    approached = np.zeros(cells.seen.shape, dtype=np.bool_)
    for anchor in range(3):
        behind = cells.positions < cells.positions[:, anchor, None]
        off = np.abs(wrapped(cells.rays - np.where(behind, 0.0, math.pi)))
        excess = np.maximum(off - APPROACH_ANGLE, 0.0) / cells.sigmas
        excess[~cells.seen] = 0.0
        excess[:, anchor] = 0.0
        approached[:, anchor] = cells.seen[:, anchor] & (
            0.5 * (excess**2).sum(axis=1) < APPROACH_NATS
        )
    cosine = np.where(cells.seen, np.cos(cells.rays), 0.0)
    sine = np.where(cells.seen, np.sin(cells.rays), 0.0)
    mean = np.arctan2(sine.sum(axis=1), cosine.sum(axis=1))
    ahead = np.where(cells.seen, cells.positions * np.cos(mean)[:, None], -np.inf)
    alone = np.where(nearest >= 0, nearest, ahead.argmax(axis=1))
    none = np.flatnonzero(~approached.any(axis=1))
    approached[row[none], alone[none]] = True
    return approached


@dataclass(frozen=True)
class _Polar:
    """Cells about one anchor each, (B,) scans, which shares the plane with its (B, 3) `partners`.

    A share is large where the anchor is the nearest of them.
    """

    cells: Cells
    anchor: IntArray
    partners: BoolArray
    sensitivity: FloatArray
    prior_centre: tuple[float, float]
    prior_sigma: float

    def integrals(self) -> FloatArray:
        """Return the (B,) log integrals."""
        low, high, contradictory = self._survey()
        step = self._range_step()
        count = np.ceil((high - low) / step).astype(np.int64) + 1
        size = 2 * (4 * np.ceil(count / 4)).astype(np.int64) + contradictory
        half = math.ceil(BEARING_REACH / BEARING_STEP)
        t = np.linspace(-BEARING_REACH, BEARING_REACH, 2 * half + 1)
        log_t_step = math.log(float(t[1] - t[0]))
        result = np.empty(len(self.cells))
        for group in np.unique(size).tolist():
            members = np.flatnonzero(size == group)
            n_ranges, shifted = divmod(group, 2)
            steps = (high[members] - low[members]) / (n_ranges - 1)
            log_range = low[members, None] + steps[:, None] * np.arange(n_ranges)
            for part in chunks(len(members), n_ranges * len(t)):
                terms = self._log_terms(members[part], t, log_range[part], shifted=bool(shifted))
                result[members[part]] = log_sum(terms.reshape(len(part), -1)) + np.log(steps[part])
        return result + log_t_step

    def _survey(self) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Log ranges between which the mass lies, (B,) each, and whether bearings contradict.

        A coarse look at the best bearing of each range.
        """
        far = FARTHEST * self.prior_sigma + np.hypot(
            self._anchor_x() - self.prior_centre[0], self.prior_centre[1]
        )
        high = np.log(far)
        floor = math.log(MIN_RANGE * self.prior_sigma)
        step = np.minimum(SURVEY_STEP, 2.0 * self._range_step())
        low, top = np.empty(len(high)), np.empty(len(high))
        contradictory = np.zeros(len(high), dtype=np.bool_)
        count = np.ceil((high - floor) / step).astype(np.int64) + 1
        size = 16 * np.ceil(count / 16).astype(np.int64)
        for n_ranges in np.unique(size).tolist():
            members = np.flatnonzero(size == n_ranges)
            steps = (high[members] - floor) / (n_ranges - 1)
            log_range = floor + steps[:, None] * np.arange(n_ranges)
            for part in chunks(len(members), 4 * n_ranges):
                profile, shift = self._profile(members[part], log_range[part])
                kept = profile >= profile.max(axis=1, keepdims=True) - SURVEY_DROP
                first = kept.argmax(axis=1)
                last = n_ranges - 1 - kept[:, ::-1].argmax(axis=1)
                row = np.arange(len(part))
                low[members[part]] = log_range[part][row, np.maximum(first - 1, 0)]
                top[members[part]] = log_range[part][row, np.minimum(last + 1, n_ranges - 1)]
                contradictory[members[part]] = (kept & (shift != 0.0)).any(axis=1)
        return low, top, contradictory

    def _profile(self, part: IntArray, log_range: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log integrand at the best bearing of each log range (P, D), and that bearing's shift."""
        cells, anchor = self.cells.take(part), self.anchor[part]
        row = np.arange(len(part))
        distance = np.exp(log_range)
        shift, cost = _bearing_shift(cells, anchor, distance)
        alpha = cells.rays[row, anchor][:, None] + cells.sigmas[row, anchor][:, None] * shift
        x = cells.positions[row, anchor][:, None] + distance * np.cos(alpha)
        y = distance * np.sin(alpha)
        off_centre = (x - self.prior_centre[0]) ** 2 + (y - self.prior_centre[1]) ** 2
        profile = 2.0 * log_range - cost - 0.5 * off_centre / self.prior_sigma**2
        partners = self.partners[part]
        if partners.any():
            away = np.hypot(x[:, None] - cells.positions[:, :, None], y[:, None])
            nearest = np.where(partners[:, :, None], away, np.inf).min(axis=1)
            share = SHARE_POWER * (np.log(np.maximum(nearest, 1e-300)) - log_range)
            profile += np.minimum(share, 0.0)
        return np.asarray(profile), shift

    def _range_step(self) -> FloatArray:
        """Grid step that resolves the likelihood along a ray, (B,)."""
        seen = self.cells.seen
        row = np.arange(len(self.cells))
        turn = np.abs(np.sin(self.cells.rays - self.cells.rays[row, self.anchor][:, None]))
        apart = np.where(seen, turn / self.cells.sigmas, 0.0).max(axis=1)
        change = np.where(self.sensitivity > 0.0, self.sensitivity, np.minimum(apart, COMPACT))
        step = np.where(self.partners.any(axis=1), SHARED_RANGE_STEP, RANGE_STEP)
        return np.asarray(step / (np.minimum(change, MOST_SENSITIVE) + PARALLAX_MARGIN))

    def _anchor_x(self) -> FloatArray:
        return self.cells.positions[np.arange(len(self.cells)), self.anchor]

    def _log_terms(
        self, part: IntArray, t: FloatArray, log_range: FloatArray, *, shifted: bool
    ) -> FloatArray:
        """Log integrand (P, T, D) at deviations `t` of the anchor's bearing and (P, D) log ranges.

        In the coordinates t and log range, without the steps of the grid. With `shifted`, `t` is
        taken about what all bearings together say of each range.
        """
        cells, anchor, partners = self.cells.take(part), self.anchor[part], self.partners[part]
        row = np.arange(len(part))
        sigma, anchor_x = cells.sigmas[row, anchor], cells.positions[row, anchor]
        ray = cells.rays[row, anchor]
        distance = np.exp(log_range)[:, None, :]
        t = t[:, None]
        if shifted:
            t = t + _bearing_shift(cells, anchor, distance[:, 0, :])[0][:, None, :]
        alpha = ray[:, None, None] + sigma[:, None, None] * t
        x = distance * np.cos(alpha) + anchor_x[:, None, None]
        y = distance * np.sin(alpha)
        along = 2.0 * log_range - 2.0 * (LOG_ROOT_TURN + math.log(self.prior_sigma))
        terms = ((x - self.prior_centre[0]) ** 2 + (y - self.prior_centre[1]) ** 2) * (
            -0.5 / self.prior_sigma**2
        )
        terms += along[:, None, :]
        terms -= 0.5 * t**2 + LOG_ROOT_TURN
        nearness = np.zeros_like(terms) if partners.any() else np.empty(0)
        for scan in range(3):
            others = np.flatnonzero(cells.seen[:, scan] & (anchor != scan))
            if len(others) == 0:
                continue
            everyone = len(others) == len(part)
            px, py = (x, y) if everyone else (x[others], y[others])
            away = px - cells.positions[others, scan][:, None, None]
            off = np.arctan2(py, away)
            off -= cells.rays[others, scan][:, None, None]
            off -= (2.0 * math.pi) * np.rint(off * (0.5 / math.pi))
            off *= off
            off *= (-0.5 / cells.sigmas[others, scan] ** 2)[:, None, None]
            off -= (np.log(cells.sigmas[others, scan]) + LOG_ROOT_TURN)[:, None, None]
            if everyone:
                terms += off
            else:
                terms[others] += off
            sharing = partners[others, scan]
            if sharing.any():
                squared = np.maximum(away[sharing] ** 2 + py[sharing] ** 2, 1e-300)
                nearer = (distance[others[sharing]] ** 2 / squared) ** (0.5 * SHARE_POWER)
                nearness[others[sharing]] += nearer
        if partners.any():
            terms -= np.log1p(nearness)
        return np.asarray(terms)


def _bearing_shift(
    cells: Cells, anchor: IntArray, distance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Deviation of the anchor's bearing about which a grid holds the mass at (P, D) ranges.

    In sigmas: zero, whose grid reaches far enough, unless the best compromise of all bearings is
    better by `CONTRADICTION` nats. With it half the squared residuals, there or lower, (P, D).
    """
    row = np.arange(len(cells))
    ray, sigma = cells.rays[row, anchor][:, None], cells.sigmas[row, anchor][:, None]
    anchor_x = cells.positions[row, anchor][:, None]
    # The other two scans; the second may lack a sighting, then its weight is nothing.
    others = np.array([[1, 2], [0, 2], [0, 1]])[anchor]

    def misfit(t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Half the squared residuals, and gradient and Gauss-Newton curvature in t."""
        alpha = ray + sigma * t
        x, y = anchor_x + distance * np.cos(alpha), distance * np.sin(alpha)
        cost, gradient, curvature = 0.5 * t**2, t.copy(), np.ones_like(t)
        for scan in others.T:
            weight = np.where(cells.seen[row, scan], 1.0 / cells.sigmas[row, scan], 0.0)[:, None]
            away = x - cells.positions[row, scan][:, None]
            angle = np.arctan2(y, away)
            residual = wrapped(angle - cells.rays[row, scan][:, None]) * weight
            turn = np.cos(alpha - angle) * distance / np.sqrt(away**2 + y**2) * (sigma * weight)
            cost += 0.5 * residual**2
            gradient += residual * turn
            curvature += turn**2
        return cost, gradient, curvature

    t = np.zeros_like(distance)
    at_zero, gradient, curvature = misfit(t)
    cost = at_zero
    for _ in range(SHIFT_ITERATIONS):
        t = t - gradient / curvature
        cost, gradient, curvature = misfit(t)
    shifted = cost < at_zero - CONTRADICTION
    return np.where(shifted, t, 0.0), np.fmin(cost, at_zero)
