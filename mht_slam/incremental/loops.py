"""Loops: newly settled landmarks recognised together as old ones, once their pattern says so."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.incremental.past import Committed, point_jacobians

INFLATION = 3.0
"""By how much the deviations of a drift are widened: a filter that linearised once is too sure."""
DRIFT_DOF = 3.0
"""Degrees of freedom of the drift's Student t: what went wrong unnoticed makes tails."""
FLOOR = 0.04
"""Least deviation between two estimates of one landmark, in units of the landmarks' spacing."""
GATE = 3.0
"""Deviations within which landmarks may meet."""
FARTHEST = 3.5
"""Drift looked for, in units of the landmarks' spacing."""
MOST_TURN = math.radians(25.0)
"""Drift in heading looked for."""
MOST_SEEDS = 2000
"""Alignments of two landmarks with two old ones that are counted out."""
MOST_TRIED = 24
"""Alignments, those under which most landmarks meet, that are weighed."""
MOST_ALIKE = 4
"""How many of them may take the new landmarks to about the same place."""
STRANGER = 1.0
"""Nats against a drift for every new landmark among the recognised ones that none of them is."""
FEWEST = 4
"""Landmarks that have to be recognised together."""


@dataclass(frozen=True, eq=False)
class Loop:
    """New landmarks that are old ones.

    Attributes
    ----------
    new, old : (p,) indices into the committed landmarks.
    log_odds : nats in favour.
    """

    new: IntArray
    old: IntArray
    log_odds: float


def find_loop(
    past: Committed,
    recent_since: int,
    threshold: float,
    seen_apart: Callable[[int, int], int | None],
    *,
    farthest: float = FARTHEST,
    most_turn: float = MOST_TURN,
) -> Loop | None:
    """Return the best set of landmarks, first seen since a scan, that old ones explain together.

    A rigid drift T takes the new landmarks to old ones. Its odds against all of them being new are

        p(T) prod_pairs N(T x_new - x_old) (2 pi)^(3/2) |H|^(-1/2) / density^pairs,

    the drift integrated out about its best value (H its information from the pairs), times the
    chance of missing for every new landmark in known territory that meets none. p(T) is wide: the
    covariance of the drift as the filter states it, inflated, with heavy tails. Only pairs whose
    stretches of time do not overlap and of which `seen_apart` (see `find_twins`) knows no scan that
    saw both. Drifts are sought up to `farthest` spacings and `most_turn` radians.

    None where the log odds stay below `threshold`, or where another alignment that disagrees comes
    within half of it. Source: docs/method.md, section 5.
    """
    points = past.points
    covariances, cross = _covariances(past)
    spread = np.sqrt(np.trace(covariances, axis1=1, axis2=2))
    recent = past.first_seen >= recent_since
    spacing = spacing_of(points[recent] if recent.sum() >= FEWEST else points)
    good = spread < spacing
    new = np.flatnonzero(good & recent)
    old = np.flatnonzero(good & ~recent)
    if len(new) < FEWEST or len(old) < FEWEST:
        return None
    offset = points[old][None] - points[new][:, None]  # (a, b, 2)
    near = np.hypot(offset[..., 0], offset[..., 1]) <= farthest * spacing
    near &= past.last_seen[old][None] < past.first_seen[new][:, None]
    rows, columns = np.nonzero(near)
    if len(rows) < FEWEST:
        return None
    seeds = _seeds(points, new[rows], old[columns], spacing, most_turn)
    found: list[tuple[float, IntArray, IntArray, bool]] = []
    known: set[bytes] = set()
    for one, two in seeds:
        pairs = _inliers(points, new, old, near, (rows, columns), (one, two), spacing)
        if len(pairs[0]) < FEWEST:
            continue
        key = np.stack(pairs).tobytes()
        if key in known:
            continue
        known.add(key)
        log_odds = _log_odds(points, cross, new, old, pairs, spacing)
        found.append((log_odds, *pairs, False))
    while found:
        found.sort(key=lambda entry: -entry[0])
        log_odds, first, second, checked = found[0]
        if log_odds < threshold:
            return None
        if checked:
            break
        numbers = zip(past.ids[new[first]].tolist(), past.ids[old[second]].tolist(), strict=True)
        apart = np.array([seen_apart(one, other) is not None for one, other in numbers])
        first, second = first[apart], second[apart]
        if len(first) < FEWEST:
            del found[0]
            continue
        if not apart.all():  # two landmarks are no pair: what is left has to earn the odds
            log_odds = _log_odds(points, cross, new, old, (first, second), spacing)
        found[0] = (log_odds, first, second, True)
    else:
        return None
    mine = set(zip(first.tolist(), second.tolist(), strict=True))
    for other, a, b, _ in found[1:]:
        theirs = set(zip(a.tolist(), b.tolist(), strict=True))
        if len(theirs & mine) <= len(theirs) // 2 and other > log_odds - 0.5 * threshold:
            return None
    return Loop(new[first], old[second], log_odds)


