"""Optimum, covariance and evidence of a window, against a graph, slow sums and brute force."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam import factors
from mht_slam.arrays import FloatArray, IntArray
from mht_slam.incremental.motion_terms import FREE, ODOMETRY, SMOOTH, STRAIGHT
from mht_slam.incremental.past import places_of, point_jacobians, points_of
from mht_slam.incremental.smoother import cholesky, inverse_root, smooth_window
from mht_slam.measurements import wrap_angle

from .drives import terms

SEEDS = st.integers(0, 2**32 - 1)


@dataclass(frozen=True, eq=False)
class Scene:
    """Arguments of `smooth_window`, in its order."""

    prior_mean: FloatArray
    prior_information: FloatArray
    kinds: IntArray
    motion: FloatArray
    sightings: IntArray
    bearings: FloatArray
    sigmas: FloatArray
    dof: float
    landmark_sigma: float
    centres: FloatArray
    n_settled: int
    poses: FloatArray
    places: FloatArray

    def solved(self, rounds: int = 30) -> tuple[bool, float, FloatArray, FloatArray, FloatArray]:
        """What `smooth_window` returns, and where it has moved poses and places."""
        moved = replace(self, poses=self.poses.copy(), places=self.places.copy())
        found: tuple[bool, float, FloatArray] = smooth_window(*vars(moved).values(), rounds)
        return *found, moved.poses, moved.places

    def at_optimum(self) -> Scene:
        """The scene that starts where it ends: steps that gain less than the solver asks for."""
        scene = self
        for _ in range(4):
            usable, _, _, poses, places = scene.solved()
            assert usable
            scene = replace(scene, poses=poses, places=places)
        return scene

    def vector(self) -> FloatArray:
        """The unknowns in the order of `root`: poses but the last, landmarks, last pose."""
        return np.concatenate([self.poses[:-1].ravel(), self.places.ravel(), self.poses[-1]])

    def with_vector(self, x: FloatArray) -> Scene:
        first = 3 * (len(self.poses) - 1)
        poses = np.concatenate([x[:first], x[-3:]]).reshape(-1, 3)
        return replace(self, poses=poses, places=x[first:-3].reshape(-1, 2))

    def residuals(self) -> FloatArray:
        """Whitened residuals of prior, steps and bearings, each on its own."""
        off = np.concatenate([self.poses[:2].ravel(), self.places[: self.n_settled].ravel()])
        off = off - self.prior_mean
        angles = [2, 5, *range(6, len(off), 2)]
        off[angles] = wrap_angle(off[angles])
        found = [np.linalg.cholesky(self.prior_information).T @ off]
        found += [residual for _, residual in self.steps()]
        points = points_of(self.places, self.centres)
        for (p, j), b, sigma in zip(self.sightings, self.bearings, self.sigmas, strict=True):
            x, y = points[j] - self.poses[p, :2]
            found.append(np.array([wrap_angle(math.atan2(y, x) - self.poses[p, 2] - b) / sigma]))
        return np.concatenate(found)

    def cost(self) -> float:
        """Minus the log density, as the docstring of `smooth_window` states it."""
        residuals = self.residuals()
        n = len(self.bearings)
        quadratic, bearing = residuals[: len(residuals) - n], residuals[len(residuals) - n :]
        cost = 0.5 * float(quadratic @ quadratic) + float(np.log(self.sigmas).sum())
        if math.isfinite(self.dof):
            nu = self.dof
            height = math.lgamma(0.5 * (nu + 1)) - math.lgamma(0.5 * nu)
            height -= 0.5 * math.log(nu * math.pi)
            cost += float((0.5 * (nu + 1) * np.log1p(bearing**2 / nu)).sum()) - n * height
        else:
            cost += 0.5 * float(bearing @ bearing) + 0.5 * n * math.log(2 * math.pi)
        reach = np.exp(self.places[self.n_settled :, 1])
        sigma = self.landmark_sigma
        log_prior = -0.5 * (reach / sigma) ** 2 - math.log(2 * math.pi * sigma)
        log_prior -= 0.5 * math.log(math.pi / 2)  # half-normal range, any direction
        return cost - float((log_prior + np.log(reach)).sum())

    def log_volume(self) -> float:
        """Log of what takes steps' densities to densities over poses."""
        return sum(volume for volume, _ in self.steps())

    def steps(self) -> list[tuple[float, FloatArray]]:
        """Log volume and residual of each step."""
        return [
            terms(kind, self.motion[k], self.poses[k : k + 3])[:2]
            for k, kind in enumerate(self.kinds.tolist())
        ]


