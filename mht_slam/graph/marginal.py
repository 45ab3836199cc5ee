"""Evidence with every landmark integrated out, about the optimum that the graph found.

Laplace's approximation over all unknowns treats a landmark's position as Gaussian. A landmark seen
with little parallax is not: its range is skewed, and plain Laplace is off by whole nats where it
matters. Given the poses the landmarks separate, so here each is integrated exactly
(`mht_slam.evidence.landmark_integral`), and only the poses, which are few and well determined,
are left. One unknown step is summed on a grid. Of more unknowns, the steps' least certain
combination is, because a scale is skewed like a range; the others go by Laplace at each node.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from scipy.special import logsumexp

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.evidence.landmark_integral import log_landmark_integral
from mht_slam.graph.problem import Problem
from mht_slam.measurements import wrap_angle

LogDensity: TypeAlias = Callable[[FloatArray], FloatArray]
"""Log density of Q pose parameters, (Q, d) -> (Q,)."""

MAX_PARAMETERS = 8
"""Pose parameters beyond which the stencil costs more than it is worth."""
STENCIL = 0.5
"""Step of the second differences, in standard deviations of the graph's own Laplace."""
FLATTEST = 0.1
"""Least curvature across a section, in units of the graph's own."""
NEWTON_STEPS = 5
SHORTEST_MOVE = 0.2
"""Newton step with which a section's optimum counts as found, standard deviations."""
LONGEST_MOVE = 2.0
"""Longest Newton step across a section, standard deviations."""
SECTION_STEP = 1.0
"""Distance between sections, standard deviations."""
FIRST_SECTIONS = 4
"""Sections on either side of the optimum, and as many again wherever those do not reach."""
MAX_SECTIONS = 80
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
) -> float | None:
    """Integrate landmarks exactly, and poses about the optimum.

    Parameters
    ----------
    problem, table : as for `build_graph`.
    poses : (m, 3) at the optimum.
    pose_covariance : (3 m, 3 m) of the poses in run axes, from the graph's Laplace.

    Returns
    -------
    log Int p(X) prod_j E_j(X) dX over steps, and headings and lateral deviations where the model
    lets them vary; what it holds to `ZERO_SIGMA` is taken as exact. None where there are more than
    `MAX_PARAMETERS` such unknowns, or where no grid covers the mass: plain Laplace has to do there.

    Source: docs/method.md, section 4.
    """
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
    return _sum_of_sections(log_density, centre, spread, layout.principal_step(spread))


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

    def principal_step(self, spread: FloatArray) -> FloatArray:
        """Return the (d,) combination of log steps that the (d, d) covariance leaves most open."""
        steps = slice(3, 4) if self.problem.second_run is not None else slice(0, self.n_scans - 2)
        axis = np.zeros(len(spread))
        axis[steps] = np.linalg.eigh(spread[steps, steps])[1][:, -1]
        return axis

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
) -> float | None:
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
            return float(logsumexp(values) + math.log(step))
        inside = np.flatnonzero(values > top - EDGE_DROP)
        width = high - low
        low = low - 0.5 * width if open_low else float(grid[inside[0]]) - step
        high = high + 0.5 * width if open_high else float(grid[inside[-1]]) + step
    return None


