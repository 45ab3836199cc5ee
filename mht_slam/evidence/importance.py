"""Integrals of positive functions of a few variables, by importance sampling about their modes.

Deterministic: the points are fixed quasi-random ones (Sobol, scrambled with a fixed seed), so the
same function gives the same number. The proposal is a mixture of multivariate t distributions, one
about each mode found, weighted by the balance heuristic (Veach and Guibas, 1995).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from scipy.special import gammaln, logsumexp
from scipy.stats import chi2, norm, qmc

from mht_slam.arrays import FloatArray, freeze

LogFunction: TypeAlias = Callable[[FloatArray], FloatArray]
"""Logarithm of the integrand at Q points, (Q, d) -> (Q,); -inf where it vanishes."""

N_POINTS = 128
"""Points drawn about each mode, half of them mirrored."""
DEGREES_OF_FREEDOM = 5.0
"""Of the t distributions: tails heavier than those of any posterior met."""
INFLATION = 1.15
"""The proposal is this much wider than the mode's Laplace approximation."""
ENOUGH = 0.3
"""Effective share of the points from which no further mode is looked for."""
TOO_FEW = 4.0
"""Effective number of points below which the sample says nothing and is refused."""
MAX_MODES = 4
NEW_MODE = 1.0
"""Distance from every known mode, in its standard deviations, from which a mode is a new one."""
STENCIL = 0.5
"""Step of the differences in Newton's method, in standard deviations of the first guess."""
FLATTEST = 0.05
"""Least curvature, in units of the first guess."""
NEWTON_STEPS = 12
SHORTEST_MOVE = 0.3
"""Newton step with which a mode counts as found, standard deviations."""
LONGEST_MOVE = 2.0
DESCENT = 0.5
"""Nats a Newton step may lose before it is halved: unchecked, steps leave a mode for good."""
HALVINGS = 6


@dataclass(frozen=True)
class Integral:
    """The logarithm of an integral, and how far to trust it.

    `error` is the standard error that independent points with these weights would give the
    logarithm, 0.0 for a sum that is exact to rounding. Quasi-random points do better; a mode that
    no point met is in no error.
    """

    log_value: float
    error: float


def integrate(
    log_function: LogFunction, near: FloatArray, covariance: FloatArray, mirror: FloatArray
) -> Integral | None:
    """Integrate exp(log_function) over all of R^d.

    Parameters
    ----------
    log_function : smooth, with a mode near `near`.
    near : (d,) where to look for it.
    covariance : (d, d) its rough extent there, positive definite.
    mirror : (d,) signs of a reflection. The points are closed under it, so that reflecting the
        integrand leaves the result the same to rounding.

    Returns None where the function vanishes at `near`, no mode is reached from there, `covariance`
    is not positive definite, or fewer than `TOO_FEW` points carry the sum, as from a `near` that
    lies far off. Where the points represent the function badly, more modes are sought from the
    point that carries the most weight.
    """
    try:
        root = _cholesky(covariance)
    except np.linalg.LinAlgError:
        return None
    mode = _find_mode(log_function, near, root)
    if mode is None:
        return None
    modes = [mode]
    offsets = _standard_points(len(near), tuple(mirror.tolist()))
    points = np.empty((0, len(near)))
    values = np.empty(0)
    while True:
        centre, spread = modes[-1]
        fresh = centre + offsets @ spread.T
        points = np.concatenate([points, fresh])
        values = np.concatenate([values, log_function(fresh)])
        log_weights = values - _log_mixture(points, modes)
        log_total = float(logsumexp(log_weights))
        if not math.isfinite(log_total):
            return None
        effective = math.exp(2.0 * log_total - float(logsumexp(2.0 * log_weights)))
        error = math.sqrt(max(1.0 / effective - 1.0 / len(points), 0.0))
        result = Integral(log_total - math.log(len(points)), error)
        if effective >= ENOUGH * len(points) or len(modes) == MAX_MODES:
            return result if effective >= TOO_FEW else None
        modes.append(_next_proposal(log_function, points[log_weights.argmax()], root, modes))


