"""From an association to a GTSAM factor graph."""

from __future__ import annotations

import math
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from mht_slam import factors
from mht_slam.arrays import FloatArray, IntArray
from mht_slam.graph.problem import Problem


@dataclass(frozen=True)
class GraphKeys:
    """GTSAM keys: ``scans[k]`` of scan k's Pose2, ``landmarks[l]`` of row l's Point2."""

    scans: tuple[int, ...]
    landmarks: tuple[int, ...]


def graph_keys(n_scans: int, n_landmarks: int) -> GraphKeys:
    """Return the keys that every graph of this package uses: x0, x1, ... and l0, l1, ..."""
    return GraphKeys(tuple(X(k) for k in range(n_scans)), tuple(L(i) for i in range(n_landmarks)))


def build_graph(problem: Problem, table: IntArray, steps: FloatArray) -> gtsam.NonlinearFactorGraph:
    """Build the graph of one association.

    Parameters
    ----------
    problem : the scans and their model.
    table : (n, m) association table.
    steps : (len(problem.free_steps),) lengths about which the log-normal step priors are
        linearised; at the estimate they are the estimated steps.

    Every factor is a normalised Gaussian density (docs/method.md, section 4): bearings; the gauge
    (O1 at the origin, O2 at one baseline on the x axis); headings about the line's direction;
    later scans on the line; log-normal steps; an isotropic landmark prior. The second run of a
    `RunPair` has a position prior like a landmark's and a uniform direction instead of the line.
    """
    keys = graph_keys(len(problem.scans), len(table))
    graph = gtsam.NonlinearFactorGraph()
    sightings = problem.sightings(table)
    bearings, sigmas = sightings.bearings.tolist(), sightings.sigmas.tolist()
    for row, scan in np.argwhere(sightings.seen).tolist():
        graph.push_back(
            factors.bearing(
                keys.scans[scan], keys.landmarks[row], bearings[row][scan], sigmas[row][scan]
            )
        )
    model = problem.model
    for key in keys.landmarks:
        graph.push_back(factors.landmark_prior(key, model.landmark_centre, model.landmark_sigma))
    for factor in motion_factors(problem, keys):
        graph.push_back(factor)
    for factor in step_factors(problem, keys, steps):
        graph.push_back(factor)
    return graph


def motion_factors(problem: Problem, keys: GraphKeys) -> list[gtsam.NoiseModelFactor]:
    """Gauge, line and heading factors: all that holds the poses but the steps."""
    x = keys.scans
    on_first_line = len(x) if problem.second_run is None else problem.second_run
    result: list[gtsam.NoiseModelFactor] = [
        *factors.first_baseline(x[0], x[1], length=problem.baseline),
        *(factors.heading_prior(key, 0.0, problem.heading_sigma) for key in x[:on_first_line]),
        *(factors.on_line(key, 0.0, problem.lateral_sigma) for key in x[2:on_first_line]),
    ]
    if problem.second_run is not None:
        third, fourth = x[problem.second_run :]
        centre, sigma = problem.model.landmark_centre, problem.model.landmark_sigma
        result.append(factors.position_prior(third, centre, sigma))
        result.extend(factors.straight_segment(third, fourth, problem.heading_sigma))
    return result


def step_factors(
    problem: Problem, keys: GraphKeys, steps: FloatArray
) -> list[gtsam.NoiseModelFactor]:
    """Log-normal step priors, linearised about `steps`."""
    mean, sigma = problem.model.log_step_mean, problem.model.log_step_sigma
    return [
        factors.log_step(keys.scans[a], keys.scans[b], mean, sigma, around)
        for (a, b), around in zip(problem.free_steps, steps.tolist(), strict=True)
    ]


def prior_outside_graph(problem: Problem, steps: FloatArray) -> float:
    """Log prior density that no factor holds, evaluated at the mode.

    The second run of a `RunPair` points anywhere, density 1 / (2 pi) over its direction psi. In
    the graph's variables dO4 = s ds dpsi, hence 1 / (2 pi s) with s = |O3 O4|.
    """
    if problem.second_run is None:
        return 0.0
    return -math.log(2.0 * math.pi) - math.log(float(steps[-1]))


def make_values(poses: FloatArray, landmarks: FloatArray) -> gtsam.Values:
    """Put (m, 3) poses and (n, 2) landmarks into GTSAM values under `graph_keys`."""
    keys = graph_keys(len(poses), len(landmarks))
    values = gtsam.Values()
    for key, (x, y, theta) in zip(keys.scans, poses.tolist(), strict=True):
        values.insert(key, gtsam.Pose2(x, y, theta))
    for key, point in zip(keys.landmarks, landmarks, strict=True):
        values.insert(key, point)
    return values