def _sum_of_sections(
    log_density: LogDensity, centre: FloatArray, spread: FloatArray, axis: FloatArray
) -> float | None:
    """Trapezoidal sum along `axis` of Laplace's approximations across it.

    Works in coordinates in which the graph's own Laplace is a standard normal and the first one is
    along `axis` (d,), a linear functional of the parameters. More sections are added until those
    at both ends are negligible.
    """
    try:
        root = np.linalg.cholesky(spread)
    except np.linalg.LinAlgError:
        return None
    rotation = np.linalg.qr(np.column_stack([root.T @ axis, np.eye(len(centre))]))[0]
    to_parameters = root @ rotation

    def standardised(points: FloatArray) -> FloatArray:
        return log_density(centre + points @ to_parameters.T)

    nodes = np.arange(-FIRST_SECTIONS, FIRST_SECTIONS + 1, dtype=np.float64)
    values = _across(standardised, SECTION_STEP * nodes, len(centre) - 1)
    while np.isfinite(values).any():
        floor = values.max() - EDGE_DROP
        low_end, high_end = int(nodes[0]), int(nodes[-1])
        if values[0] <= floor and values[-1] <= floor:
            log_volume = float(np.linalg.slogdet(to_parameters)[1]) + math.log(SECTION_STEP)
            return float(logsumexp(values)) + log_volume
        if len(nodes) > MAX_SECTIONS:
            return None
        below = (
            np.arange(low_end - FIRST_SECTIONS, low_end, dtype=np.float64)
            if values[0] > floor
            else nodes[:0]
        )
        above = np.arange(high_end + 1, high_end + 1 + FIRST_SECTIONS, dtype=np.float64)
        above = above if values[-1] > floor else nodes[:0]
        more = _across(standardised, SECTION_STEP * np.concatenate([below, above]), len(centre) - 1)
        values = np.concatenate([more[: len(below)], values, more[len(below) :]])
        nodes = np.concatenate([below, nodes, above])
    return None


def _across(log_density: LogDensity, nodes: FloatArray, k: int) -> FloatArray:
    """(S,) log integrals over the last k coordinates, the first one held at each of S nodes.

    Laplace's approximation about the section's optimum, found by Newton's method with derivatives
    by differences over `STENCIL` standard deviations. What is left of the way there enters with
    the gradient g: the quadratic model gains g H^-1 g / 2.
    """
    i, j = np.triu_indices(k, 1)
    units = STENCIL * np.eye(k)
    same, opposite = units[i] + units[j], units[i] - units[j]
    stencil = np.concatenate([np.zeros((1, k)), units, -units, same, -same, opposite, -opposite])
    result = np.full(len(nodes), -np.inf)
    place = np.zeros((len(nodes), k))
    active = np.arange(len(nodes))
    for _ in range(NEWTON_STEPS):
        offsets = place[active, None, :] + stencil
        first = np.broadcast_to(nodes[active, None, None], (*offsets.shape[:2], 1))
        points = np.concatenate([first, offsets], axis=2).reshape(-1, k + 1)
        values = log_density(points).reshape(offsets.shape[:2])
        usable = np.isfinite(values).all(axis=1)
        active, values = active[usable], values[usable]
        at, plus, minus = values[:, :1], values[:, 1 : k + 1], values[:, k + 1 : 2 * k + 1]
        gradient = (plus - minus) / (2.0 * STENCIL)
        curvature = (2.0 * at - plus - minus) / STENCIL**2
        hessian = curvature[:, :, None] * np.eye(k)
        corners = values[:, 2 * k + 1 :].reshape(len(values), 4, len(i))
        mixed = (corners[:, 2:].sum(axis=1) - corners[:, :2].sum(axis=1)) / (4.0 * STENCIL**2)
        hessian[:, i, j] = hessian[:, j, i] = mixed
        eigenvalues, vectors = np.linalg.eigh(hessian)
        eigenvalues = np.maximum(eigenvalues, FLATTEST)
        move = np.einsum(
            "sij,sj->si", vectors, np.einsum("sji,sj->si", vectors, gradient) / eigenvalues
        )
        length = np.linalg.norm(move, axis=1)
        gain = np.where(length <= LONGEST_MOVE, 0.5 * (gradient * move).sum(axis=1), 0.0)
        log_width = 0.5 * (math.log(2.0 * math.pi) - np.log(eigenvalues)).sum(axis=1)
        result[active] = at[:, 0] + gain + log_width
        place[active] += move * np.minimum(1.0, LONGEST_MOVE / np.maximum(length, 1e-12))[:, None]
        active = active[(length > SHORTEST_MOVE) & (result[active] > result.max() - 2 * EDGE_DROP)]
        if len(active) == 0:
            break
    return result


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
