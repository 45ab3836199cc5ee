"""How well a list of associations, or the probabilities on it, speak of the truth."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from mht_slam.arrays import FloatArray, finite_array, whole_number
from mht_slam.comparison import rank_of_truth
from mht_slam.errors import OptionError

__all__ = ["brier_score", "log_score", "mean_reciprocal_rank", "rank_of_truth", "top_k_rate"]


def top_k_rate(ranks: Sequence[int | None], k: int) -> float:
    """Share of scenes whose truth is among the first `k`; k = 1 is the exact-match rate.

    `ranks` holds one rank per scene, from 1, None where the truth is not listed: that scene, and
    one on which the method failed, count as misses. Raises `OptionError` without scenes.

    >>> top_k_rate([1, 3, None, 2], k=2)
    0.5
    """
    whole_number(k, "k", at_least=1)
    return _mean([float(rank is not None and rank <= k) for rank in _checked(ranks)])


def mean_reciprocal_rank(ranks: Sequence[int | None]) -> float:
    """Mean of 1 / rank over scenes, 0 where the truth is not listed (None).

    >>> mean_reciprocal_rank([1, 2, None])
    0.5
    """
    return _mean([0.0 if rank is None else 1.0 / rank for rank in _checked(ranks)])


def brier_score(probabilities: npt.ArrayLike, truth: int | None) -> float:
    """Multiclass Brier score of one scene, in [0, 2]: 0 is certainty in the truth.

    `probabilities` is (n,) over the candidates and `truth` the index of the true one, or None
    where it is not among them: then it is a class that got probability 0.
    """
    p = _probabilities(probabilities, truth)
    return float((p**2).sum() - 2.0 * _of_truth(p, truth) + 1.0)


def log_score(probabilities: npt.ArrayLike, truth: int | None) -> float:
    """Natural logarithm of the truth's probability in one scene, at most 0.

    `probabilities` and `truth` are those of `brier_score`. Minus infinity where the truth got
    nothing.
    """
    p = _of_truth(_probabilities(probabilities, truth), truth)
    return math.log(p) if p > 0.0 else -math.inf


def _of_truth(probabilities: FloatArray, truth: int | None) -> float:
    return 0.0 if truth is None else float(probabilities[truth])


def _probabilities(probabilities: npt.ArrayLike, truth: int | None) -> FloatArray:
    p = finite_array(probabilities, "probabilities", OptionError, remedy="give probabilities")
    if p.ndim != 1:
        raise OptionError(f"probabilities has shape {p.shape}: give one per candidate")
    bad = np.flatnonzero((p < 0.0) | (p > 1.0))
    if len(bad):
        raise OptionError(f"probabilities[{bad[0]}] is {p[bad[0]]}: give values from 0 to 1")
    if truth is not None and not 0 <= truth < len(p):
        raise OptionError(f"truth is {truth}: give an index of the {len(p)} candidates, or None")
    return p


def _checked(ranks: Sequence[int | None]) -> Sequence[int | None]:
    for scene, rank in enumerate(ranks):
        if rank is not None:
            whole_number(rank, f"ranks[{scene}]", at_least=1)
    return ranks


def _mean(figures: list[float]) -> float:
    if not figures:
        raise OptionError("ranks is empty: give one rank, or None, per scene")
    return math.fsum(figures) / len(figures)