def scene(
    seed: int,
    *,
    kind: int = ODOMETRY,
    scans: int = 4,
    settled: int = 3,
    tentative: int = 0,
    noise: float = 0.01,
    dof: float = math.inf,
    correlated: bool = True,
) -> Scene:
    """A short drive along x past landmarks on both sides."""
    rng = np.random.default_rng(seed)
    motions = 0.05 * rng.normal(size=(scans + 1, 3)) * (kind != STRAIGHT)
    motions[:, 0] = rng.uniform(0.8, 1.2, scans + 1)
    poses = [np.zeros(3)]
    for dx, dy, turn in motions:
        x, y, theta = poses[-1]
        c, s = math.cos(theta), math.sin(theta)
        poses.append(np.array([x + c * dx - s * dy, y + s * dx + c * dy, theta + turn]))
    truth = np.array(poses)
    n = settled + tentative
    side = np.where(np.arange(n) % 2, 1.0, -1.0)
    points = np.column_stack([rng.uniform(0.0, scans + 1.0, n), side * rng.uniform(2.0, 5.0, n)])
    centres = np.concatenate(
        [
            truth[0, :2] + rng.normal(size=(settled, 2)) - [3.0, 0.0],
            truth[2, :2] + np.zeros((tentative, 2)),
        ]
    )
    places = places_of(points, centres)
    rows = [(p, j) for p in range(2, scans + 2) for j in range(n)]
    bearings, sigmas = [], []
    for p, j in rows:
        x, y = points[j] - truth[p, :2]
        sigma = rng.uniform(0.01, 0.03)
        sigmas.append(sigma)
        bearings.append(wrap_angle(math.atan2(y, x) - truth[p, 2] + noise * rng.normal()))
    size = 6 + 2 * settled
    deviations = np.concatenate([np.full(6, 0.03), np.tile([0.05, 0.1], settled)])
    mix = np.eye(size) + (0.3 * rng.normal(size=(size, size)) / size if correlated else 0.0)
    root = np.linalg.inv(mix) / deviations
    mean = np.concatenate([truth[:2].ravel(), places[:settled].ravel()])
    off = noise * rng.normal(size=size)
    parameters = np.zeros((scans, 12))
    for k in range(scans):
        if kind == ODOMETRY:
            parameters[k, :3] = motions[k + 1] + noise * rng.normal(size=3)
            whitening = np.diag([20.0, 30.0, 50.0]) + correlated * 2.0 * rng.normal(size=(3, 3))
            parameters[k, 3:] = whitening.ravel()
        else:
            parameters[k, :4] = 0.05, 0.08, 0.3, 0.1
    return Scene(
        prior_mean=mean + off,
        prior_information=root.T @ root,
        kinds=np.full(scans, kind, np.int64),
        motion=parameters,
        sightings=np.array(rows, np.int64).reshape(-1, 2),
        bearings=np.array(bearings),
        sigmas=np.array(sigmas),
        dof=dof,
        landmark_sigma=8.0,
        centres=centres,
        n_settled=settled,
        poses=truth + 0.01 * rng.normal(size=truth.shape),
        places=places + 0.05 * rng.normal(size=places.shape),
    )


def slopes(function, x: FloatArray, h: float = 1e-5) -> FloatArray:  # type: ignore[no-untyped-def]
    columns = []
    for i in range(len(x)):
        e = np.zeros(len(x))
        e[i] = h
        columns.append((np.asarray(function(x + e)) - np.asarray(function(x - e))) / (2 * h))
    return np.stack(columns, axis=-1)


@settings(max_examples=20, deadline=None)
@given(
    seed=SEEDS,
    kind=st.sampled_from([ODOMETRY, SMOOTH, STRAIGHT, FREE]),
    dof=st.sampled_from([math.inf, 4.0]),
    tentative=st.integers(0, 2),
)
def test_the_density_is_level_at_the_optimum(
    seed: int, kind: int, dof: float, tentative: int
) -> None:
    found = scene(seed, kind=kind, dof=dof, tentative=tentative).at_optimum()
    gradient = slopes(lambda x: found.with_vector(x).cost(), found.vector())
    _, _, root, _, _ = found.solved()
    # What a step along the gradient would still gain, in nats.
    assert 0.5 * gradient @ np.linalg.solve(root.T @ root, gradient) < 1e-6


