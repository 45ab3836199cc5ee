"""The density of a bearing's error, Gaussian or with the heavy tails of Student's t."""

from __future__ import annotations

import math

import numpy as np

from mht_slam.arrays import FloatArray


def log_bearing_noise(squares: FloatArray, dof: float | None) -> FloatArray:
    """Log density of errors, in units of their scale, from their squares.

    ln N(0, 1) without `dof`; else ln t with that many degrees of freedom,
    ln Gamma((nu + 1) / 2) - ln Gamma(nu / 2) - ln(nu pi) / 2 - (nu + 1) / 2 ln(1 + z^2 / nu).
    """
    if dof is None:
        return np.asarray(-0.5 * (squares + math.log(2.0 * math.pi)))
    height = math.lgamma(0.5 * (dof + 1.0)) - math.lgamma(0.5 * dof)
    height -= 0.5 * math.log(dof * math.pi)
    return np.asarray(height - 0.5 * (dof + 1.0) * np.log1p(squares / dof))
