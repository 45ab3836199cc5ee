"""Evidence with every landmark integrated out, about the optimum that the graph found.

Laplace's approximation over all unknowns treats a landmark's position as Gaussian. A landmark seen
with little parallax is not: its range is skewed, and plain Laplace is off by whole nats where it
matters. Given the poses the landmarks separate, so here each is integrated exactly
(`mht_slam.evidence.landmark_integral`), and only the poses, which are few, are left. A single
unknown step is summed on a grid, more unknowns by importance sampling at fixed points.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from scipy.special import logsumexp

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.evidence.importance import Integral, integrate
from mht_slam.evidence.landmark_integral import log_landmark_integral
from mht_slam.graph.problem import Problem
from mht_slam.measurements import wrap_angle

LogDensity: TypeAlias = Callable[[FloatArray], FloatArray]
"""Log density of Q pose parameters, (Q, d) -> (Q,)."""

MAX_PARAMETERS = 8
"""Pose parameters beyond which a sampled integral costs more than it is worth."""
GRID_REACH = 6.0
"""Half-width of the first grid over a single unknown, in standard deviations."""
GRID_NODES = 25
EDGE_DROP = 12.0
"""Nats by which a grid's edges must lie below its top."""
RESOLVED_NODES = 6
"""Nodes that must lie within three nats of the top."""
MAX_GRIDS = 12
PRIOR_REACH = 8.0
"""A single unknown never leaves this many standard deviations of its prior."""


def marginal_log_evidence(
    problem: Problem, table: IntArray, poses: FloatArray, pose_covariance: FloatArray
) -> Integral | None:
    """Integrate landmarks exactly, and poses about the optimum.

    Parameters
    ----------
    problem, table : as for `build_graph`.
    poses : (m, 3) at the optimum.
    pose_covariance : (3 m, 3 m) of the poses in run axes, from the graph's Laplace.

    Returns
    -------
    log Int p(X) prod_j E_j(X) dX over steps, and headings and lateral deviations where the model
    lets them vary; what it holds to `ZERO_SIGMA` is taken as exact. None for motion other than
    ``straight``, for heavy-tailed bearings, where there are more than `MAX_PARAMETERS` such
    unknowns, or where neither grid nor sample covers the mass: plain Laplace
    has to do there.

    Source: docs/method.md, section 4.
    """
    if problem.model.motion != "straight" or problem.model.bearing_dof is not None:
        return None
    layout = PoseLayout(problem)
    centre = layout.parameters(poses)
    if not 1 <= len(centre) <= MAX_PARAMETERS:
        return None
    jacobian = _numerical_jacobian(layout.parameters, poses)
    spread = jacobian @ pose_covariance @ jacobian.T

    def log_density(parameters: FloatArray) -> FloatArray:
        return _log_joint(problem, table, layout, parameters)

    if len(centre) == 1:
        return _sum_on_grid(log_density, problem, float(centre[0]), math.sqrt(spread[0, 0]))
    return integrate(log_density, centre, spread, layout.mirror())


