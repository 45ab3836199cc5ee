"""Laplace's approximation: evidence and covariances from the Hessian at the optimum."""

from __future__ import annotations

import math
from dataclasses import dataclass

import gtsam
import numpy as np
from scipy.linalg import lapack

from mht_slam import factors
from mht_slam.arrays import FloatArray
from mht_slam.compiled import compiled

CONDITION_LIMIT = 1e12
"""Condition of the Hessian, scaled to a unit diagonal, beyond which doubles say nothing.

Scaled, because a gauge of 1e-4 beside a landmark prior of 30 is no sign of trouble.
"""


@dataclass(frozen=True)
class Laplace:
    """Laplace's approximation of a graph at its optimum.

    Attributes
    ----------
    log_evidence : log density at the optimum + (d / 2) log 2 pi - (1 / 2) log |H|.
    log_determinant : log |H|.
    covariance : (d, d) inverse of H, blocks in sorted key order (landmarks before poses), poses
        in GTSAM's tangent space.
    """

    log_evidence: float
    log_determinant: float
    covariance: FloatArray


class SingularGraphError(ArithmeticError):
    """The Hessian is not positive definite, or too ill-conditioned to be trusted."""


def laplace(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    curvature: gtsam.NonlinearFactorGraph | None = None,
    log_density: float | None = None,
) -> Laplace:
    """Approximate the integral of a graph's density over all its variables.

    log Z = log p(Z, theta^) + (d / 2) log 2 pi - (1 / 2) log |H| with the Gauss-Newton Hessian H
    of the graph at the optimum theta^ and d unknowns (docs/method.md, section 4). All normalisers
    are kept. Where the optimum is one over other coordinates, `curvature` is the graph with the
    volumes of these, whose Hessian counts. `log_density` is the graph's at `values`, where the
    caller knows it. Raises `SingularGraphError` naming the offending eigenvalues.
    """
    try:
        hessian = (graph if curvature is None else curvature).linearize(values).hessian()[0]
    except ValueError as cause:  # GTSAM takes a sigma below 1e-8 for an equation
        raise SingularGraphError(
            "a standard deviation in the graph is below 1e-8: give the model, or the scale, in "
            "larger units"
        ) from cause
    log_determinant, covariance = _sound_inverse(hessian)
    dimension = len(hessian)
    if log_density is None:
        log_density = factors.log_density(graph, values)
    log_evidence = log_density + 0.5 * dimension * math.log(2.0 * math.pi) - 0.5 * log_determinant
    return Laplace(log_evidence, log_determinant, covariance)


def _sound_inverse(hessian: FloatArray) -> tuple[float, FloatArray]:
    """Log determinant and inverse of a symmetric matrix that is sound enough to be inverted.

    Scaled to a unit diagonal, its condition is at most its dimension times the trace of its
    inverse; so the eigenvalues are needed only where that says that there may be trouble.
    """
    scale, scaled = _scaled(hessian)
    root, order = lapack.dpotrf(scaled, lower=1)
    if order != 0:
        _check_sound(hessian)
        raise SingularGraphError("the Hessian at the optimum has no Cholesky factor")
    inverse_root = lapack.dtrtri(root, lower=1)[0]
    log_determinant, inverse, bound = _inverse(root, inverse_root, scale)
    if not bound <= CONDITION_LIMIT:
        _check_sound(hessian)
    return log_determinant, inverse


@compiled
def _scaled(hessian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What rows and columns are multiplied by for a unit diagonal, and the matrix so scaled."""
    scale = 1.0 / np.sqrt(np.diag(hessian))
    return scale, hessian * np.outer(scale, scale)


@compiled
def _inverse(
    root: FloatArray, inverse_root: FloatArray, scale: FloatArray
) -> tuple[float, FloatArray, float]:
    """Log determinant, inverse, and a bound of the scaled condition, from a Cholesky factor."""
    inverse = inverse_root.T @ inverse_root
    log_determinant = 2.0 * np.sum(np.log(np.diag(root)) - np.log(scale))
    return log_determinant, inverse * np.outer(scale, scale), len(scale) * np.trace(inverse)


def _check_sound(hessian: FloatArray) -> None:
    """Raise for whatever is wrong with a Hessian; return where nothing is."""
    diagonal = hessian.diagonal()
    if not math.isfinite(hessian.sum()):
        raise SingularGraphError("the Hessian at the optimum is not finite")
    if not diagonal.min() > 0.0:
        raise SingularGraphError("the Hessian at the optimum has an empty row")
    scale = 1.0 / np.sqrt(diagonal)
    eigenvalues = np.linalg.eigvalsh(hessian * np.outer(scale, scale))
    low, high = float(eigenvalues[0]), float(eigenvalues[-1])
    if low <= 0.0 or high / low > CONDITION_LIMIT:
        raise SingularGraphError(
            f"the scaled Hessian at the optimum has eigenvalues from {low:.2g} to {high:.2g}: "
            "some direction is not observed"
        )
