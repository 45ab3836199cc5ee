"""The most evidence that a straight path leaves an association, in closed form."""

from __future__ import annotations

import math

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.graph.problem import Problem


def log_evidence_bound(problem: Problem, table: IntArray) -> float:
    """Bound the log evidence of an association from above, misses and false alarms left out.

    A landmark on the left of a straight path is seen under bearings in [0, pi] that only grow while
    it is passed, one on the right under their mirror image. The least chi-squared of its bearings
    is at least that of the nearest such sequence, on the better side: an isotonic regression of
    those on that side, and the distance of the others from it. Priors integrate to one, so the
    evidence is at most the normalisers of the bearings times exp(-chi-squared / 2).

    Infinite, which bounds nothing, for anything but one straight run with exact headings and
    lateral positions and Gaussian bearings.

    Source: docs/method.md, sections 2 and 4.
    """
    model = problem.model
    exact = model.heading_sigma == 0.0 and model.lateral_sigma == 0.0
    gaussian = model.bearing_dof is None
    if model.motion != "straight" or problem.second_run is not None or not (exact and gaussian):
        return math.inf
    sightings = problem.sightings(table)
    total = 0.0
    for bearings, sigmas, seen in zip(
        sightings.bearings, sightings.sigmas, sightings.seen, strict=True
    ):
        weights = sigmas[seen] ** -2.0
        chi_squared = min(_chi_squared(sign * bearings[seen], weights) for sign in (1.0, -1.0))
        normaliser = np.log(sigmas[seen]).sum() + 0.5 * len(weights) * math.log(2.0 * math.pi)
        total -= float(normaliser) + 0.5 * chi_squared
    return total


def _chi_squared(bearings: FloatArray, weights: FloatArray) -> float:
    """Least chi-squared of bearings, in order of travel, of a landmark on the left."""
    left = bearings >= 0.0
    beyond = np.minimum(np.abs(bearings), math.pi - np.abs(bearings))[~left]
    others = float((weights[~left] * beyond**2).sum())
    return others + _isotonic_cost(bearings[left].tolist(), weights[left].tolist())


def _isotonic_cost(values: list[float], weights: list[float]) -> float:
    """Least weighted squared distance from a sequence that never falls: pool adjacent violators."""
    blocks: list[tuple[float, float, float]] = []  # mean, weight, cost
    for value, weight in zip(values, weights, strict=True):
        mean, total, cost = value, weight, 0.0
        while blocks and blocks[-1][0] > mean:
            other, other_weight, other_cost = blocks.pop()
            both = total + other_weight
            cost += other_cost + total * other_weight / both * (mean - other) ** 2
            mean = (total * mean + other_weight * other) / both
            total = both
        blocks.append((mean, total, cost))
    return sum(cost for _, _, cost in blocks)