@settings(max_examples=20, deadline=None)
@given(
    seed=SEEDS,
    kind=st.sampled_from([ODOMETRY, SMOOTH, STRAIGHT, FREE]),
    dof=st.sampled_from([math.inf, 4.0]),
    tentative=st.integers(0, 2),
)
def test_evidence_is_laplace_with_the_curvature_of_gauss_and_newton(
    seed: int, kind: int, dof: float, tentative: int
) -> None:
    found = scene(seed, kind=kind, dof=dof, tentative=tentative).at_optimum()
    _, log_evidence, root, _, _ = found.solved()
    x = found.vector()
    jacobian = slopes(lambda x: found.with_vector(x).residuals(), x)
    n = len(found.bearings)
    weights = np.ones(len(jacobian))
    if math.isfinite(dof):
        bearing = found.residuals()[-n:]
        weights[-n:] = (dof + 1.0) / (dof + bearing**2)
    information = (jacobian * weights[:, None]).T @ jacobian
    first = 3 * (len(found.poses) - 1)
    for j in range(found.n_settled, len(found.places)):
        a = first + 2 * j + 1
        information[a, a] += 2.0 * math.exp(2.0 * found.places[j, 1]) / found.landmark_sigma**2
    np.testing.assert_allclose(root.T @ root, information, rtol=1e-4, atol=1e-3)
    _, log_det = np.linalg.slogdet(information)
    expected = -found.cost() + found.log_volume() + 0.5 * len(x) * math.log(2 * math.pi)
    assert log_evidence == pytest.approx(expected - 0.5 * log_det, abs=1e-4)


@pytest.mark.parametrize("kind", [ODOMETRY, SMOOTH])
def test_without_noise_the_curvature_is_the_true_one(kind: int) -> None:
    """Residuals vanish where nothing pulls, and Gauss and Newton's Hessian becomes exact."""
    found = scene(5, kind=kind, noise=0.0, tentative=1).at_optimum()
    _, log_evidence, _, _, _ = found.solved()
    x = found.vector()
    hessian = slopes(lambda x: slopes(lambda y: found.with_vector(y).cost(), x, 1e-4), x, 1e-4)
    _, log_det = np.linalg.slogdet(0.5 * (hessian + hessian.T))
    expected = -found.cost() + found.log_volume() + 0.5 * len(x) * math.log(2 * math.pi)
    assert log_evidence == pytest.approx(expected - 0.5 * log_det, abs=0.02)


