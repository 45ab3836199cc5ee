"""Laplace's approximation: evidence and covariances from the Hessian at the optimum."""

from __future__ import annotations

import math
from dataclasses import dataclass

import gtsam
import numpy as np

from mht_slam import factors
from mht_slam.arrays import FloatArray

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
) -> Laplace:
    """Approximate the integral of a graph's density over all its variables.

    log Z = log p(Z, theta^) + (d / 2) log 2 pi - (1 / 2) log |H| with the Gauss-Newton Hessian H
    of the graph at the optimum theta^ and d unknowns (docs/method.md, section 4). All normalisers
    are kept. Where the optimum is one over other coordinates, `curvature` is the graph with the
    volumes of these, whose Hessian counts. Raises `SingularGraphError` naming the offending
    eigenvalues.
    """
    try:
        hessian = (graph if curvature is None else curvature).linearize(values).hessian()[0]
    except ValueError as cause:  # GTSAM takes a sigma below 1e-8 for an equation
        raise SingularGraphError(
            "a standard deviation in the graph is below 1e-8: give the model, or the scale, in "
            "larger units"
        ) from cause
    if not np.isfinite(hessian).all():
        raise SingularGraphError("the Hessian at the optimum is not finite")
    diagonal = np.diag(hessian)
    if not (diagonal > 0.0).all():
        raise SingularGraphError("the Hessian at the optimum has an empty row")
    scale = 1.0 / np.sqrt(diagonal)
    eigenvalues, vectors = np.linalg.eigh(hessian * scale * scale[:, None])
    low, high = float(eigenvalues[0]), float(eigenvalues[-1])
    if low <= 0.0 or high / low > CONDITION_LIMIT:
        raise SingularGraphError(
            f"the scaled Hessian at the optimum has eigenvalues from {low:.2g} to {high:.2g}: "
            "some direction is not observed"
        )
    log_determinant = float(np.log(eigenvalues).sum() + np.log(diagonal).sum())
    dimension = len(hessian)
    log_evidence = (
        factors.log_density(graph, values)
        + 0.5 * dimension * math.log(2.0 * math.pi)
        - 0.5 * log_determinant
    )
    covariance = ((vectors / eigenvalues) @ vectors.T) * scale * scale[:, None]
    return Laplace(log_evidence, log_determinant, covariance)
