"""From an association to a GTSAM factor graph."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from mht_slam import factors
from mht_slam.arrays import FloatArray, IntArray
from mht_slam.graph.motion import motion_factors
from mht_slam.graph.problem import Problem


@dataclass(frozen=True)
class GraphKeys:
    """GTSAM keys: ``scans[k]`` of scan k's Pose2, ``landmarks[l]`` of row l's Point2."""

    scans: tuple[int, ...]
    landmarks: tuple[int, ...]


def graph_keys(n_scans: int, n_landmarks: int) -> GraphKeys:
    """Return the keys that every graph of this package uses: x0, x1, ... and l0, l1, ..."""
    return GraphKeys(tuple(X(k) for k in range(n_scans)), tuple(L(i) for i in range(n_landmarks)))


def build_graph(problem: Problem, table: IntArray, poses: FloatArray) -> gtsam.NonlinearFactorGraph:
    """Build the graph of one association.

    Parameters
    ----------
    problem : the scans and their model.
    table : (n, m) association table.
    poses : (m, 3) about which the log-normal step priors are linearised; at the estimate they are
        the estimated poses.

    Every factor is a normalised density (docs/method.md, section 4): bearings; an isotropic
    landmark prior; the gauge and the motion model (`mht_slam.graph.motion`).
    """
    keys = graph_keys(len(problem.scans), len(table))
    graph = gtsam.NonlinearFactorGraph()
    sightings = problem.sightings(table)
    bearings, sigmas = sightings.bearings.tolist(), sightings.sigmas.tolist()
    for row, scan in np.argwhere(sightings.seen).tolist():
        graph.push_back(
            factors.bearing(
                keys.scans[scan],
                keys.landmarks[row],
                bearings[row][scan],
                sigmas[row][scan],
                problem.model.bearing_dof,
            )
        )
    model = problem.model
    for key in keys.landmarks:
        graph.push_back(factors.landmark_prior(key, model.landmark_centre, model.landmark_sigma))
    for factor in motion_factors(problem, keys.scans, poses):
        graph.push_back(factor)
    return graph


def make_values(poses: FloatArray, landmarks: FloatArray) -> gtsam.Values:
    """Put (m, 3) poses and (n, 2) landmarks into GTSAM values under `graph_keys`."""
    keys = graph_keys(len(poses), len(landmarks))
    values = gtsam.Values()
    for key, (x, y, theta) in zip(keys.scans, poses.tolist(), strict=True):
        values.insert(key, gtsam.Pose2(x, y, theta))
    for key, point in zip(keys.landmarks, landmarks, strict=True):
        values.insert(key, point)
    return values
