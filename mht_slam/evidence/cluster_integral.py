"""The two-dimensional integrals of many clusters of detections at many step ratios together.

A cluster is what one landmark is seen by in three scans of a straight run: one to three detections.
With the observation points at 0, 1 and 1 + r on the line of travel its integral is

    E(r) = Int p0(x) prod_seen N(z_k; h_k(x, r), sigma_k) dx

(docs/method.md, section 4). A *cell* is one cluster at one ratio. What
`mht_slam.evidence.landmark_integral` does for one landmark at many poses is done here for
thousands of unlike cells: each gets the coordinates that suit it, on a grid of its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray

COMPACT = 12.0
"""Change of some bearing per unit of log range, in sigmas, that makes a landmark compact.

A compact landmark is nearly Gaussian in two of its bearings, and its grid is laid about the mode.
"""
CLEAR = 7.0
"""Sigmas between the mode and the edges of those coordinates: no parallax, and the line of travel.
"""
MODE_REACH = 6.5
"""Half-width of a grid about the mode, in standard deviations of the posterior."""
MODE_STEP = 1.1
MODE_ITERATIONS = 16
SAME_MODE = 1e-3
"""Nats within which two pairs have found the same mode."""
MODE_TOLERANCE = 1e-3
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
CHUNK_NODES = 60_000
"""Grid points worked on together: what stays in the processor's cache."""

_LOG_ROOT_TURN = 0.5 * math.log(2.0 * math.pi)
_PAIRS = ((0, 1, 2), (0, 2, 1), (1, 2, 0))
"""Two scans that span the bearing coordinates, and the third."""


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


def log_cluster_integrals(
    cells: Cells, prior_centre: tuple[float, float], prior_sigma: float
) -> FloatArray:
    """Integrate the landmark of every cell out.

    Returns the (B,) log E. With a bearing that turns much per unit of log range, two bearings are
    the coordinates, in which the posterior is nearly Gaussian: a grid about its mode. Otherwise
    they are the bearing and the log range from the nearest observation point, in which a
    landmark known by its direction only, or close to the path, is a smooth function.

    Source: docs/method.md, section 4.
    """
    result = np.empty(len(cells))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
        mode = _find_modes(cells)
        compact = np.flatnonzero(mode.usable)
        result[compact] = _compact_integrals(
            cells.take(compact), mode.take(compact), prior_centre, prior_sigma
        )
        wide = np.flatnonzero(~mode.usable)
        result[wide] = _wide_integrals(cells.take(wide), mode.take(wide), prior_centre, prior_sigma)
    return result


@dataclass(frozen=True)
class _Modes:
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

    def take(self, index: IntArray) -> _Modes:
        return _Modes(
            self.first[index],
            self.second[index],
            self.third[index],
            self.t[index],
            self.slope[index],
            self.sensitivity[index],
            self.nearest[index],
            self.usable[index],
        )


