"""What each match of a detection with a landmark or an earlier detection is worth at a pose."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.association import MISSED
from mht_slam.evidence.bearing_noise import log_bearing_noise
from mht_slam.evidence.visibility import (
    detection_chances,
    log_bearing_density,
    log_visibility,
    sightlines,
)
from mht_slam.measurements import wrap_angle
from mht_slam.tree.branch import Branch
from mht_slam.tree.pattern import chances_along_rays, single_bearings, single_weights
from mht_slam.tree.proposals import Proposals
from mht_slam.tree.setting import Setting

N_RANGES = 16
CERTAIN = 1e6
"""Gain, in nats, of a match that equal labels demand."""
NEAREST = 0.3
"""Range tried for a landmark seen once, in baselines; the farthest is three prior sigmas."""


@dataclass(frozen=True)
class Gains:
    """Log gains of matches over leaving both sides alone.

    Attributes
    ----------
    table : (G, n + s, d) for each proposal: landmarks first, then earlier single detections.
    alone : (G,) what the pattern of detections adds to the branch's score if nothing matches.
    """

    table: FloatArray
    alone: FloatArray


def match_gains(setting: Setting, branch: Branch, proposals: Proposals) -> Gains:
    """Score every match of the next scan's detections, for every proposed motion.

    A landmark's bearing is predicted from its estimate and joint covariance with the last pose,
    linearised; a single detection's from a row of log-spaced ranges along its ray, weighted by
    the prior. Both are spread by what a proposal stands for. The gain of a match is the log of
    its density times the chance of the pattern with it, over the weights without it.

    Source: docs/method.md, section 5.
    """
    k = len(branch.poses)
    scan = setting.problem.scans[k]
    sigma = setting.problem.sigmas[k]
    model = setting.problem.model
    pose = branch.poses[-1]
    new_alone = _weights_alone(setting, branch, proposals, k)
    n, s, d = len(branch.table), len(branch.singles), len(scan)
    table = np.full((len(proposals.motions), n + s, d), -np.inf)

    seen = branch.seen
    chances = np.broadcast_to(
        detection_chances(model, seen, sightlines(branch.poses, branch.points)),
        seen.shape,
    )
    if n:
        relative = _in_frame(pose, branch.points)
        spread = _relative_covariances(branch, relative)
        bearings, slopes, ranges = _seen_from(proposals.motions, relative)
        variance = np.einsum("gni,nij,gnj->gn", slopes, spread, slopes)
        variance = variance + _proposal_variance(proposals, ranges)
        visible = np.abs(bearings) <= 0.5 * model.field_of_view
        density = _log_density(
            scan.bearings, bearings, variance, sigma, model.bearing_dof
        )  # (G, n, d)
        with_it = log_visibility(
            np.column_stack([seen, np.ones(n, np.bool_)]),
            np.column_stack([chances, np.full(n, setting.detection_probability)]),
            model.stay_probability,
        )
        missed = [
            log_visibility(
                np.column_stack([seen, np.zeros(n, np.bool_)]),
                np.column_stack([chances, np.full(n, chance)]),
                model.stay_probability,
            )
            for chance in (setting.detection_probability, 0.0)
        ]
        without = np.where(visible, missed[0], missed[1])
        table[:, :n] = density + (with_it - without)[:, :, None]
        missed_now = without - log_visibility(seen, chances, model.stay_probability)
    else:
        missed_now = np.zeros((len(proposals.motions), 0))

    aged = 0.0
    if s:
        table[:, n:] = _pair_gains(setting, branch, proposals)
        longer = np.concatenate([branch.poses, branch.poses[-1:]])
        before, after = (single_weights(setting, p, branch.singles) for p in (branch.poses, longer))
        aged = float((after - before).sum())
    table -= new_alone[None, None, :]
    table += _label_gains(setting, branch)
    return Gains(table, missed_now.sum(axis=1) + aged + float(new_alone.sum()))


def _label_gains(setting: Setting, branch: Branch) -> FloatArray:
    """(n + s, d) gains by known identities: equal labels must meet, different ones must not."""
    labels = [scan.labels or (None,) * len(scan) for scan in setting.problem.scans]
    groups = [[(k, d) for k, d in enumerate(row) if d != MISSED] for row in branch.table.tolist()]
    groups += [[(k, d)] for k, d in branch.singles.tolist()]
    known = [{labels[k][d] for k, d in group} - {None} for group in groups]
    theirs = labels[len(branch.poses)]
    gains = np.zeros((len(known), len(theirs)))
    for i, mine in enumerate(known):
        for j, label in enumerate(theirs):
            if label is None:
                forbidden = any(own in theirs for own in mine)
            elif label in mine:
                gains[i, j] = CERTAIN
                continue
            else:
                forbidden = bool(mine) or any(label in others for others in known)
            gains[i, j] = -np.inf if forbidden else 0.0
    return gains


def _weights_alone(setting: Setting, branch: Branch, proposals: Proposals, k: int) -> FloatArray:
    """(d,) log weights of the new detections on their own, at the middle proposal."""
    count = len(setting.problem.scans[k])
    middle = proposals.motions[len(proposals.motions) // 2]
    pose = branch.poses[-1] + np.array([*_rotate(branch.poses[-1][2], middle[:2]), middle[2]])
    poses = np.concatenate([branch.poses, pose[None]])
    return single_weights(setting, poses, np.stack([np.full(count, k), np.arange(count)], axis=1))


def _pair_gains(setting: Setting, branch: Branch, proposals: Proposals) -> FloatArray:
    """(G, s, d) gains of making a landmark of an earlier single detection and a new one."""
    k = len(branch.poses)
    model = setting.problem.model
    scans = branch.singles[:, 0]
    poses = branch.poses[scans]
    bearings = single_bearings(setting, branch.singles)
    sigmas = np.array([setting.problem.sigmas[a][b] for a, b in branch.singles.tolist()])
    ranges = np.geomspace(NEAREST * setting.problem.baseline, 3.0 * model.landmark_sigma, N_RANGES)
    angle = poses[:, 2] + bearings
    rays = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    places = poses[:, None, :2] + ranges[None, :, None] * rays[:, None, :]  # (s, q, 2)
    away = (places - np.array(model.landmark_centre)) / model.landmark_sigma
    weights = 2.0 * np.log(ranges) - 0.5 * (away**2).sum(-1)
    weights -= np.logaddexp.reduce(weights, axis=1, keepdims=True)

    s, q = weights.shape
    relative = _in_frame(branch.poses[-1], places.reshape(-1, 2))
    seen_at, slopes, distance = _seen_from(proposals.motions, relative)  # (G, s q)
    # A bearing that is off by sigma moves the place sideways by its range times sigma; between
    # two ranges of the row lies half their spacing.
    along = np.tile(ranges, s)[:, None] * _directions(branch.poses[-1], rays, q)
    across = np.stack([-along[:, 1], along[:, 0]], axis=-1) * np.repeat(sigmas, q)[:, None]
    step = 0.5 * math.log(ranges[1] / ranges[0])
    variance = (
        (slopes * across).sum(-1) ** 2
        + (slopes * along).sum(-1) ** 2 * step**2
        + _proposal_variance(proposals, distance)
    )
    scan = setting.problem.scans[k]
    density = _log_density(
        scan.bearings, seen_at, variance, setting.problem.sigmas[k], model.bearing_dof
    ).reshape(len(proposals.motions), s, q, -1)
    mixed = np.logaddexp.reduce(density + weights[None, :, :, None], axis=2)

    pattern = np.zeros((s, k + 1), np.bool_)
    pattern[np.arange(s), scans] = True
    pattern[:, k] = True
    longer = np.concatenate([branch.poses, branch.poses[-1:]])
    chances = chances_along_rays(setting, longer, branch.singles, pattern)
    together = (
        setting.log_landmarks
        + log_visibility(pattern, chances, model.stay_probability)
        + log_bearing_density(model, poses, bearings)
    )
    alone = single_weights(setting, longer, branch.singles)
    return np.asarray(mixed + (together - alone)[None, :, None])


def _directions(pose: FloatArray, rays: FloatArray, q: int) -> FloatArray:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    turned = rays @ np.array([[c, -s], [s, c]])
    return np.repeat(turned, q, axis=0)


def _rotate(angle: float, vector: FloatArray) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def _in_frame(pose: FloatArray, points: FloatArray) -> FloatArray:
    """(n, 2) points in the frame of a pose."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.asarray((points - pose[:2]) @ np.array([[c, -s], [s, c]]))


