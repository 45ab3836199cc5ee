"""The evidence of single landmarks at given poses: what a change of association is about worth."""

from __future__ import annotations

import math

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.evidence.bearing_noise import log_bearing_noise
from mht_slam.evidence.visibility import detection_chances, log_visibility, sightlines
from mht_slam.measurements import wrap_angle
from mht_slam.tree.setting import Setting

N_STEPS = 10
LONGEST_STEP = 1.0
"""Most change of ln range, or of bearing in radians, in one step of the optimiser."""


def cluster_log_weights(
    setting: Setting, poses: FloatArray, rows: IntArray, points: FloatArray
) -> FloatArray:
    """(R,) log of w_c = lambda V Int p0(x) prod_seen N(z; h(x, X)) dx for (R, k) rows.

    At given poses X the integral is two-dimensional: Laplace's approximation over bearing and log
    range from the first sighting, from `points` (R, 2) on, all rows at once by Gauss-Newton. Exact
    enough to choose which changes are worth a solved graph, where poses move too.

    Source: docs/method.md, section 4.
    """
    model = setting.problem.model
    sightings = setting.problem.sightings(rows)
    anchor = poses[(rows != MISSED).argmax(axis=1)]
    offset = points - anchor[:, :2]
    place = np.stack(
        [np.arctan2(offset[:, 1], offset[:, 0]), np.log(np.linalg.norm(offset, axis=1) + 1e-9)],
        axis=1,
    )
    centre = np.array(model.landmark_centre)
    dof = model.bearing_dof
    for step in range(N_STEPS + 1):
        reach = np.exp(place[:, 1])
        ray = np.stack([np.cos(place[:, 0]), np.sin(place[:, 0])], axis=1) * reach[:, None]
        aside = np.stack([-ray[:, 1], ray[:, 0]], axis=1)
        x = anchor[:, :2] + ray
        away = x[:, None, :] - poses[None, :, :2]
        squared = np.maximum((away**2).sum(-1), 1e-12)
        z = wrap_angle(np.arctan2(away[..., 1], away[..., 0]) - poses[:, 2] - sightings.bearings)
        z = np.where(sightings.seen, z / sightings.sigmas, 0.0)
        weight = np.ones_like(z) if dof is None else (dof + 1.0) / (dof + z**2)
        slope = np.stack([-away[..., 1], away[..., 0]], axis=-1) / squared[..., None]
        slope = np.where(sightings.seen[..., None], slope / sightings.sigmas[..., None], 0.0)
        jacobian = np.stack(
            [(slope * aside[:, None]).sum(-1), (slope * ray[:, None]).sum(-1)], axis=-1
        )
        prior = (x - centre) / model.landmark_sigma
        prior_jacobian = np.stack([aside, ray], axis=-1) / model.landmark_sigma
        gradient = (jacobian * (weight * z)[..., None]).sum(1)
        gradient += np.einsum("rij,ri->rj", prior_jacobian, prior)
        gradient[:, 1] -= 2.0
        hessian = np.einsum("rki,rk,rkj->rij", jacobian, weight, jacobian)
        hessian += np.einsum("rki,rkj->rij", prior_jacobian, prior_jacobian)
        hessian += 1e-9 * np.eye(2)
        if step < N_STEPS:
            move = _newton_steps(hessian, gradient)
            longest = np.abs(move).max(axis=1, keepdims=True)
            place = place - move * np.minimum(1.0, LONGEST_STEP / np.maximum(longest, 1e-12))
    log_density = log_bearing_noise(z**2, dof) - np.log(sightings.sigmas)
    value = np.where(sightings.seen, log_density, 0.0).sum(axis=1)
    value += 2.0 * place[:, 1] - 0.5 * (prior**2).sum(1)
    value -= 2.0 * math.log(model.landmark_sigma) + 0.5 * np.linalg.slogdet(hessian)[1]
    chances = detection_chances(model, sightings.seen, sightlines(poses, x))
    value += log_visibility(sightings.seen, chances, model.stay_probability)
    return np.asarray(value + setting.log_landmarks)


def _newton_steps(hessian: FloatArray, gradient: FloatArray) -> FloatArray:
    """(R, 2) Newton steps; none where the Hessian (R, 2, 2) is singular or beyond floats."""
    determinant = hessian[:, 0, 0] * hessian[:, 1, 1] - hessian[:, 0, 1] * hessian[:, 1, 0]
    step = np.stack(
        [
            hessian[:, 1, 1] * gradient[:, 0] - hessian[:, 0, 1] * gradient[:, 1],
            hessian[:, 0, 0] * gradient[:, 1] - hessian[:, 1, 0] * gradient[:, 0],
        ],
        axis=1,
    )
    move = step / determinant[:, None]
    return np.where(np.isfinite(move), move, 0.0)