class PoseLayout:
    """The pose parameters that a model leaves free, and the way to poses and back.

    One straight run: ln step for each free step, then lateral deviations of scans 3 and later and
    all headings where their sigma is not zero. Two runs: x, y of O3, direction of the second run,
    ln step, then the headings' deviations where they vary.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.n_scans = len(problem.scans)
        self.lateral = problem.model.lateral_sigma > 0.0 and problem.second_run is None
        self.jitter = problem.model.heading_sigma > 0.0

    def parameters(self, poses: FloatArray) -> FloatArray:
        """Return the (d,) parameters of (m, 3) poses."""
        steps = poses[1:, :2] - poses[:-1, :2]
        log_steps = np.log(np.linalg.norm(steps, axis=1))
        if self.problem.second_run is not None:
            direction = math.atan2(steps[2, 1], steps[2, 0])
            headings = poses[:, 2] - np.array([0.0, 0.0, direction, direction])
            parts = [poses[2, :2], [direction], log_steps[2:]]
        else:
            headings = poses[:, 2]
            parts = [log_steps[1:]]
        if self.lateral:
            parts.append(poses[2:, 1])
        if self.jitter:
            parts.append(wrap_angle(headings))
        return np.concatenate(parts)

    def mirror(self) -> FloatArray:
        """Return the (d,) signs that the parameters take when left and right are exchanged."""
        if self.problem.second_run is not None:
            signs = [1.0, -1.0, -1.0, 1.0]
        else:
            signs = [1.0] * (self.n_scans - 2)
        if self.lateral:
            signs += [-1.0] * (self.n_scans - 2)
        if self.jitter:
            signs += [-1.0] * self.n_scans
        return np.array(signs)

    def poses(self, parameters: FloatArray) -> FloatArray:
        """Return the (Q, m, 3) poses of (Q, d) parameters."""
        poses = np.zeros((len(parameters), self.n_scans, 3))
        poses[:, 1, 0] = self.problem.baseline
        if self.problem.second_run is not None:
            direction, length = parameters[:, 2], np.exp(parameters[:, 3])
            poses[:, 2, :2] = parameters[:, :2]
            poses[:, 3, 0] = parameters[:, 0] + length * np.cos(direction)
            poses[:, 3, 1] = parameters[:, 1] + length * np.sin(direction)
            poses[:, 2:, 2] = direction[:, None]
        else:
            steps = np.exp(parameters[:, : self.n_scans - 2])
            if self.lateral:
                poses[:, 2:, 1] = parameters[:, self.n_scans - 2 : 2 * (self.n_scans - 2)]
            rise = np.diff(poses[:, 1:, 1], axis=1)
            forward = np.sqrt(np.maximum(steps**2 - rise**2, 0.0))
            poses[:, 2:, 0] = self.problem.baseline + np.cumsum(forward, axis=1)
        if self.jitter:
            poses[:, :, 2] += parameters[:, -self.n_scans :]
        return poses

    def log_prior(self, parameters: FloatArray) -> FloatArray:
        """Return the (Q,) log prior densities of (Q, d) parameters."""
        model = self.problem.model
        count = self.n_scans - 2
        if self.problem.second_run is not None:
            position = parameters[:, :2] - np.array(model.landmark_centre)
            total = _log_normal(position, model.landmark_sigma) - math.log(2.0 * math.pi)
            log_steps = parameters[:, 3:4]
        else:
            total = np.zeros(len(parameters))
            log_steps = parameters[:, :count]
        total = total + _log_normal(log_steps - model.log_step_mean, model.log_step_sigma)
        if self.lateral:
            total += _log_normal(parameters[:, count : 2 * count], model.lateral_sigma)
        if self.jitter:
            total += _log_normal(parameters[:, -self.n_scans :], model.heading_sigma)
        return total


def _log_joint(
    problem: Problem, table: IntArray, layout: PoseLayout, parameters: FloatArray
) -> FloatArray:
    """Log prior plus the log integrals of all landmarks, (Q,)."""
    poses = layout.poses(parameters)
    total = layout.log_prior(parameters)
    sightings = problem.sightings(table)
    model = problem.model
    for bearings, sigmas, seen in zip(
        sightings.bearings, sightings.sigmas, sightings.seen, strict=True
    ):
        total = total + log_landmark_integral(
            poses[:, seen],
            bearings[seen],
            sigmas[seen],
            model.landmark_centre,
            model.landmark_sigma,
        )
    return total


def _sum_on_grid(
    log_density: LogDensity, problem: Problem, centre: float, spread: float
) -> Integral | None:
    """Trapezoidal sum over one log step, on a grid that is moved until it covers the mass.

    The sum is spectrally accurate once the edges are negligible and the peak is resolved. A coarse
    look over the whole prior widens the first grid where another mode counts.
    """
    model = problem.model
    floor = model.log_step_mean - PRIOR_REACH * model.log_step_sigma
    ceiling = model.log_step_mean + PRIOR_REACH * model.log_step_sigma
    low, high, nodes = centre - GRID_REACH * spread, centre + GRID_REACH * spread, GRID_NODES
    survey = np.linspace(0.5 * floor, 0.5 * ceiling, 2 * GRID_NODES)
    elsewhere = log_density(survey[:, None])
    for attempt in range(MAX_GRIDS):
        low, high = max(low, floor), min(high, ceiling)
        grid = np.linspace(low, high, nodes)
        step = float(grid[1] - grid[0])
        values = log_density(grid[:, None])
        top = values.max()
        if not np.isfinite(top):
            return None
        if attempt == 0 and (elsewhere > top - EDGE_DROP).any():
            far = survey[elsewhere > max(top, elsewhere.max()) - EDGE_DROP]
            if far.min() < low or far.max() > high:
                gap = float(survey[1] - survey[0])
                low, high = min(low, far.min() - gap), max(high, far.max() + gap)
                nodes = min(10 * GRID_NODES, math.ceil((high - low) / min(step, gap)) + 1)
                continue
        open_low = values[0] > top - EDGE_DROP and low > floor
        open_high = values[-1] > top - EDGE_DROP and high < ceiling
        if not (open_low or open_high) and (values > top - 3.0).sum() >= RESOLVED_NODES:
            return Integral(float(logsumexp(values) + math.log(step)), error=0.0)
        inside = np.flatnonzero(values > top - EDGE_DROP)
        width = high - low
        low = low - 0.5 * width if open_low else float(grid[inside[0]]) - step
        high = high + 0.5 * width if open_high else float(grid[inside[-1]]) + step
    return None


def _numerical_jacobian(function: Callable[[FloatArray], FloatArray], at: FloatArray) -> FloatArray:
    """Central differences of a vector function of an array, flattened."""
    columns = []
    for shift in 1e-6 * np.eye(at.size):
        moved = shift.reshape(at.shape)
        columns.append((function(at + moved) - function(at - moved)) / 2e-6)
    return np.stack(columns, axis=1)


def _log_normal(deviations: FloatArray, sigma: float) -> FloatArray:
    """Sum over the last axis of log N(deviation; 0, sigma)."""
    terms = -0.5 * (deviations / sigma) ** 2 - math.log(sigma * math.sqrt(2.0 * math.pi))
    return np.asarray(terms.sum(axis=-1), dtype=np.float64)
