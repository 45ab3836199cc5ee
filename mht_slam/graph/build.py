"""From an association to a GTSAM factor graph, with factors that all associations share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import gtsam
from gtsam.symbol_shorthand import L, X

from mht_slam import factors
from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.graph.motion import fixed_motion_factors, linearised_motion_factors
from mht_slam.graph.problem import Problem


@dataclass(frozen=True)
class GraphKeys:
    """GTSAM keys: ``scans[k]`` of scan k's Pose2, ``landmarks[l]`` of row l's Point2."""

    scans: tuple[int, ...]
    landmarks: tuple[int, ...]


def graph_keys(n_scans: int, n_landmarks: int) -> GraphKeys:
    """Return the keys that every graph of this package uses: x0, x1, ... and l0, l1, ..."""
    return GraphKeys(tuple(X(k) for k in range(n_scans)), tuple(L(i) for i in range(n_landmarks)))


@dataclass(frozen=True)
class NormalisedGraph:
    """A graph and what its factors' densities are normalised by.

    Attributes
    ----------
    graph : all factors.
    log_normaliser : sum of the logs of their normalisers.
    """

    graph: gtsam.NonlinearFactorGraph
    log_normaliser: float

    def log_density(self, values: gtsam.Values) -> float:
        """Log of the product of all factors' normalised densities at `values`."""
        return self.log_normaliser - float(self.graph.error(values))


class FactorPool:
    """A problem with every factor that does not depend on an estimate, made once.

    Associations of a problem differ only in which bearing goes to which landmark, and a
    `NonlinearFactorGraph` holds pointers: graphs of different associations share their factors.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self._keys: dict[int, GraphKeys] = {}
        self._origins: dict[int, gtsam.Values] = {}
        self._rows: dict[tuple[int, tuple[int, ...]], NormalisedGraph] = {}
        self._priors: dict[int, tuple[gtsam.NonlinearFactor, float]] = {}
        self._bearings: dict[tuple[int, int, int], tuple[gtsam.NonlinearFactor, float]] = {}
        self._normalisers: dict[float, float] = {}

    def keys(self, n_landmarks: int) -> GraphKeys:
        """Return the keys of a graph with so many landmarks."""
        if n_landmarks not in self._keys:
            self._keys[n_landmarks] = graph_keys(len(self.problem.scans), n_landmarks)
        return self._keys[n_landmarks]

    def values(self, poses: FloatArray, landmarks: FloatArray) -> gtsam.Values:
        """Return `make_values`, up to rounding, in a third of its time: from a state of zeros."""
        count = len(landmarks)
        keys = self.keys(count)
        if count not in self._origins:
            self._origins[count] = make_values(keys, 0.0 * poses, 0.0 * landmarks)
        change = gtsam.VectorValues()
        for key, pose in zip(keys.scans, poses, strict=True):
            change.insert(key, pose)
        for key, landmark in zip(keys.landmarks, landmarks, strict=True):
            change.insert(key, landmark)
        return self._origins[count].retract(change)

    def unlinearised(self, table: IntArray) -> NormalisedGraph:
        """Return an association's graph without the factors that are linearised at an estimate."""
        graph = gtsam.NonlinearFactorGraph(self._fixed.graph)
        log_normaliser = self._fixed.log_normaliser
        for number, row in enumerate(table.tolist()):
            of_landmark = self._of_landmark(number, tuple(row))
            graph.push_back(of_landmark.graph)
            log_normaliser += of_landmark.log_normaliser
        return NormalisedGraph(graph, log_normaliser)

    def linearised(
        self, unlinearised: NormalisedGraph, poses: FloatArray, lengths: FloatArray
    ) -> NormalisedGraph:
        """Return the whole graph, the log-normal step priors linearised about (m, 3) `poses`.

        `lengths` are those of the problem's free steps there.
        """
        graph = gtsam.NonlinearFactorGraph(unlinearised.graph)
        steps, log_normaliser = linearised_motion_factors(
            self.problem, self.keys(0).scans, poses, lengths
        )
        for factor in steps:
            graph.add(factor)
        return NormalisedGraph(graph, unlinearised.log_normaliser + log_normaliser)

    @cached_property
    def _fixed(self) -> NormalisedGraph:
        graph = gtsam.NonlinearFactorGraph()
        log_normaliser = 0.0
        for factor in fixed_motion_factors(self.problem, self.keys(0).scans):
            graph.add(factor)
            log_normaliser += factors.log_normaliser(factor)
        return NormalisedGraph(graph, log_normaliser)

    def _of_landmark(self, number: int, row: tuple[int, ...]) -> NormalisedGraph:
        """The prior and the bearings of one landmark."""
        key = number, row
        if key not in self._rows:
            graph = gtsam.NonlinearFactorGraph()
            prior, log_normaliser = self.prior(number)
            graph.add(prior)
            for scan, detection in enumerate(row):
                if detection != MISSED:
                    bearing, normaliser = self.bearing(number, scan, detection)
                    graph.add(bearing)
                    log_normaliser += normaliser
            self._rows[key] = NormalisedGraph(graph, log_normaliser)
        return self._rows[key]

    def prior(self, number: int) -> tuple[gtsam.NonlinearFactor, float]:
        """Return the prior of a landmark, and its log normaliser."""
        if number not in self._priors:
            model = self.problem.model
            factor = factors.landmark_prior(L(number), model.landmark_centre, model.landmark_sigma)
            self._priors[number] = factor, factors.log_normaliser(factor)
        return self._priors[number]

    def bearing(
        self, number: int, scan: int, detection: int
    ) -> tuple[gtsam.NonlinearFactor, float]:
        """Return the factor of a detection of a landmark, and its log normaliser."""
        key = number, scan, detection
        if key not in self._bearings:
            sigma = self.problem.sigmas[scan].item(detection)
            factor = factors.bearing(
                self.keys(0).scans[scan],
                L(number),
                self.problem.scans[scan].bearings.item(detection),
                sigma,
                self.problem.model.bearing_dof,
            )
            if sigma not in self._normalisers:
                self._normalisers[sigma] = factors.log_normaliser(factor)
            self._bearings[key] = factor, self._normalisers[sigma]
        return self._bearings[key]


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
    pool = FactorPool(problem)
    return pool.linearised(pool.unlinearised(table), poses, problem.free_lengths(poses)).graph


def make_values(keys: GraphKeys, poses: FloatArray, landmarks: FloatArray) -> gtsam.Values:
    """Put (m, 3) poses and (n, 2) landmarks into GTSAM values."""
    values = gtsam.Values()
    for key, (x, y, theta) in zip(keys.scans, poses.tolist(), strict=True):
        values.insert(key, gtsam.Pose2(x, y, theta))
    for key, point in zip(keys.landmarks, landmarks, strict=True):
        values.insert(key, point)
    return values