def graph_of(found: Scene) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """The same window in GTSAM: the correlated prior is a factor of its own."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    poses, n = len(found.poses), len(found.places)
    for p, pose in enumerate(found.poses.tolist()):
        values.insert(p, gtsam.Pose2(*pose))
    points = points_of(found.places, found.centres)
    for j in range(n):
        values.insert(poses + j, points[j])
    keys = [0, 1, *range(poses, poses + found.n_settled)]
    root = np.linalg.cholesky(found.prior_information).T

    def prior(_, values, jacobians):  # type: ignore[no-untyped-def]
        off, columns = [], []
        for key in keys[:2]:
            pose = values.atPose2(key)
            off += [pose.x(), pose.y(), pose.theta()]
            columns.append(gtsam.Rot3.Rz(pose.theta()).matrix())
        for j, key in enumerate(keys[2:]):
            point = values.atPoint2(key)
            place = places_of(point[None], found.centres[j : j + 1])
            off += place[0].tolist()
            columns.append(np.linalg.inv(point_jacobians(place)[0]))
        difference = np.array(off) - found.prior_mean
        angles = [2, 5, *range(6, len(difference), 2)]
        difference[angles] = wrap_angle(difference[angles])
        if jacobians is not None:
            at = 0
            for i, column in enumerate(columns):
                jacobians[i] = np.asfortranarray(root[:, at : at + len(column)] @ column)
                at += len(column)
        return root @ difference

    noise = gtsam.noiseModel.Unit.Create(len(root))
    graph.push_back(gtsam.CustomFactor(noise, keys, prior))
    dof = found.dof if math.isfinite(found.dof) else None
    for (p, j), b, sigma in zip(
        found.sightings.tolist(), found.bearings.tolist(), found.sigmas.tolist(), strict=True
    ):
        graph.push_back(factors.bearing(p, poses + j, b, sigma, dof))
    return graph, values


def with_steps(
    graph: gtsam.NonlinearFactorGraph, found: Scene, poses: FloatArray
) -> gtsam.NonlinearFactorGraph:
    """Steps of a smooth drive, linearised about poses."""
    whole = gtsam.NonlinearFactorGraph(graph)
    for k, p in enumerate(found.motion.tolist()):
        whole.push_back(factors.turn(k + 1, k + 2, p[0]))
        whole.push_back(factors.drift(k + 1, k + 2, p[1]))
        whole.push_back(factors.step_change((k, k + 1, k + 2), poses[k : k + 3], p[2]))
    return whole


@pytest.mark.parametrize("dof", [math.inf, 4.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_graph_of_the_same_window_has_the_same_optimum_and_covariance(
    seed: int, dof: float
) -> None:
    found = scene(seed, kind=SMOOTH, dof=dof, settled=4).at_optimum()
    started = scene(seed, kind=SMOOTH, dof=dof, settled=4)
    graph, values = graph_of(started)
    n_poses, n = len(found.poses), len(found.places)
    for _ in range(5):
        poses = np.array([
            [values.atPose2(p).x(), values.atPose2(p).y(), values.atPose2(p).theta()]
            for p in range(n_poses)
        ])  # fmt: skip
        whole = with_steps(graph, found, poses)
        values = gtsam.LevenbergMarquardtOptimizer(whole, values).optimize()
    for p, pose in enumerate(found.poses.tolist()):
        off = gtsam.Pose2(*pose).localCoordinates(values.atPose2(p))
        np.testing.assert_allclose(off, 0.0, atol=1e-4)
    points = points_of(found.places, found.centres)
    for j in range(n):
        np.testing.assert_allclose(values.atPoint2(n_poses + j), points[j], atol=1e-4)
    _, _, root, _, _ = found.solved()
    spread = inverse_root(root)
    covariance = spread @ spread.T
    marginals = gtsam.Marginals(whole, values)
    for p in range(n_poses):
        at = 3 * p if p < n_poses - 1 else len(root) - 3
        axes = gtsam.Rot3.Rz(found.poses[p, 2]).matrix()
        expected = axes @ marginals.marginalCovariance(p) @ axes.T
        np.testing.assert_allclose(
            covariance[at : at + 3, at : at + 3], expected, rtol=2e-3, atol=1e-7
        )
    jacobians = point_jacobians(found.places)
    first = 3 * (n_poses - 1)
    for j in range(n):
        block = covariance[first + 2 * j : first + 2 * j + 2, first + 2 * j : first + 2 * j + 2]
        expected = marginals.marginalCovariance(n_poses + j)
        mapped = jacobians[j] @ block @ jacobians[j].T
        np.testing.assert_allclose(mapped, expected, rtol=5e-3, atol=1e-6)


def test_the_last_block_of_the_root_is_that_of_landmarks_and_last_pose_alone() -> None:
    found = scene(3, settled=2, tentative=2).at_optimum()
    _, _, root, _, _ = found.solved()
    size = 2 * len(found.places) + 3
    covariance = np.linalg.inv(root.T @ root)[-size:, -size:]
    spread = inverse_root(np.ascontiguousarray(root[-size:, -size:]))
    np.testing.assert_allclose(spread @ spread.T, covariance, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("dof", [math.inf, 4.0])
@pytest.mark.parametrize("scans", [2, 3])
def test_evidence_of_a_landmark_is_its_integral_where_the_poses_are_known(
    scans: int, dof: float
) -> None:
    """On a grid of directions and log ranges; the share of the poses is that without it."""
    whole = scene(11, scans=scans, settled=0, tentative=1, noise=0.005, dof=dof)
    whole = replace(whole, prior_information=1e12 * np.eye(6), prior_mean=whole.poses[:2].ravel())
    tight = whole.motion.copy()
    for k in range(scans):  # steps exactly as the poses have them
        here, there = whole.poses[k + 1], whole.poses[k + 2]
        c, s = math.cos(here[2]), math.sin(here[2])
        away = there[:2] - here[:2]
        tight[k, :3] = c * away[0] + s * away[1], c * away[1] - s * away[0], there[2] - here[2]
        tight[k, 3:] = 1e6 * np.eye(3).ravel()
    whole = replace(whole, motion=tight)
    found = whole.at_optimum()
    _, with_landmark, _, _, _ = found.solved()
    without = replace(
        found,
        sightings=np.empty((0, 2), np.int64),
        bearings=np.empty(0),
        sigmas=np.empty(0),
        centres=np.empty((0, 2)),
        places=np.empty((0, 2)),
    )
    _, alone, _, _, _ = without.solved()
    # Brute force over directions and log ranges: the prior times every bearing's density.
    direction = found.places[0, 0] + np.linspace(-0.25, 0.25, 1201)
    reach = np.exp(np.linspace(math.log(0.05), math.log(80.0), 4001))
    phi, r = np.meshgrid(direction, reach, indexing="ij")
    x, y = found.centres[0, 0] + r * np.cos(phi), found.centres[0, 1] + r * np.sin(phi)
    log_density = np.log(r / found.landmark_sigma) - 0.5 * (r / found.landmark_sigma) ** 2
    log_density -= math.log(2 * math.pi) + 0.5 * math.log(math.pi / 2)
    for (p, _), b, sigma in zip(found.sightings, found.bearings, found.sigmas, strict=True):
        px, py, theta = whole.poses[p]
        z = wrap_angle(np.arctan2(y - py, x - px) - theta - b) / sigma
        if math.isfinite(dof):
            log_density += math.lgamma(0.5 * (dof + 1)) - math.lgamma(0.5 * dof)
            log_density -= 0.5 * math.log(dof * math.pi) + math.log(sigma)
            log_density -= 0.5 * (dof + 1) * np.log1p(z**2 / dof)
        else:
            log_density -= 0.5 * z**2 + 0.5 * math.log(2 * math.pi) + math.log(sigma)
    area = (direction[1] - direction[0]) * math.log(reach[1] / reach[0])
    integral = math.log(float(np.exp(log_density).sum()) * area)
    # Laplace cuts the tails of Student's t: .17 nats each of the two bearings that place it.
    tails = 2.0 * math.log(0.8407) if math.isfinite(dof) else 0.0
    assert with_landmark - alone == pytest.approx(integral + tails, abs=0.03 if not tails else 0.1)


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS, size=st.integers(1, 25))
def test_the_roots_are_those_of_numpy(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    half = rng.normal(size=(size, size)) + 2.0 * np.eye(size)
    matrix = half.T @ half
    root = np.full((size, size), 0.0)
    assert cholesky(np.triu(matrix), root)
    np.testing.assert_allclose(np.triu(root), np.linalg.cholesky(matrix).T, rtol=1e-6, atol=1e-8)
    inverse = inverse_root(root)
    np.testing.assert_allclose(inverse, np.linalg.inv(np.triu(root)), rtol=1e-5, atol=1e-7)
    assert (np.tril(inverse, -1) == 0.0).all()


def test_a_matrix_that_is_not_positive_definite_has_no_root() -> None:
    for bad in ([[1.0, 2.0], [0.0, 1.0]], [[0.0]], [[math.nan]], [[-1.0]]):
        matrix = np.array(bad)
        assert not cholesky(matrix, np.zeros_like(matrix))


def test_what_has_no_optimum_is_said_to_be_unusable() -> None:
    found = scene(1)
    broken = replace(found, bearings=np.full(len(found.bearings), math.nan))
    usable, log_evidence, _, _, _ = broken.solved()
    assert not usable
    assert log_evidence == -math.inf


def test_ten_rounds_are_enough_from_a_rough_start() -> None:
    for seed in range(10):
        started = scene(seed, tentative=2)
        usable, log_evidence, _, poses, places = started.solved(rounds=10)
        best = started.at_optimum()
        assert usable
        assert log_evidence == pytest.approx(best.solved()[1], abs=0.01)
        assert replace(started, poses=poses, places=places).cost() < best.cost() + 2e-3


@pytest.mark.parametrize("shift", [(0.05, 0.8), (1.5, -1.0)])
@pytest.mark.parametrize("rounds", [1, 2, 3, 6, 8, 30])
def test_evidence_belongs_to_the_place_that_is_returned(
    rounds: int, shift: tuple[float, float]
) -> None:
    """However few rounds from however far: of another place it compares apples with pears."""
    excess = []
    for seed in range(10):
        started = scene(seed, tentative=2)
        far = replace(started, places=started.places + np.array(shift))
        usable, log_evidence, root, poses, places = far.solved(rounds)
        if not usable:
            assert log_evidence == -math.inf
            continue
        there = replace(far, poses=poses, places=places)
        constant = there.log_volume() + 0.5 * len(root) * math.log(2 * math.pi)
        stated = constant - float(np.log(np.diag(root)).sum()) - log_evidence
        assert there.cost() == pytest.approx(stated, abs=2e-3), seed
        excess.append(there.cost() - started.at_optimum().cost())
    if rounds < 3:
        assert max(excess) > 1.0, "none of them would tell"
        if rounds == 30:
            assert there.cost() < there.at_optimum().cost() + 2e-3, seed
    assert rounds < 30 or len(excess) == 10


def test_no_round_says_nothing() -> None:
    usable, log_evidence, _, _, _ = scene(0).solved(rounds=0)
    assert not usable
    assert log_evidence == -math.inf
