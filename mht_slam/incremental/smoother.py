"""The least-squares heart: optimum and evidence of a window of scans given the committed past."""

from __future__ import annotations

import math

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.compiled import compiled
from mht_slam.incremental.motion_terms import motion_terms, wrapped

ENOUGH = 1e-3
"""Nats that a further step may gain at the end."""
LOG_PRIOR_AREA = math.log(2.0 * math.pi) + 0.5 * math.log(0.5 * math.pi)
"""Log integral of r exp(-r^2 / 2) over all directions and log ranges."""


@compiled
def smooth_window(
    prior_mean: FloatArray,
    prior_information: FloatArray,
    kinds: IntArray,
    motion: FloatArray,
    sightings: IntArray,
    bearings: FloatArray,
    sigmas: FloatArray,
    dof: float,
    landmark_sigma: float,
    centres: FloatArray,
    n_settled: int,
    poses: FloatArray,
    places: FloatArray,
    max_rounds: int,
) -> tuple[bool, float, FloatArray]:
    """Move `poses` and `places` to the optimum, and return what remains to say about it.

    Unknowns are the two last committed poses, the poses of the w scans in the window, and n
    landmarks, each by direction phi and log range rho from a fixed centre c,
    x = c + e^rho (cos phi, sin phi): along a bearing the posterior of rho is far closer to a
    Gaussian than that of the range (docs/method.md, section 5). Minimised is minus the log of

        N(committed) prod_steps N(residual) prod_sightings t(z; h, sigma) prod_tentative p0(x),
        p0(phi, rho) = e^rho exp(-e^2rho / 2 sigma_L^2) / (2 pi sigma_L sqrt(pi / 2)),

    by Gauss-Newton with the weights of Student's t and halved steps where one does not descend.

    Parameters
    ----------
    prior_mean, prior_information : Gaussian over the two committed poses and the first `n_settled`
        landmarks, (6 + 2 n_settled,) and its square.
    kinds, motion : (w,) and (w, 12) steps, as `motion_terms` takes them.
    sightings : (o, 2) pose (counted from the older committed one) and landmark.
    bearings, sigmas : (o,) radians.
    dof : of Student's t; infinite for a Gaussian.
    landmark_sigma : sigma_L, of the half-normal prior of the range from each centre. A range that
        is too long or short by a factor costs less than in the plane's Gaussian, which is sure that
        nothing is near (docs/incremental.md).
    centres : (n, 2).
    poses, places : (w + 2, 3) and (n, 2), start and result.

    Returns
    -------
    usable : whether the density has a positive definite information on the way. Where the rounds
        did not lead to the optimum, everything is that of the best place found, from which the
        next scan goes on.
    log_evidence : of all but the constants that branches of one window share.
    root : upper triangle U, U^T U the information of all unknowns: poses but the last, landmarks,
        last pose. Its last block is the same for landmarks and last pose alone, the others
        integrated out.
    """
    n_poses, n = len(poses), len(places)
    first_landmark = 3 * (n_poses - 1)
    last_pose = first_landmark + 2 * n
    size = last_pose + 3
    pose_at = np.empty(n_poses, np.int64)
    for p in range(n_poses):
        pose_at[p] = 3 * p if p < n_poses - 1 else last_pose
    prior_at = np.empty(len(prior_mean), np.int64)
    for i in range(3):
        prior_at[i], prior_at[3 + i] = pose_at[0] + i, pose_at[1] + i
    for i in range(2 * n_settled):
        prior_at[6 + i] = first_landmark + i
    hessian = np.empty((size, size))
    gradient = np.empty(size)
    residual, jacobian = np.empty(3), np.empty((3, 9))
    difference = np.empty(len(prior_mean))
    old_poses, old_places = poses.copy(), places.copy()
    step = np.zeros(size)
    root = np.zeros((size, size))
    cost, share, arrived = math.inf, 1.0, False
    nothing = np.zeros((0, 0))
    for attempt in range(max_rounds):
        new_cost = _assemble(
            prior_mean,
            prior_information,
            prior_at,
            pose_at,
            first_landmark,
            kinds,
            motion,
            sightings,
            bearings,
            sigmas,
            dof,
            landmark_sigma,
            centres,
            n_settled,
            poses,
            places,
            hessian,
            gradient,
            residual,
            jacobian,
            difference,
        )
        if not new_cost <= cost + ENOUGH:  # no descent: go half the way
            if share < 1e-3 or attempt == max_rounds - 1:
                break
            share *= 0.5
            _moved(old_poses, old_places, step, share, pose_at, first_landmark, poses, places)
            continue
        cost, share = new_cost, 1.0
        if not cholesky(hessian, root):
            return False, -math.inf, nothing
        _solve(root, gradient, step)
        gain = 0.0
        for i in range(size):
            gain -= 0.5 * gradient[i] * step[i]
        old_poses[:, :] = poses
        old_places[:, :] = places
        longest = 0.0
        for i in range(n):
            longest = max(longest, abs(step[first_landmark + 2 * i + 1]))
        if longest > 1.0:  # a log range that leaps has left where it was linearised
            share = 1.0 / longest
        _moved(old_poses, old_places, step, share, pose_at, first_landmark, poses, places)
        if gain < ENOUGH:
            cost -= gain
            arrived = True
            break
    if not cost < math.inf:
        return False, -math.inf, nothing
    if not arrived:  # the last step led nowhere, or somewhere that nobody has looked at
        poses[:, :] = old_poses
        places[:, :] = old_places
    log_evidence = -cost + 0.5 * size * math.log(2.0 * math.pi)
    for i in range(size):
        log_evidence -= math.log(root[i, i])
    for k in range(len(kinds)):
        log_evidence += motion_terms(
            kinds[k], motion[k], poses[k], poses[k + 1], poses[k + 2], residual, jacobian
        )
    if not math.isfinite(log_evidence):
        return False, -math.inf, nothing
    return True, log_evidence, root


