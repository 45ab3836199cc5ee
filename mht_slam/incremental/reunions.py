"""Reunions: landmarks of the smoothed run that are one, by the covariance of its graph."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.sightings import Sightings, sightings_of
from mht_slam.incremental.whole_run import WholeRun

GATE = 5.0
"""Standard deviations within which two landmarks may be one."""
SHARP = 1e-6
"""Least variance of a difference, in squares of the model's landmark deviation."""


@dataclass(frozen=True)
class Reunion:
    """Two landmarks that are one.

    Attributes
    ----------
    kept, given_up : their numbers; the one first seen earlier is kept.
    log_odds : nats in favour, given the reunions before it.
    """

    kept: int
    given_up: int
    log_odds: float


def find_reunions(whole: WholeRun, config: SlamConfig) -> list[Reunion]:
    """Return pairs of landmarks that are rather one than two, the surest first.

    Of two landmarks that no scan sees together, at x_a and x_b, b first seen later, the odds are

        N(x_a - x_b; 0, S) / p0(x_b)  W(scans of both) / (W(scans of a) W(scans of b)),

    S the covariance of the difference in the linearised graph of the whole run, p0 the prior of a
    landmark's place about the pose that sees it first, W as in `Sightings`. The surest pair is
    taken for one, by conditioning the Gaussian over all landmarks on x_a = x_b, which carries the
    drift between them over to all others; then the next one, until none has odds above one.

    Source: docs/method.md, section 5, and docs/incremental.md.
    """
    n = len(whole.points)
    if n < 2:
        return []
    covariance = landmark_covariance(whole)
    pairs, constants = _pairs(whole, covariance, config)
    mean = whole.points.ravel().copy()
    least = SHARP * config.observation_model.landmark_sigma**2 * np.eye(2)
    found: list[Reunion] = []
    while len(pairs):
        points = mean.reshape(n, 2)
        a, b = pairs.T
        odds = constants + _log_meet(points[a] - points[b], _differences(covariance, pairs) + least)
        best = int(np.argmax(odds))
        if not odds[best] > 0.0:
            break
        i, j = pairs[best]
        found.append(Reunion(int(whole.numbers[i]), int(whole.numbers[j]), float(odds[best])))
        mean, covariance = _made_one(mean, covariance, i, j, least)
        rest = ~np.isin(pairs, (i, j)).any(axis=1)
        pairs, constants = pairs[rest], constants[rest]
    return found


def landmark_covariance(whole: WholeRun) -> FloatArray:
    """(2 n, 2 n) covariance of all landmarks together, x and y in turn, of the linearised graph."""
    linear = whole.graph.linearize(whole.values)
    rows, columns, entries = linear.sparseJacobian_()
    # GTSAM counts from one, sorts keys by letter, l before x, and appends the right-hand side.
    unknowns, n = 2 * len(whole.points) + 3 * len(whole.poses), 2 * len(whole.points)
    left = columns <= unknowns
    at = rows[left].astype(np.int64) - 1, columns[left].astype(np.int64) - 1
    jacobian = csc_array((entries[left], at), shape=(int(rows.max()), unknowns))
    factor = splu((jacobian.T @ jacobian).tocsc())
    covariance = factor.solve(np.eye(unknowns, n))[:n]
    return np.asarray(0.5 * (covariance + covariance.T))


def _pairs(
    whole: WholeRun, covariance: FloatArray, config: SlamConfig
) -> tuple[IntArray, FloatArray]:
    """(p, 2) pairs that may be one, the first seen first, and what of their odds stays the same."""
    sightings = Sightings(whole, config)
    seen = sightings_of(whole.owners)
    numbers = whole.numbers.tolist()
    scans = [[scan for scan, _ in seen[number]] for number in numbers]
    weights = [sightings.log_weight(*one) for one in zip(numbers, scans, strict=True)]
    i, j = np.triu_indices(len(scans), 1)
    later = np.array([seen_in[0] for seen_in in scans])
    swap = later[i] > later[j]
    pairs = np.where(swap[:, None], np.column_stack([j, i]), np.column_stack([i, j]))
    pairs = pairs[_near(whole.points, covariance, pairs)]
    kept: list[tuple[int, int]] = []
    constants: list[float] = []
    for a, b in pairs.tolist():
        if not set(scans[a]).isdisjoint(scans[b]):
            continue
        together = sightings.log_weight(numbers[a], sorted(scans[a] + scans[b]))
        place = _log_prior(whole, b, scans[b][0], config.observation_model.landmark_sigma)
        kept.append((a, b))
        constants.append(together - weights[a] - weights[b] - place)
    return np.array(kept, np.int64).reshape(-1, 2), np.array(constants)


def _near(points: FloatArray, covariance: FloatArray, pairs: IntArray) -> BoolArray:
    offset = points[pairs[:, 0]] - points[pairs[:, 1]]
    solved = np.linalg.solve(_differences(covariance, pairs), offset[..., None])[..., 0]
    return np.asarray((offset * solved).sum(axis=1) <= GATE**2)


def _log_prior(whole: WholeRun, landmark: int, scan: int, landmark_sigma: float) -> float:
    """Log density of a new landmark's place: any direction, half-normal range.

    Beyond one deviation taken as there: of what stands far off only the direction is known, and
    its estimated range is what a wide prior makes of it.
    """
    away = float(np.hypot(*(whole.points[landmark] - whole.poses[scan, :2])))
    reach = min(max(away, math.sqrt(SHARP) * landmark_sigma), landmark_sigma)
    log_range = 0.5 * math.log(2.0 / math.pi) - math.log(landmark_sigma)
    return log_range - 0.5 * (reach / landmark_sigma) ** 2 - math.log(2.0 * math.pi * reach)


def _differences(covariance: FloatArray, pairs: IntArray) -> FloatArray:
    """(p, 2, 2) covariances of the difference of two landmarks."""
    blocks = covariance.reshape(len(covariance) // 2, 2, -1, 2)
    a, b = pairs.T
    across = blocks[a, :, b]
    return np.asarray(blocks[a, :, a] + blocks[b, :, b] - across - across.transpose(0, 2, 1))


def _log_meet(offsets: FloatArray, covariances: FloatArray) -> FloatArray:
    """(p,) log densities of differences of zero."""
    solved = np.linalg.solve(covariances, offsets[..., None])[..., 0]
    determinants = np.linalg.slogdet(2.0 * math.pi * covariances)[1]
    return np.asarray(-0.5 * ((offsets * solved).sum(axis=1) + determinants))


def _made_one(
    mean: FloatArray, covariance: FloatArray, i: int, j: int, least: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Condition the Gaussian over all landmarks on two of them being in one place."""
    a, b = slice(2 * i, 2 * i + 2), slice(2 * j, 2 * j + 2)
    across = covariance[:, a] - covariance[:, b]
    gain = np.linalg.solve(across[a] - across[b] + least, across.T).T
    return mean - gain @ (mean[a] - mean[b]), covariance - gain @ across.T


def reunited(owners: Sequence[IntArray], reunions: Sequence[Reunion]) -> list[IntArray]:
    """Return the owners under the names that are kept."""
    names = {reunion.given_up: reunion.kept for reunion in reunions}
    return [
        np.array([names.get(number, number) for number in owner.tolist()], np.int64)
        for owner in owners
    ]
