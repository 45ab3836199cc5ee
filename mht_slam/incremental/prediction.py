"""What each match of a new detection is worth, at every pose that the robot may have moved to."""

from __future__ import annotations

import math

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray
from mht_slam.compiled import compiled
from mht_slam.incremental.motion_terms import wrapped
from mht_slam.incremental.smoother import inverse_root


@compiled
def relative_landmarks(
    pose: FloatArray, places: FloatArray, centres: FloatArray, root: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Landmarks in the frame of the last pose, with their covariances.

    Parameters
    ----------
    pose : (3,) the last one; places, centres : (n, 2) landmarks as `smooth_window` keeps them.
    root : the last block of its last result, of landmarks and last pose.

    Returns
    -------
    (n, 2) x forward and y left; (n, 2, 2).
    """
    n = len(places)
    spread = inverse_root(root)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    relative, covariances = np.empty((n, 2)), np.empty((n, 2, 2))
    jacobian, half = np.empty((2, 5)), np.empty((2, 2 * n + 3))
    for j in range(n):
        reach = math.exp(places[j, 1])
        ex, ey = reach * math.cos(places[j, 0]), reach * math.sin(places[j, 0])
        dx, dy = centres[j, 0] + ex - pose[0], centres[j, 1] + ey - pose[1]
        x, y = c * dx + s * dy, -s * dx + c * dy
        relative[j, 0], relative[j, 1] = x, y
        jacobian[0, 0], jacobian[1, 0] = -c * ey + s * ex, s * ey + c * ex
        jacobian[0, 1], jacobian[1, 1] = c * ex + s * ey, -s * ex + c * ey
        jacobian[0, 2], jacobian[0, 3], jacobian[0, 4] = -c, -s, y
        jacobian[1, 2], jacobian[1, 3], jacobian[1, 4] = s, -c, -x
        first = 2 * j
        for i in range(2):
            for k in range(first, 2 * n + 3):
                total = jacobian[i, 0] * spread[first, k] + jacobian[i, 1] * spread[first + 1, k]
                for a in range(3):
                    total += jacobian[i, 2 + a] * spread[2 * n + a, k]
                half[i, k] = total
        for i in range(2):
            for m in range(2):
                total = 0.0
                for k in range(first, 2 * n + 3):
                    total += half[i, k] * half[m, k]
                covariances[j, i, m] = total
    return relative, covariances


@compiled
def match_gains(
    motions: FloatArray,
    turn_spread: float,
    side_spreads: FloatArray,
    relative: FloatArray,
    covariances: FloatArray,
    chances: FloatArray,
    half_view: float,
    farthest: float,
    bearings: FloatArray,
    sigmas: FloatArray,
    log_alone: float,
    dof: float,
    table: FloatArray,
    missed: FloatArray,
) -> None:
    """Log gains of matching a landmark over leaving both sides alone, for every proposed motion.

    The bearing of a landmark is predicted from its place in the frame of the last pose with its
    covariance, linearised, and spread by what a proposal stands for.

    Parameters
    ----------
    motions : (G, 3) forward, leftward, turn, in the frame of the last pose.
    turn_spread, side_spreads : deviations of heading, and (G,) of position, within a proposal.
    relative, covariances : (n, 2), (n, 2, 2), of `relative_landmarks`.
    chances : (n,) of a detection if the landmark is within view.
    half_view, farthest : half the angle of the field of view, and the range of sight.
    bearings, sigmas : (d,) of the new scan.
    log_alone : log weight of a detection that matches nothing.
    table : (G, at least n, d), of which the first n rows are filled.
    missed : (G,) filled with the log chance that none of the landmarks is detected.

    Source: docs/method.md, section 5.
    """
    heavy = math.isfinite(dof)
    height = -0.5 * math.log(2.0 * math.pi)
    if heavy:
        height = math.lgamma(0.5 * (dof + 1.0)) - math.lgamma(0.5 * dof)
        height -= 0.5 * math.log(dof * math.pi)
    for g in range(len(motions)):
        missed[g] = 0.0
        for j in range(len(relative)):
            x, y = relative[j, 0] - motions[g, 0], relative[j, 1] - motions[g, 1]
            squared = max(x * x + y * y, 1e-12)
            bearing = wrapped(math.atan2(y, x) - motions[g, 2])
            inside = abs(bearing) <= half_view and squared <= farthest * farthest
            log_missed = math.log1p(-chances[j]) if inside else 0.0
            missed[g] += log_missed
            sx, sy = -y / squared, x / squared
            variance = (
                sx * sx * covariances[j, 0, 0]
                + 2.0 * sx * sy * covariances[j, 0, 1]
                + sy * sy * covariances[j, 1, 1]
                + turn_spread * turn_spread / 3.0
                + min(1.0, side_spreads[g] * side_spreads[g] / squared)
            )
            log_seen = math.log(chances[j]) - log_missed - log_alone
            for d in range(len(bearings)):
                total = variance + sigmas[d] * sigmas[d]
                z = wrapped(bearings[d] - bearing)
                z = z * z / total
                noise = -0.5 * (dof + 1.0) * math.log1p(z / dof) if heavy else -0.5 * z
                table[g, j, d] = log_seen + noise + height - 0.5 * math.log(total)


@compiled
def pair_gains(
    motions: FloatArray,
    turn_spread: float,
    side_spreads: FloatArray,
    rays: FloatArray,
    ray_sigmas: FloatArray,
    log_together: FloatArray,
    landmark_sigma: float,
    nearest: float,
    bearings: FloatArray,
    sigmas: FloatArray,
    dof: float,
    table: FloatArray,
    first_row: int,
) -> None:
    """Log gains of making a landmark of an earlier single detection and a new one.

    There is no range until a second bearing gives parallax, so the new bearing is predicted from a
    row of log-spaced ranges, weighted by the prior, r^2 exp(-r^2 / 2 sigma^2) per log range.

    Parameters
    ----------
    rays : (s, 3) place of the observation point in the frame of the last pose, and direction.
    ray_sigmas : (s,) of the earlier bearings.
    log_together : (s,) log weights of the pair's pattern over both detections being alone.
    landmark_sigma, nearest : of the prior, and the shortest range tried.
    table : (G, first_row + s, d), of which the rows from `first_row` on are filled.

    The others are those of `match_gains`. Source: docs/method.md, section 5.
    """
    n_ranges = 14
    ratio = math.log(3.0 * landmark_sigma / nearest) / (n_ranges - 1)
    reaches, weights = np.empty(n_ranges), np.empty(n_ranges)
    for q in range(n_ranges):
        reaches[q] = nearest * math.exp(ratio * q)
        weights[q] = reaches[q] ** 2 * math.exp(-0.5 * (reaches[q] / landmark_sigma) ** 2)
    weights /= weights.sum()
    heavy = math.isfinite(dof)
    height = 1.0 / math.sqrt(2.0 * math.pi)
    if heavy:
        height = math.exp(math.lgamma(0.5 * (dof + 1.0)) - math.lgamma(0.5 * dof))
        height /= math.sqrt(dof * math.pi)
    mixed = np.empty(len(bearings))
    for i in range(len(rays)):
        c, s = math.cos(rays[i, 2]), math.sin(rays[i, 2])
        for g in range(len(motions)):
            mixed[:] = 0.0
            for q in range(n_ranges):
                r = reaches[q]
                x = rays[i, 0] + r * c - motions[g, 0]
                y = rays[i, 1] + r * s - motions[g, 1]
                squared = max(x * x + y * y, 1e-12)
                bearing = math.atan2(y, x) - motions[g, 2]
                along = r * (-y * c + x * s) / squared
                across = r * (y * s + x * c) / squared
                variance = (
                    (across * ray_sigmas[i]) ** 2
                    + (0.5 * ratio * along) ** 2
                    + turn_spread * turn_spread / 3.0
                    + min(1.0, side_spreads[g] * side_spreads[g] / squared)
                )
                for d in range(len(bearings)):
                    total = variance + sigmas[d] * sigmas[d]
                    z = wrapped(bearings[d] - bearing)
                    z = z * z / total
                    if z > 200.0:
                        continue
                    noise = (1.0 + z / dof) ** (-0.5 * (dof + 1.0)) if heavy else math.exp(-0.5 * z)
                    mixed[d] += weights[q] * height * noise / math.sqrt(total)
            for d in range(len(bearings)):
                table[g, first_row + i, d] = log_together[i] + math.log(max(mixed[d], 1e-300))


@compiled
def best_rows(table: FloatArray, offsets: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Bound, for every proposal, what its best matching gains; and say whether that is reached.

    The bound lets every detection take the row that gains most; where no two take the same row it
    is the best matching itself.
    """
    n_proposals, n_rows, n_detections = table.shape
    bounds, reached = np.empty(n_proposals), np.ones(n_proposals, np.bool_)
    taken = np.empty(n_rows, np.int64)
    for g in range(n_proposals):
        bounds[g] = offsets[g]
        taken[:] = 0
        for d in range(n_detections):
            best, row = 0.0, -1
            for r in range(n_rows):
                if table[g, r, d] > best:
                    best, row = table[g, r, d], r
            bounds[g] += best
            if row >= 0:
                taken[row] += 1
                if taken[row] > 1:
                    reached[g] = False
    return bounds, reached