@compiled
def _moved(
    old_poses: FloatArray,
    old_places: FloatArray,
    step: FloatArray,
    share: float,
    pose_at: IntArray,
    first_landmark: int,
    poses: FloatArray,
    places: FloatArray,
) -> None:
    for p in range(len(poses)):
        for i in range(3):
            poses[p, i] = old_poses[p, i] + share * step[pose_at[p] + i]
    for j in range(len(places)):
        for i in range(2):
            places[j, i] = old_places[j, i] + share * step[first_landmark + 2 * j + i]


@compiled
def _assemble(
    prior_mean: FloatArray,
    prior_information: FloatArray,
    prior_at: IntArray,
    pose_at: IntArray,
    first_landmark: int,
    kinds: IntArray,
    motion: FloatArray,
    sightings: IntArray,
    bearings: FloatArray,
    sigmas: FloatArray,
    dof: float,
    landmark_sigma: float,
    centres: FloatArray,
    n_settled: int,
    poses: FloatArray,
    places: FloatArray,
    hessian: FloatArray,
    gradient: FloatArray,
    residual: FloatArray,
    jacobian: FloatArray,
    difference: FloatArray,
) -> float:
    """Fill the upper triangle of the Hessian and the gradient; return minus the log density."""
    hessian[:, :] = 0.0
    gradient[:] = 0.0
    cost = 0.0
    n_prior = len(prior_mean)
    for i in range(n_prior):
        if i < 6:
            difference[i] = poses[i // 3, i % 3] - prior_mean[i]
            if i % 3 == 2:
                difference[i] = wrapped(difference[i])
        else:
            difference[i] = places[(i - 6) // 2, i % 2] - prior_mean[i]
            if i % 2 == 0:
                difference[i] = wrapped(difference[i])
    for i in range(n_prior):
        a = prior_at[i]
        pull = 0.0
        for j in range(n_prior):
            pull += prior_information[i, j] * difference[j]
        gradient[a] += pull
        cost += 0.5 * pull * difference[i]
        for j in range(i + 1):
            b = prior_at[j]
            hessian[min(a, b), max(a, b)] += prior_information[i, j]
    spots = np.empty(9, np.int64)
    for k in range(len(kinds)):
        motion_terms(kinds[k], motion[k], poses[k], poses[k + 1], poses[k + 2], residual, jacobian)
        for p in range(3):
            for i in range(3):
                spots[3 * p + i] = pose_at[k + p] + i
        for r in range(3):
            cost += 0.5 * residual[r] * residual[r]
            for i in range(9):
                if jacobian[r, i] != 0.0:
                    gradient[spots[i]] += jacobian[r, i] * residual[r]
                    for j in range(9):
                        if spots[i] <= spots[j]:
                            hessian[spots[i], spots[j]] += jacobian[r, i] * jacobian[r, j]
    row = np.empty(5)
    at = np.empty(5, np.int64)
    heavy = math.isfinite(dof)
    height = -0.5 * math.log(2.0 * math.pi)
    if heavy:
        height = math.lgamma(0.5 * (dof + 1.0)) - math.lgamma(0.5 * dof)
        height -= 0.5 * math.log(dof * math.pi)
    for o in range(len(bearings)):
        p, j = sightings[o, 0], sightings[o, 1]
        reach = math.exp(places[j, 1])
        ex, ey = reach * math.cos(places[j, 0]), reach * math.sin(places[j, 0])
        x = centres[j, 0] + ex - poses[p, 0]
        y = centres[j, 1] + ey - poses[p, 1]
        squared = max(x * x + y * y, 1e-18)
        sigma = sigmas[o]
        z = wrapped(math.atan2(y, x) - poses[p, 2] - bearings[o]) / sigma
        gx, gy = -y / squared / sigma, x / squared / sigma
        row[0], row[1] = -gx * ey + gy * ex, gx * ex + gy * ey
        row[2], row[3], row[4] = -gx, -gy, -1.0 / sigma
        at[0], at[1] = first_landmark + 2 * j, first_landmark + 2 * j + 1
        at[2], at[3], at[4] = pose_at[p], pose_at[p] + 1, pose_at[p] + 2
        weight = 1.0
        if heavy:
            weight = (dof + 1.0) / (dof + z * z)
            cost += 0.5 * (dof + 1.0) * math.log1p(z * z / dof)
        else:
            cost += 0.5 * z * z
        cost += math.log(sigma) - height
        for i in range(5):
            gradient[at[i]] += weight * row[i] * z
            for k in range(5):
                if at[i] <= at[k]:
                    hessian[at[i], at[k]] += weight * row[i] * row[k]
    for j in range(n_settled, len(places)):
        share = math.exp(2.0 * places[j, 1]) / (landmark_sigma * landmark_sigma)
        a = first_landmark + 2 * j + 1
        cost += 0.5 * share - places[j, 1] + math.log(landmark_sigma) + LOG_PRIOR_AREA
        gradient[a] += share - 1.0
        hessian[a, a] += 2.0 * share
        hessian[a - 1, a - 1] += 1e-9
        hessian[a, a] += 1e-9
    return cost


@compiled
def cholesky(matrix: FloatArray, root: FloatArray) -> bool:
    """Fill the upper triangle U, matrix = U^T U, from its upper triangle; False without one.

    Row by row, each less the shares of four rows above at a time, so that a row is loaded and
    stored a quarter as often; the order of the subtractions is that of one row at a time.
    """
    size = len(matrix)
    for i in range(size):
        row = root[i]
        for j in range(i, size):
            row[j] = matrix[i, j]
        fours = i - i % 4
        for k in range(0, fours, 4):
            a, b, c, d = root[k, i], root[k + 1, i], root[k + 2, i], root[k + 3, i]
            if a != 0.0 or b != 0.0 or c != 0.0 or d != 0.0:
                for j in range(i, size):
                    row[j] = (
                        row[j] - a * root[k, j] - b * root[k + 1, j] - c * root[k + 2, j]
                    ) - d * root[k + 3, j]
        for k in range(fours, i):
            share = root[k, i]
            for j in range(i, size):
                row[j] -= share * root[k, j]
        if not row[i] > 0.0:
            return False
        pivot = 1.0 / math.sqrt(row[i])
        for j in range(i, size):
            row[j] *= pivot
    return True


@compiled
def _solve(root: FloatArray, gradient: FloatArray, step: FloatArray) -> None:
    """Fill the Newton step, minus the inverse of root^T root times the gradient."""
    size = len(root)
    for i in range(size):
        step[i] = -gradient[i]
    for i in range(size):
        step[i] /= root[i, i]
        for k in range(i + 1, size):
            step[k] -= root[i, k] * step[i]
    for i in range(size - 1, -1, -1):
        total = step[i]
        for k in range(i + 1, size):
            total -= root[i, k] * step[k]
        step[i] = total / root[i, i]


@compiled
def inverse_root(root: FloatArray) -> FloatArray:
    """Return the inverse V of an upper triangle; V V^T is the covariance of its information."""
    size = len(root)
    inverse = np.zeros((size, size))
    for i in range(size - 1, -1, -1):
        inverse[i, i] = 1.0
        for k in range(i + 1, size):
            share = root[i, k]
            if share != 0.0:
                for j in range(k, size):
                    inverse[i, j] -= share * inverse[k, j]
        for j in range(i, size):
            inverse[i, j] /= root[i, i]
    return inverse