def find_twins(
    past: Committed,
    chosen: IntArray,
    seen_apart: Callable[[int, int], int | None],
    detection_probability: float,
    threshold: float,
) -> Loop | None:
    """Return two landmarks that stand in one place and never show together: one under two names.

    The log odds of a pair are those of its distance, against anywhere in a landmark's surroundings,
    and -ln(1 - P_D) for every scan, while both were known, that saw just one of them.

    Parameters
    ----------
    chosen : indices of the landmarks looked at.
    seen_apart : of two landmark numbers, how many scans saw one without the other while both were
        known; None where some scan saw both.
    """
    points = past.points[chosen]
    if len(points) < 2:
        return None
    spacing = spacing_of(points)
    away = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    best: Loop | None = None
    for i, j in np.argwhere(np.triu(away < 0.5 * spacing, 1)).tolist():
        a, b = int(chosen[i]), int(chosen[j])
        apart = seen_apart(int(past.ids[a]), int(past.ids[b]))
        if apart is None:
            continue
        covariance = _difference(past, a, b) + (FLOOR * spacing) ** 2 * np.eye(2)
        offset = points[j] - points[i]
        log_odds = (
            -0.5 * float(offset @ np.linalg.solve(covariance, offset))
            - 0.5 * float(np.linalg.slogdet(2.0 * math.pi * covariance)[1])
            + 2.0 * math.log(spacing)
            - apart * math.log1p(-min(detection_probability, 0.99))
        )
        if log_odds >= threshold and (best is None or log_odds > best.log_odds):
            new, old = (a, b) if past.first_seen[a] > past.first_seen[b] else (b, a)
            best = Loop(np.array([new]), np.array([old]), log_odds)
    return best


def _difference(past: Committed, a: int, b: int) -> FloatArray:
    """(2, 2) covariance of the difference of two landmarks."""
    jacobians = point_jacobians(past.places[[a, b]])
    jacobian = np.concatenate([jacobians[0], -jacobians[1]], axis=1)
    at = [6 + 2 * a, 7 + 2 * a, 6 + 2 * b, 7 + 2 * b]
    return np.asarray(jacobian @ past.covariance[np.ix_(at, at)] @ jacobian.T)


def _covariances(past: Committed) -> tuple[FloatArray, FloatArray]:
    """(n, 2, 2) covariances of all points, and the (2 n, 2 n) one of all together."""
    jacobians = point_jacobians(past.places)
    n = len(jacobians)
    blocks = past.covariance[6:, 6:].reshape(n, 2, n, 2)
    half = np.einsum("nab,nbmc->namc", jacobians, blocks)
    joint = np.einsum("namc,mdc->namd", half, jacobians)
    own = np.ascontiguousarray(joint[np.arange(n), :, np.arange(n), :])
    return own, joint


def spacing_of(points: FloatArray) -> float:
    """Return the median distance from a landmark to the next one; 1 without two."""
    if len(points) < 2:
        return 1.0
    away = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    np.fill_diagonal(away, np.inf)
    return float(np.median(away.min(axis=1)))


def _seeds(
    points: FloatArray, new: IntArray, old: IntArray, spacing: float, most_turn: float
) -> list[tuple[int, int]]:
    """Pairs of candidate pairs whose distances agree, those first under which most pairs meet."""
    a, b = points[new], points[old]
    i, j = np.triu_indices(len(new), 1)
    fine = (new[i] != new[j]) & (old[i] != old[j])
    i, j = i[fine], j[fine]
    da, db = a[j] - a[i], b[j] - b[i]
    la, lb = np.hypot(*da.T), np.hypot(*db.T)
    turn = np.arctan2(da[:, 0] * db[:, 1] - da[:, 1] * db[:, 0], (da * db).sum(axis=1))
    fine = (np.abs(la - lb) <= 2.0 * GATE * FLOOR * spacing) & (la > spacing)
    fine &= np.abs(turn) <= most_turn
    i, j, turn = i[fine], j[fine], turn[fine]
    drift = np.hypot(*(0.5 * (b[i] + b[j] - a[i] - a[j])).T) / spacing
    order = np.argsort(drift + np.abs(turn) / most_turn, kind="stable")[:MOST_SEEDS]
    i, j, turn = i[order], j[order], turn[order]
    cosine, sine = np.cos(turn), np.sin(turn)
    start, end = 0.5 * (a[i] + a[j]), 0.5 * (b[i] + b[j])
    x = a[None, :, 0] - start[:, None, 0]
    y = a[None, :, 1] - start[:, None, 1]
    x, y = (
        cosine[:, None] * x - sine[:, None] * y + end[:, None, 0] - b[None, :, 0],
        sine[:, None] * x + cosine[:, None] * y + end[:, None, 1] - b[None, :, 1],
    )
    votes = (x * x + y * y <= (GATE * FLOOR * spacing) ** 2).sum(axis=1)
    # Many seeds are one alignment: without a limit they would crowd out those that disagree.
    away = a.mean(axis=0) - start
    middle = np.stack(
        [cosine * away[:, 0] - sine * away[:, 1], sine * away[:, 0] + cosine * away[:, 1]]
    )
    places = np.rint((middle.T + end) / (0.5 * spacing)).astype(np.int64)
    tried: Counter[tuple[int, ...]] = Counter()
    best: list[int] = []
    for k in np.argsort(-votes, kind="stable").tolist():
        place = tuple(places[k].tolist())
        if tried[place] < MOST_ALIKE and len(best) < MOST_TRIED:
            tried[place] += 1
            best.append(k)
    return list(zip(i[best].tolist(), j[best].tolist(), strict=True))


