"""Metres from baselines, after the fact: from a known step, a known distance, or odometry."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import FloatArray, finite_array, finite_number
from mht_slam.errors import OptionError


@dataclass(frozen=True)
class Scale:
    """Metres per unit of the estimate, with its standard deviation.

    Multiply poses' positions, landmarks and their standard deviations by `value`; headings stay.
    Several measurements combine with `combined`.

    Raises `OptionError` unless both are finite and `value` is positive.
    """

    value: float
    sigma: float

    def __post_init__(self) -> None:
        finite_number(self.value, "scale", above=0.0)
        finite_number(self.sigma, "scale sigma", at_least=0.0)


def scale_from_distance(
    first: FloatArray,
    second: FloatArray,
    distance: float,
    sigma: float,
    covariance: FloatArray | None = None,
) -> Scale:
    """Return the scale that a measured distance of two landmarks, or of two poses, gives.

    With d the estimated distance, its variance v and a measurement D of variance sigma^2, the scale
    is D / d and its relative variance sigma^2 / D^2 + v / d^2, to first order.

    Parameters
    ----------
    first, second : (2,) or longer; x and y count.
    distance, sigma : measured, metres.
    covariance : (2, 2) of the difference of the two estimated places; None: they are exact.

    Raises `OptionError` for places that coincide, and for numbers out of range.

    >>> scale_from_distance(np.array([0.0, 0.0]), np.array([0.0, 4.0]), 10.0, 0.1)
    Scale(value=2.5, sigma=0.025)
    """
    finite_number(distance, "distance", above=0.0)
    finite_number(sigma, "sigma", at_least=0.0)
    places = finite_array([first[:2], second[:2]], "places", OptionError, remedy="give two places")
    away = places[1] - places[0]
    estimated = float(np.hypot(*away))
    if not estimated > 0.0:
        raise OptionError("the two places coincide: their distance tells no scale, take others")
    along = away / estimated
    variance = 0.0 if covariance is None else float(along @ np.asarray(covariance) @ along)
    value = distance / estimated
    relative = math.hypot(sigma / distance, math.sqrt(max(variance, 0.0)) / estimated)
    return Scale(value, value * relative)


def scale_from_odometry(
    poses: FloatArray, lengths: Sequence[float | None], relative_sigma: float
) -> Scale:
    """Return the scale that an odometer gives: measured lengths of some steps.

    Least squares of ln(measured / estimated) with equal weights, each step's length good to
    `relative_sigma`: the scale is the geometric mean of the ratios.

    Parameters
    ----------
    poses : (m, 3) of the estimate.
    lengths : m - 1 measured lengths of the steps, metres; None where nothing was measured, and
        steps of no length are left out.

    Raises `OptionError` for another number of lengths, or where none is left.

    >>> poses = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0]])
    >>> scale_from_odometry(poses, [2.0, 4.0], 0.05).value
    2.0
    """
    finite_number(relative_sigma, "relative_sigma", above=0.0)
    if len(lengths) != len(poses) - 1:
        raise OptionError(f"{len(lengths)} lengths for {len(poses) - 1} steps: give one for each")
    estimated = np.hypot(*np.diff(np.asarray(poses)[:, :2], axis=0).T)
    ratios = [
        math.log(finite_number(measured, "length", at_least=0.0) / step)
        for measured, step in zip(lengths, estimated.tolist(), strict=True)
        if measured is not None and measured > 0.0 and step > 0.0
    ]
    if not ratios:
        raise OptionError("no step was measured: give the length of one at least")
    value = math.exp(float(np.mean(ratios)))
    return Scale(value, value * relative_sigma / math.sqrt(len(ratios)))


def combined(scales: Sequence[Scale]) -> Scale:
    """Return the scale that independent measurements give together: in logs, by precision.

    Raises `OptionError` where there is none, or one of no uncertainty at all.

    >>> combined([Scale(2.0, 0.1), Scale(2.0, 0.1)]).sigma < 0.08
    True
    """
    if not scales:
        raise OptionError("no scale is given: give one at least")
    relative = np.array([scale.sigma / scale.value for scale in scales])
    if not (relative > 0.0).all():
        raise OptionError("a scale has sigma 0: nothing is that sure, give its uncertainty")
    weights = relative**-2.0
    logs = np.log([scale.value for scale in scales])
    value = math.exp(float(weights @ logs / weights.sum()))
    return Scale(value, value / math.sqrt(float(weights.sum())))
