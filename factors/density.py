"""Normalised densities of factors and graphs.

A GTSAM error is half a squared Mahalanobis distance; the density it belongs to has a normaliser
too, and hypotheses whose normalisers differ cannot be compared without it.
"""

from __future__ import annotations

import math

import gtsam
import numpy as np

HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)
FREE_SIGMA = 1e6
"""Standard deviation that stands for "not measured".

Infinity would say it better, but GTSAM's archive cannot read it back, so that neither pickle nor
``graph.serialize()`` would survive. The information it adds is 1e-12.
"""


def log_normaliser(factor: gtsam.NonlinearFactor) -> float:
    """Log of the normaliser of a factor's density: -sum ln(sigma_i sqrt(2 pi)) for a Gaussian.

    Directions with `FREE_SIGMA` or more are not measured and count for nothing. A linear factor in
    a container counts as one of unit noise. Of the robust noise models Cauchy's is the density of
    Student's t (see `bearing`); the others belong to no density, and asking for one raises
    `TypeError`.
    """
    if isinstance(factor, gtsam.LinearContainerFactor):
        return -factor.dim() * HALF_LOG_2PI
    if not isinstance(factor, gtsam.NoiseModelFactor):
        raise TypeError(f"{type(factor).__name__} has no noise model")
    noise = factor.noiseModel()
    if isinstance(noise, gtsam.noiseModel.Robust):
        return _log_normaliser_of_t(noise)
    if not isinstance(noise, gtsam.noiseModel.Gaussian):
        raise TypeError(f"{type(noise).__name__} has no Gaussian normaliser")
    if isinstance(noise, gtsam.noiseModel.Diagonal):
        sigmas = noise.sigmas()
        measured = sigmas[sigmas < FREE_SIGMA]
        return float(-np.log(measured).sum() - len(measured) * HALF_LOG_2PI)
    log_det_root = float(np.log(np.abs(np.diag(noise.R()))).sum())
    return log_det_root - noise.dim() * HALF_LOG_2PI


def _log_normaliser_of_t(noise: gtsam.noiseModel.Robust) -> float:
    """Of one residual with Cauchy's loss.

    ln Gamma((nu + 1) / 2) - ln Gamma(nu / 2) - ln(nu pi) / 2 - ln sigma, with nu = k^2 - 1.
    Cauchy's weight at 1 is k^2 / (k^2 + 1), which tells k.
    """
    loss = noise.robust()
    if not isinstance(loss, gtsam.noiseModel.mEstimator.Cauchy):
        raise TypeError(f"{type(loss).__name__} belongs to no density")
    weight = loss.weight(1.0)
    dof = weight / (1.0 - weight) - 1.0
    sigma = float(noise.noise().sigmas()[0]) * math.sqrt((dof + 1.0) / dof)
    gammas = math.lgamma(0.5 * (dof + 1.0)) - math.lgamma(0.5 * dof)
    return gammas - 0.5 * math.log(dof * math.pi) - math.log(sigma)


def log_density(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> float:
    """Log of the product of all factors' normalised densities at `values`."""
    normalisers = [log_normaliser(graph.at(i)) for i in range(graph.size())]
    return float(sum(normalisers) - graph.error(values))
