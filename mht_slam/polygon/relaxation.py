"""Prices for detections: a bound on the best matching that no landmark's best pick alone gives.

The hypotheses of one base choice are matchings: every third landmark m takes one pick e with value
c_e, no detection d is in two of them. For any prices p_d the sum of the picks' values is

    sum_m c_e(m) = sum_m (c_e(m) - sum_{d in e(m)} p_d) + sum_d p_d [d is taken]
                <= sum_m max_e (c_e - sum_{d in e} p_d) + sum_d p_d,

with equality of the last terms where all detections are taken, and p_d >= 0 where some may be left
(Lagrangian relaxation of the axial assignment problem: Burkard, Dell'Amico and Martello,
"Assignment Problems", section 10.2). Subgradient steps lower the bound; the reduced values then
guide and prune the search for the matchings themselves.
"""

from __future__ import annotations

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.compiled import compiled

_ROUNDS = 60
_PATIENCE = 4
_LEAST_STEP = 0.02
_SCALE = 1.0
_MARGIN = 0.05
_PROGRESS = 1e-3


@compiled
def price_detections(
    begin: IntArray,
    end: IntArray,
    detections: IntArray,
    log_ratio: FloatArray,
    needed: float,
    is_open: BoolArray,
    all_taken: bool,
    price: FloatArray,
) -> float:
    """Write prices that bound the sum of log ratios; return the bound.

    The picks of landmark m are ``begin[m]`` to ``end[m]``; `detections` (N, C) names each pick's,
    among those that `is_open` (D,) allows. Stops as soon as the bound is below `needed`, which
    has to leave room for rounding.
    """
    price[:] = 0.0
    trial = price.copy()
    taken = np.empty(len(price))
    best = np.inf
    step, idle = 1.0, 0
    for _ in range(_ROUNDS):
        bound = _take_best(begin, end, detections, log_ratio, is_open, trial, taken)
        idle += 1
        if bound < best:
            if bound < best - _PROGRESS * step:
                idle = 0
            best = bound
            price[:] = trial
        if best < needed:
            break
        if idle >= _PATIENCE:
            step *= 0.5
            idle = 0
            trial[:] = price
            if step < _LEAST_STEP:
                break
        square = 0.0
        for d in range(len(taken)):
            if not all_taken and taken[d] < 0.0 and trial[d] <= 0.0:
                taken[d] = 0.0  # what is left over and free of charge does not matter
            square += taken[d] ** 2
        if square == 0.0:
            break  # a matching: the bound is its sum
        above = min(bound - needed, _SCALE) + _MARGIN
        for d in range(len(taken)):
            trial[d] += step * above / square * taken[d]
            if not all_taken:
                trial[d] = max(trial[d], 0.0)
    return best


@compiled
def _take_best(
    begin: IntArray,
    end: IntArray,
    detections: IntArray,
    log_ratio: FloatArray,
    is_open: BoolArray,
    price: FloatArray,
    taken: FloatArray,
) -> float:
    """The bound at some prices; writes how often more than once each open detection is taken."""
    bound = 0.0
    for d in range(len(taken)):
        taken[d] = -1.0 if is_open[d] else 0.0
        bound += price[d]
    for landmark in range(len(begin)):
        chosen, highest = begin[landmark], -np.inf
        for pick in range(begin[landmark], end[landmark]):
            value = reduced(log_ratio[pick], detections[pick], price)
            if value > highest:
                chosen, highest = pick, value
        bound += highest
        for detection in detections[chosen]:
            taken[detection] += 1.0
    return bound


@compiled
def reduced(log_ratio: float, detections: IntArray, price: FloatArray) -> float:
    """A pick's value less the prices of its detections."""
    for detection in detections:
        log_ratio -= price[detection]
    return log_ratio
