"""Intervals and tests for rates and paired differences, so that no table shows a bare number."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.stats import binomtest, bootstrap

from mht_slam.arrays import finite_array, finite_number, whole_number
from mht_slam.errors import OptionError

LEVEL = 0.95
"""Coverage of every interval unless the caller says otherwise."""

N_RESAMPLES = 10_000


class Interval(NamedTuple):
    """An estimate and the interval around it."""

    estimate: float
    low: float
    high: float


def wilson_interval(n_successes: int, n: int, level: float = LEVEL) -> Interval:
    """Rate of `n_successes` in `n` trials with Wilson's score interval (E. B. Wilson, 1927).

    Without trials the estimate is nan and the interval is all of [0, 1]. Raises `OptionError` for
    counts that are none, or a level outside (0, 1).

    >>> rate = wilson_interval(8, 10)
    >>> f"{rate.estimate:.2f} [{rate.low:.2f}, {rate.high:.2f}]"
    '0.80 [0.49, 0.94]'
    """
    n = whole_number(n, "n", at_least=0)
    n_successes = whole_number(n_successes, "n_successes", at_least=0)
    finite_number(level, "level", above=0.0, below=1.0)
    if n_successes > n:
        raise OptionError(f"n_successes is {n_successes} of {n}: give at most the trials")
    if n == 0:
        return Interval(float("nan"), 0.0, 1.0)
    bounds = binomtest(n_successes, n).proportion_ci(level, method="wilson")
    return Interval(n_successes / n, float(bounds.low), float(bounds.high))


def paired_bootstrap(
    first: npt.ArrayLike,
    second: npt.ArrayLike,
    *,
    rng: np.random.Generator,
    level: float = LEVEL,
    n_resamples: int = N_RESAMPLES,
) -> Interval:
    """Mean of ``first - second`` over the same scenes, with its percentile bootstrap interval.

    Parameters
    ----------
    first, second : (n,) figures of two methods, entry i of both from scene i; True counts 1.
    rng : source of the resamples.

    Raises `OptionError` unless both have the same scenes, two or more of them.
    """
    difference = _figures(first, "first") - _figures_like(second, first)
    finite_number(level, "level", above=0.0, below=1.0)
    if len(difference) < 2:
        raise OptionError(f"first has {len(difference)} scenes: an interval needs at least 2")
    resampled = bootstrap(
        (difference,),
        np.mean,
        n_resamples=whole_number(n_resamples, "n_resamples", at_least=1),
        batch=max(1, 1_000_000 // len(difference)),
        confidence_level=level,
        method="percentile",
        rng=rng,
    ).confidence_interval
    return Interval(float(difference.mean()), float(resampled.low), float(resampled.high))


def mcnemar(first: npt.ArrayLike, second: npt.ArrayLike) -> float:
    """Two-sided p-value of McNemar's exact test that two methods succeed equally often.

    `first` and `second` are (n,) successes on the same scenes. Only scenes where one method
    succeeds and the other fails count; without any the value is 1.0. Raises `OptionError` for
    entries other than True and False, or different numbers of scenes.
    """
    ours, theirs = _figures(first, "first"), _figures_like(second, first)
    for name, values in (("first", ours), ("second", theirs)):
        bad = np.flatnonzero((values != 0.0) & (values != 1.0))
        if len(bad):
            raise OptionError(f"{name}[{bad[0]}] is {values[bad[0]]}: give True or False")
    only_ours = int(((ours == 1.0) & (theirs == 0.0)).sum())
    n_discordant = int((ours != theirs).sum())
    return float(binomtest(only_ours, n_discordant).pvalue) if n_discordant else 1.0


def _figures_like(second: npt.ArrayLike, first: npt.ArrayLike) -> npt.NDArray[np.float64]:
    figures, n_first = _figures(second, "second"), np.size(first)
    if len(figures) != n_first:
        raise OptionError(f"first has {n_first} scenes and second {len(figures)}: pair them")
    return figures


def _figures(values: npt.ArrayLike, name: str) -> npt.NDArray[np.float64]:
    raw = np.asarray(values)
    figures = finite_array(
        raw.astype(np.float64) if raw.dtype.kind == "b" else raw,
        name,
        OptionError,
        remedy="give one figure per scene",
    )
    if figures.ndim != 1:
        raise OptionError(f"{name} has shape {figures.shape}: give one figure per scene")
    return figures
