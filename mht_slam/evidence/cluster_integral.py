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

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.evidence.cells import LOG_ROOT_TURN, Cells, chunks, log_sum, wrapped
from mht_slam.evidence.cluster_modes import Modes, find_modes
from mht_slam.evidence.polar_integral import wide_integrals

MODE_REACH = 6.5
"""Half-width of a grid about the mode, in standard deviations of the posterior."""
MODE_STEP = 1.1


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
        mode = find_modes(cells)
        compact = np.flatnonzero(mode.usable)
        result[compact] = _compact_integrals(
            cells.take(compact), mode.take(compact), prior_centre, prior_sigma
        )
        wide = np.flatnonzero(~mode.usable)
        result[wide] = wide_integrals(cells.take(wide), mode.take(wide), prior_centre, prior_sigma)
    return result


def _compact_integrals(
    cells: Cells, mode: Modes, prior_centre: tuple[float, float], prior_sigma: float
) -> FloatArray:
    """Sum over two bearings on a grid about the mode, whitened by the Gauss-Newton Hessian."""
    count = math.ceil(MODE_REACH / MODE_STEP)
    axis = np.linspace(-MODE_REACH, MODE_REACH, 2 * count + 1)
    u, v = (grid.ravel() for grid in np.meshgrid(axis, axis))
    inside = u**2 + v**2 <= MODE_REACH**2
    u, v, step = u[inside], v[inside], float(axis[1] - axis[0])
    result = np.empty(len(cells))
    for part in chunks(len(cells), len(u)):
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
        off = wrapped(np.arctan2(y, x - x_c[:, None]) - ray_c[:, None]) / sigma_c[:, None]
        log_terms -= np.where(full[:, None], 0.5 * off**2, 0.0)
        meets = (range_a > 0.0) & (sin_alpha * sine > 0.0)
        constant = (
            2.0 * math.log(step)
            - 0.5 * np.log1p(steepness)
            - 4.0 * LOG_ROOT_TURN
            - 2.0 * math.log(prior_sigma)
            - np.where(full, np.log(sigma_c) + LOG_ROOT_TURN, 0.0)
        )
        result[part] = constant + log_sum(np.where(meets, log_terms, -np.inf))
    return result
