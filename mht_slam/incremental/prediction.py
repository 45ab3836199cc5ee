"""What each match of a new detection is worth, at every pose that the robot may have moved to."""

from __future__ import annotations

import math

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
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
            total, log_total = 0.0, 0.0
            for d in range(len(bearings)):
                if d == 0 or sigmas[d] != sigmas[d - 1]:
                    total = variance + sigmas[d] * sigmas[d]
                    log_total = math.log(total)
                z = wrapped(bearings[d] - bearing)
                z = z * z / total
                noise = -0.5 * (dof + 1.0) * math.log1p(z / dof) if heavy else -0.5 * z
                table[g, j, d] = log_seen + noise + height - 0.5 * log_total


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
    row of log-spaced ranges, weighted by the prior, r exp(-r^2 / 2 sigma^2) per log range.

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
        weights[q] = reaches[q] * math.exp(-0.5 * (reaches[q] / landmark_sigma) ** 2)
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
def bounds_of(table: FloatArray, offsets: FloatArray) -> FloatArray:
    """Bound, for every proposal, what its best matching scores.

    Every detection takes the row that gains most, whether another takes it too or not.
    """
    n_proposals, n_rows, n_detections = table.shape
    bounds = offsets.copy()
    for g in range(n_proposals):
        for d in range(n_detections):
            best = 0.0
            for r in range(n_rows):
                best = max(best, table[g, r, d])
            bounds[g] += best
    return bounds


@compiled
def best_choices(
    gains: FloatArray, depth: int, floor: float, most_nodes: int
) -> tuple[int, FloatArray, IntArray]:
    """Find the `depth` best matchings of d detections whose gain is at least `floor`.

    Depth first over the detections, each of which takes a free row of positive gain or none, and
    never where even the best rows for the rest would fall short. Exact, and quick while a detection
    has few rows to choose from, which gating makes the normal case.

    Parameters
    ----------
    gains : (r, d); what is not positive is no match.
    most_nodes : steps after which it gives up.

    Returns
    -------
    count : matchings found; -1 where it gave up.
    totals, rows : (depth,) gains in falling order, and (depth, d) rows, -1 for none; the first
        `count` mean something.
    """
    n_rows, n_detections = gains.shape
    totals, rows = np.full(depth, -math.inf), np.full((depth, n_detections), -1, np.int64)
    order = np.full((n_detections, n_rows + 1), -1, np.int64)
    options = np.zeros(n_detections, np.int64)
    rest = np.zeros(n_detections + 1)
    for d in range(n_detections - 1, -1, -1):
        for r in range(n_rows):
            if gains[r, d] > 0.0:
                at = options[d]
                while at > 0 and gains[order[d, at - 1], d] < gains[r, d]:
                    order[d, at] = order[d, at - 1]
                    at -= 1
                order[d, at] = r
                options[d] += 1
        order[d, options[d]] = -1  # none, the last choice
        rest[d] = rest[d + 1] + (gains[order[d, 0], d] if options[d] else 0.0)
    taken = np.zeros(n_rows, np.bool_)
    choice, tried = np.full(n_detections, -1, np.int64), np.zeros(n_detections, np.int64)
    so_far = np.zeros(n_detections + 1)
    count, d, nodes = 0, 0, 0
    while d >= 0:
        nodes += 1
        if nodes > most_nodes:
            return -1, totals, rows
        least = max(floor, totals[depth - 1])
        if d == n_detections:
            total = so_far[d]
            if total >= floor and total > totals[depth - 1]:
                at = depth - 1
                while at > 0 and totals[at - 1] < total:
                    totals[at] = totals[at - 1]
                    rows[at] = rows[at - 1]
                    at -= 1
                totals[at] = total
                rows[at] = choice
                count = min(count + 1, depth)
            d -= 1
            continue
        if choice[d] >= 0:
            taken[choice[d]] = False
            choice[d] = -1
        moved_on = False
        while tried[d] <= options[d]:
            r = order[d, tried[d]]
            tried[d] += 1
            gain = gains[r, d] if r >= 0 else 0.0
            if so_far[d] + gain + rest[d + 1] < least:
                tried[d] = options[d] + 1  # the other rows gain even less
                break
            if r >= 0 and taken[r]:
                continue
            choice[d] = r
            if r >= 0:
                taken[r] = True
            so_far[d + 1] = so_far[d] + gain
            moved_on = True
            break
        if moved_on:
            d += 1
            if d < n_detections:
                tried[d] = 0
                choice[d] = -1
        else:
            tried[d] = 0
            d -= 1
    return count, totals, rows
