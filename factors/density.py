"""Normalised Gaussian densities of factors and graphs.

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
    """Log of the normaliser of a factor's Gaussian: -sum ln(sigma_i sqrt(2 pi)).

    Directions with `FREE_SIGMA` or more are not measured and count for nothing. Robust noise models
    have no Gaussian normaliser; asking for one raises `TypeError`.
    """
    if not isinstance(factor, gtsam.NoiseModelFactor):
        raise TypeError(f"{type(factor).__name__} has no noise model")
    noise = factor.noiseModel()
    if not isinstance(noise, gtsam.noiseModel.Gaussian):
        raise TypeError(f"{type(noise).__name__} has no Gaussian normaliser")
    if isinstance(noise, gtsam.noiseModel.Diagonal):
        sigmas = noise.sigmas()
        measured = sigmas[sigmas < FREE_SIGMA]
        return float(-np.log(measured).sum() - len(measured) * HALF_LOG_2PI)
    log_det_root = float(np.log(np.abs(np.diag(noise.R()))).sum())
    return log_det_root - noise.dim() * HALF_LOG_2PI


def log_density(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> float:
    """Log of the product of all factors' normalised Gaussians at `values`."""
    normalisers = [log_normaliser(graph.at(i)) for i in range(graph.size())]
    return float(sum(normalisers) - graph.error(values))