def _relative_covariances(branch: Branch, relative: FloatArray) -> FloatArray:
    """(n, 2, 2) covariances of the landmarks in the frame of the last pose."""
    n = len(relative)
    c, s = math.cos(branch.poses[-1, 2]), math.sin(branch.poses[-1, 2])
    turn = np.array([[c, s], [-s, c]])
    jacobian = np.zeros((n, 2, 2 * n + 3))
    rows = np.arange(n)
    jacobian[rows, :, 2 * rows] = turn[:, 0]
    jacobian[rows, :, 2 * rows + 1] = turn[:, 1]
    jacobian[:, 0, 2 * n] = -1.0
    jacobian[:, 1, 2 * n + 1] = -1.0
    jacobian[:, 0, 2 * n + 2] = relative[:, 1]
    jacobian[:, 1, 2 * n + 2] = -relative[:, 0]
    return np.asarray(np.einsum("nia,ab,njb->nij", jacobian, branch.covariance, jacobian))


def _seen_from(
    motions: FloatArray, relative: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Bearings (G, n) after each motion, their derivatives (G, n, 2) by place, and ranges."""
    offset = relative[None] - motions[:, None, :2]
    squared = np.maximum((offset**2).sum(-1), 1e-12)
    bearings = wrap_angle(np.arctan2(offset[..., 1], offset[..., 0]) - motions[:, None, 2])
    slopes = np.stack([-offset[..., 1], offset[..., 0]], axis=-1) / squared[..., None]
    return bearings, slopes, np.sqrt(squared)


def _proposal_variance(proposals: Proposals, ranges: FloatArray) -> FloatArray:
    """(G, n) variance of a bearing within what a proposal stands for."""
    sideways = proposals.side_spread[:, None] / ranges
    return np.asarray(proposals.turn_spread**2 / 3.0 + np.minimum(sideways, 1.0) ** 2)


def _log_density(
    measured: FloatArray,
    expected: FloatArray,
    variance: FloatArray,
    sigma: FloatArray,
    dof: float | None,
) -> FloatArray:
    """(..., d) log density of the measured bearings (d,) about the expected ones (...)."""
    total = variance[..., None] + sigma**2
    squared = wrap_angle(measured - expected[..., None]) ** 2 / total
    return log_bearing_noise(squared, dof) - 0.5 * np.log(total)