def _inliers(
    points: FloatArray,
    new: IntArray,
    old: IntArray,
    near: BoolArray,
    pairs: tuple[IntArray, IntArray],
    seed: tuple[int, int],
    spacing: float,
) -> tuple[IntArray, IntArray]:
    """Rows of `new` and `old` that meet under the rigid motion of two pairs, mutually nearest."""
    rows, columns = pairs
    a = points[new[rows[list(seed)]]]
    b = points[old[columns[list(seed)]]]
    for _ in range(2):
        turn, start, end = _rigid(a, b)
        c, s = math.cos(turn), math.sin(turn)
        moved = (points[new] - start) @ np.array([[c, s], [-s, c]]) + end
        away = np.hypot(*(moved[:, None] - points[old][None]).transpose(2, 0, 1))
        away[~near] = np.inf
        best = away.argmin(axis=1)
        mutual = away.argmin(axis=0)[best] == np.arange(len(new))
        first = np.flatnonzero(mutual & (away[np.arange(len(new)), best] <= GATE * FLOOR * spacing))
        if len(first) < 2:
            return np.empty(0, np.int64), np.empty(0, np.int64)
        a, b = points[new[first]], points[old[best[first]]]
    return first, best[first]


def _rigid(a: FloatArray, b: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Turn about the mean of a, and both means, that take a to b by least squares."""
    start, end = a.mean(axis=0), b.mean(axis=0)
    x, y = a - start, b - end
    turn = math.atan2(float((x[:, 0] * y[:, 1] - x[:, 1] * y[:, 0]).sum()), float((x * y).sum()))
    return turn, start, end


def _log_odds(
    points: FloatArray,
    joint: FloatArray,
    new: IntArray,
    old: IntArray,
    pairs: tuple[IntArray, IntArray],
    spacing: float,
) -> float:
    first, second = new[pairs[0]], old[pairs[1]]
    a, b = points[first], points[second]
    turn, start, end = _rigid(a, b)
    p = len(first)
    arm = a - start
    jacobian = np.zeros((p, 2, 3))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
    jacobian[:, 0, 2], jacobian[:, 1, 2] = -arm[:, 1], arm[:, 0]
    flat = jacobian.reshape(-1, 3)
    difference = (
        joint[first][:, :, first]
        + joint[second][:, :, second]
        - joint[first][:, :, second]
        - joint[second][:, :, first]
    ).reshape(2 * p, 2 * p)
    regression = np.linalg.solve(flat.T @ flat, flat.T)
    of_drift = INFLATION**2 * regression @ difference @ regression.T
    rest = np.eye(2 * p) - flat @ regression
    variances = np.einsum("ij,jk,ik->i", rest, difference, rest) + (FLOOR * spacing) ** 2
    drift = np.array([*(end - start), turn])
    squared = float(drift @ np.linalg.solve(of_drift, drift))
    log_prior = (
        math.lgamma(0.5 * (DRIFT_DOF + 3.0))
        - math.lgamma(0.5 * DRIFT_DOF)
        - 1.5 * math.log(DRIFT_DOF * math.pi)
        - 0.5 * float(np.linalg.slogdet(of_drift)[1])
        - 0.5 * (DRIFT_DOF + 3.0) * math.log1p(squared / DRIFT_DOF)
    )
    c, s = math.cos(turn), math.sin(turn)
    residual = (arm @ np.array([[c, s], [-s, c]]) + end - b).ravel()
    log_meet = -0.5 * float((residual**2 / variances + np.log(2.0 * math.pi * variances)).sum())
    information = (flat / variances[:, None]).T @ flat
    log_volume = 1.5 * math.log(2.0 * math.pi) - 0.5 * float(np.linalg.slogdet(information)[1])
    log_density = -2.0 * math.log(spacing)
    # A new landmark amid those recognised, and no old one where it stands, speaks against.
    moved = (points[new] - start) @ np.array([[c, s], [-s, c]]) + end
    alone = np.ones(len(new), np.bool_)
    alone[pairs[0]] = False
    reach = np.hypot(*(moved[alone][:, None] - b[None]).transpose(2, 0, 1)).min(axis=1, initial=1e9)
    strangers = int((reach < 2.0 * spacing).sum())
    return log_prior + log_meet + log_volume - p * log_density - STRANGER * strangers