def _find_modes(cells: Cells) -> _Modes:
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
    return _Modes(
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
        residual = _wrapped(np.arctan2(y, x - x_c) - ray_c) / sigma_c
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


def _compact_integrals(
    cells: Cells, mode: _Modes, prior_centre: tuple[float, float], prior_sigma: float
) -> FloatArray:
    """Sum over two bearings on a grid about the mode, whitened by the Gauss-Newton Hessian."""
    count = math.ceil(MODE_REACH / MODE_STEP)
    axis = np.linspace(-MODE_REACH, MODE_REACH, 2 * count + 1)
    u, v = (grid.ravel() for grid in np.meshgrid(axis, axis))
    inside = u**2 + v**2 <= MODE_REACH**2
    u, v, step = u[inside], v[inside], float(axis[1] - axis[0])
    result = np.empty(len(cells))
    for part in _chunks(len(cells), len(u)):
        some, at = cells.take(part), mode.take(part)
        row = np.arange(len(part))
        ray_a, ray_b, ray_c = (some.rays[row, k] for k in (at.first, at.second, at.third))
        sigma_a, sigma_b, sigma_c = (some.sigmas[row, k] for k in (at.first, at.second, at.third))
        x_a, x_b, x_c = (some.positions[row, k] for k in (at.first, at.second, at.third))
        full = some.seen[row, at.third]
        steepness = (at.slope**2).sum(axis=1)
        # (I + s s')^(-1/2) = I - shrink s s'
        shrink = np.where(steepness > 0.0, (1.0 - 1.0 / np.sqrt(1.0 + steepness)) / steepness, 0.0)
        across = at.slope[:, :1] * u + at.slope[:, 1:] * v
        t_a = at.t[:, :1] + u - (shrink * at.slope[:, 0])[:, None] * across
        t_b = at.t[:, 1:] + v - (shrink * at.slope[:, 1])[:, None] * across
        alpha = ray_a[:, None] + sigma_a[:, None] * t_a
        gamma = ray_b[:, None] + sigma_b[:, None] * t_b
        base = (x_b - x_a)[:, None]
        sine, sin_alpha, sin_gamma = np.sin(gamma - alpha), np.sin(alpha), np.sin(gamma)
        range_a = base * sin_gamma / sine
        x = x_a[:, None] + range_a * np.cos(alpha)
        y = range_a * sin_alpha
        log_terms = np.log(range_a * (base * sin_alpha / sine) / np.abs(sine))
        log_terms -= 0.5 * (t_a**2 + t_b**2)
        log_terms -= ((x - prior_centre[0]) ** 2 + (y - prior_centre[1]) ** 2) / (
            2.0 * prior_sigma**2
        )
        off = _wrapped(np.arctan2(y, x - x_c[:, None]) - ray_c[:, None]) / sigma_c[:, None]
        log_terms -= np.where(full[:, None], 0.5 * off**2, 0.0)
        meets = (range_a > 0.0) & (sin_alpha * sine > 0.0)
        constant = (
            2.0 * math.log(step)
            - 0.5 * np.log1p(steepness)
            - 4.0 * _LOG_ROOT_TURN
            - 2.0 * math.log(prior_sigma)
            - np.where(full, np.log(sigma_c) + _LOG_ROOT_TURN, 0.0)
        )
        result[part] = constant + _log_sum(np.where(meets, log_terms, -np.inf))
    return result


def _wide_integrals(
    cells: Cells, mode: _Modes, prior_centre: tuple[float, float], prior_sigma: float
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
        off = np.abs(_wrapped(cells.rays - np.where(behind, 0.0, math.pi)))
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
            for part in _chunks(len(members), n_ranges * len(t)):
                terms = self._log_terms(members[part], t, log_range[part], shifted=bool(shifted))
                result[members[part]] = _log_sum(terms.reshape(len(part), -1)) + np.log(steps[part])
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
            for part in _chunks(len(members), 4 * n_ranges):
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
        along = 2.0 * log_range - 2.0 * (_LOG_ROOT_TURN + math.log(self.prior_sigma))
        terms = ((x - self.prior_centre[0]) ** 2 + (y - self.prior_centre[1]) ** 2) * (
            -0.5 / self.prior_sigma**2
        )
        terms += along[:, None, :]
        terms -= 0.5 * t**2 + _LOG_ROOT_TURN
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
            off -= (np.log(cells.sigmas[others, scan]) + _LOG_ROOT_TURN)[:, None, None]
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
            residual = _wrapped(angle - cells.rays[row, scan][:, None]) * weight
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


def _chunks(n_cells: int, nodes: int) -> list[IntArray]:
    size = max(1, CHUNK_NODES // nodes)
    return [np.arange(i, min(i + size, n_cells)) for i in range(0, n_cells, size)]


def _log_sum(log_terms: FloatArray) -> FloatArray:
    """Log of the sum of exponentials over the last axis; -inf where all are."""
    top = log_terms.max(axis=-1)
    safe = np.where(np.isfinite(top), top, 0.0)
    total = np.exp(log_terms - safe[..., None]).sum(axis=-1)
    return np.asarray(np.where(np.isfinite(top), safe + np.log(total), -np.inf))


def _wrapped(angle: FloatArray) -> FloatArray:
    """Move angles by whole turns into about [-pi, pi], cheaper than `wrap_angle`."""
    return np.asarray(angle - (2.0 * math.pi) * np.rint(angle * (0.5 / math.pi)))