def _next_proposal(
    log_function: LogFunction,
    heaviest: FloatArray,
    root: FloatArray,
    modes: list[tuple[FloatArray, FloatArray]],
) -> tuple[FloatArray, FloatArray]:
    """A new mode near the point of most weight, or that point where it leads to a known mode."""
    found = _find_mode(log_function, heaviest, root)
    if found is not None:
        away = [np.linalg.norm(np.linalg.solve(s, found[0] - centre)) for centre, s in modes]
        if min(away) > NEW_MODE:
            return found
    return heaviest, modes[0][1]


def _find_mode(
    log_function: LogFunction, near: FloatArray, root: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Newton's method with derivatives by differences: a mode, and a root of its covariance.

    None where it does not arrive: points about a place on a flank say little of the integral.
    """
    d = len(near)
    i, j = np.triu_indices(d, 1)
    units = STENCIL * np.eye(d)
    same, opposite = units[i] + units[j], units[i] - units[j]
    stencil = np.concatenate([np.zeros((1, d)), units, -units, same, -same, opposite, -opposite])
    place = np.zeros(d)
    covariance = np.eye(d)
    for _ in range(NEWTON_STEPS):
        values = log_function(near + (place + stencil) @ root.T)
        if not np.isfinite(values).all():
            return None if not place.any() else (near + root @ place, root @ _cholesky(covariance))
        at, plus, minus = values[0], values[1 : d + 1], values[d + 1 : 2 * d + 1]
        gradient = (plus - minus) / (2.0 * STENCIL)
        hessian = np.diag((2.0 * at - plus - minus) / STENCIL**2)
        corners = values[2 * d + 1 :].reshape(4, len(i))
        mixed = (corners[2:].sum(axis=0) - corners[:2].sum(axis=0)) / (4.0 * STENCIL**2)
        hessian[i, j] = hessian[j, i] = mixed
        curvatures, vectors = np.linalg.eigh(hessian)
        covariance = (vectors / np.maximum(curvatures, FLATTEST)) @ vectors.T
        move = covariance @ gradient
        length = float(np.linalg.norm(move))
        move *= min(1.0, LONGEST_MOVE / max(length, 1e-12))
        for _ in range(HALVINGS):
            if log_function((near + root @ (place + move))[None])[0] >= at - DESCENT:
                break
            move *= 0.5
        place = place + move
        if length <= SHORTEST_MOVE:
            break
    else:
        return None
    return near + root @ place, root @ _cholesky(covariance)


def _cholesky(covariance: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.cholesky(0.5 * (covariance + covariance.T)), dtype=np.float64)


def _log_mixture(points: FloatArray, modes: list[tuple[FloatArray, FloatArray]]) -> FloatArray:
    """(Q,) log density of the equal mixture of t distributions."""
    d, nu = points.shape[1], DEGREES_OF_FREEDOM
    constant = gammaln(0.5 * (nu + d)) - gammaln(0.5 * nu) - 0.5 * d * math.log(nu * math.pi)
    parts = []
    for centre, root in modes:
        scale = INFLATION * root
        offset = np.linalg.solve(scale, (points - centre).T)
        log_volume = float(np.log(np.abs(np.diag(scale))).sum())
        tail = 0.5 * (nu + d) * np.log1p((offset**2).sum(axis=0) / nu)
        parts.append(constant - log_volume - tail)
    return np.asarray(logsumexp(parts, axis=0) - math.log(len(modes)), dtype=np.float64)


@lru_cache(maxsize=64)
def _standard_points(d: int, mirror: tuple[float, ...]) -> FloatArray:
    """(N_POINTS, d) quasi-random points of the standard t distribution, closed under `mirror`."""
    uniform = qmc.Sobol(d + 1, rng=0).random(N_POINTS // 2)
    uniform = np.clip(uniform, 1e-9, 1.0 - 1e-9)
    stretch = np.sqrt(DEGREES_OF_FREEDOM / chi2.ppf(uniform[:, d], DEGREES_OF_FREEDOM))
    half = INFLATION * norm.ppf(uniform[:, :d]) * stretch[:, None]
    points: FloatArray = freeze(np.concatenate([half, half * np.array(mirror)]))
    return points
