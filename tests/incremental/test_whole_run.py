"""The whole run as one graph says the same as a window that holds it, and as least squares."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from scipy.optimize import least_squares

import mht_slam as ms
from mht_slam.arrays import FloatArray
from mht_slam.datasets.drive_odometry import relative_motions
from mht_slam.incremental.past import points_of
from mht_slam.incremental.slam_map import CONFIRMED
from mht_slam.incremental.steps import (
    ANY_ANGLE,
    FRAME_SIGMA,
    RESTART_SIGMA,
    STILL_SIGMA,
    ZERO_SIGMA,
    Step,
    frame_step,
    next_step,
)
from mht_slam.incremental.whole_run import WIDER, WholeRun, smooth_whole_run
from mht_slam.measurements import wrap_angle
from mht_slam.simulation import OdometryNoise, trajectories

from .drives import config_for, fed, ordinary, passing


@pytest.mark.parametrize("dof", [None, 4.0])
def test_while_all_scans_are_open_the_graph_is_the_window(dof: float | None) -> None:
    """They differ by the landmark prior and its coordinates: where ranges are known, by little."""
    rng = np.random.default_rng(0)
    scans = [
        ms.BearingScan(
            scan.bearings + math.radians(0.5) * rng.normal(size=len(scan)), odometry=scan.odometry
        )
        for scan in passing("loop", 16)[0]
    ]
    config = config_for("loop", lag=50, hypotheses=3)
    config = replace(config, model=replace(config.model, bearing_dof=dof))
    slam = fed(config, scans)
    best = slam._branches[0]
    deviations = np.sqrt(
        [np.diag(covariance) for covariance in slam.posterior[0].pose_covariances]  # type: ignore[union-attr]
    )
    off = slam.trajectory - best.poses[2:]
    off[:, 2] = wrap_angle(off[:, 2])
    assert (np.abs(off) <= 0.2 * deviations + 1e-3).all()
    whole = slam.whole_run
    points = dict(zip(best.ids.tolist(), points_of(best.places, best.centres), strict=True))
    seen = {n: sum(n in owner.tolist() for owner in best.owners) for n in points}
    assert dict(zip(whole.numbers.tolist(), whole.counts.tolist(), strict=True)) == seen
    covariances = slam.map.covariances
    for number, point, covariance in zip(
        slam.map.numbers.tolist(), slam.map.points, covariances, strict=True
    ):
        difference = point - points[number]
        assert difference @ np.linalg.solve(covariance, difference) < 0.3**2


def test_the_map_has_the_rows_of_the_association() -> None:
    slam = fed(config_for("loop", lag=4), ordinary("loop", 32).scans)
    found, association = slam.map, slam.association
    assert len(found) == association.n_landmarks
    np.testing.assert_array_equal(found.sightings, (association.table >= 0).sum(axis=1))
    np.testing.assert_array_equal(found.confirmed, found.sightings >= CONFIRMED)
    np.testing.assert_array_equal(np.asarray(found), found.points)
    assert len(set(found.numbers.tolist())) == len(found)
    assert found.covariances.shape == (len(found), 2, 2)
    assert (np.linalg.eigvalsh(found.covariances) > 0.0).all()
    # A row's bearings point at its landmark, from the smoothed trajectory.
    scans = slam._history.bearings
    for row, point in zip(association.table, found.points, strict=True):
        for scan in np.flatnonzero(row >= 0):
            x, y, theta = slam.trajectory[scan]
            seen = np.arctan2(point[1] - y, point[0] - x) - theta - scans[scan][row[scan]]
            assert abs(np.angle(np.exp(1j * seen))) < 0.1


@dataclass(frozen=True, eq=False)
class Run:
    """Scans that see all of ten landmarks, with the truth in the frame of the model.

    The robot stands still before each of the scans in `stood`.
    """

    model: ms.ObservationModel
    truth: FloatArray
    landmarks: FloatArray
    scans: list[ms.BearingScan]
    stood: tuple[int, ...]

    def smoothed(self, rng: np.random.Generator) -> WholeRun:
        """From a rough start, of two landmarks from none."""
        start = self.truth + 0.03 * rng.normal(size=self.truth.shape)
        near = self.landmarks + 0.2 * rng.normal(size=self.landmarks.shape)
        return smooth_whole_run(
            self.steps(),
            [np.arange(len(self.landmarks)) for _ in self.scans],
            [scan.bearings for scan in self.scans],
            [np.full(len(scan), self.model.sigma) for scan in self.scans],
            start,
            dict(enumerate(near[:-2])),
            dof=self.model.bearing_dof,
            landmark_sigma=self.model.landmark_sigma,
        )

    def steps(self) -> list[Step]:
        found = [frame_step(self.model.heading_sigma)]
        for k in range(1, len(self.scans)):
            moved = 1.0 if k - 1 in self.stood else None
            found.append(next_step(self.model, self.scans[k], k, k in self.stood, moved))
        return found

    def residuals(self, x: FloatArray) -> FloatArray:
        """Unit Gaussians, written out from the model; x holds poses, then landmarks."""
        model, m = self.model, len(self.scans)
        poses, points = x[: 3 * m].reshape(-1, 3), x[3 * m :].reshape(-1, 2)
        first = np.array([FRAME_SIGMA, FRAME_SIGMA, max(model.heading_sigma, FRAME_SIGMA)])
        found = [poses[0] / first]
        found.append((points - poses[0, :2]).ravel() / (WIDER * model.landmark_sigma))
        found += [self.step_residual(k, poses) for k in range(1, m)]
        for pose, scan in zip(poses, self.scans, strict=True):
            seen = np.arctan2(*(points - pose[:2]).T[::-1]) - pose[2]
            z = wrap_angle(seen - scan.bearings) / model.sigma
            if model.bearing_dof is not None:  # half its square: minus the log of Student's t
                nu = model.bearing_dof
                z = np.sign(z) * np.sqrt((nu + 1.0) * np.log1p(z**2 / nu))
            found.append(z)
        return np.concatenate(found)

    def step_residual(self, k: int, poses: FloatArray) -> FloatArray:
        model, (dx, dy, turn) = self.model, poses[k] - poses[k - 1]
        length, aside = math.hypot(dx, dy), math.atan2(dy, dx) - poses[k - 1, 2]
        if k in self.stood:
            return np.array([dx, dy, turn]) / STILL_SIGMA
        odometry = self.scans[k].odometry
        if odometry is not None:
            assert odometry.covariance is not None
            moved = np.array([length * math.cos(aside), length * math.sin(aside), turn])
            said = [odometry.dx, odometry.dy, odometry.dtheta]
            return np.linalg.solve(np.linalg.cholesky(odometry.covariance), moved - said)
        expected, sigma = 1.0, model.log_step_sigma
        if model.motion == "smooth":
            expected, sigma = math.dist(poses[k - 1, :2], poses[k - 2, :2]), model.step_change_sigma
        if k == 1:  # the unit
            expected, sigma = 1.0, FRAME_SIGMA
        elif k - 1 in self.stood:
            expected, sigma = 1.0, RESTART_SIGMA
        change = math.log(length / expected) / sigma
        if model.motion == "straight":
            sigmas = (max(s, ZERO_SIGMA) for s in (model.heading_sigma, model.lateral_sigma))
            return np.array([*np.divide(poses[k, :0:-1], list(sigmas)), change])
        if model.motion == "free":
            return np.array([turn / ANY_ANGLE, wrap_angle(aside) / ANY_ANGLE, change])
        return np.array([turn / model.turn_sigma, wrap_angle(aside) / model.drift_sigma, change])


JITTER = math.radians(4.0)
MODELS: dict[str, dict[str, Any]] = {
    "odometry": {"motion": "odometry"},
    "smooth": {"motion": "smooth"},
    "smooth with a standstill": {"motion": "smooth", "stops": True},
    "straight": {"motion": "straight", "log_step_sigma": 0.3},
    "straight with jitter": {
        "motion": "straight", "log_step_sigma": 0.3, "heading_sigma": JITTER,
        "lateral_sigma": 0.05,
    },
    "free": {"motion": "free", "log_step_sigma": 0.3},
}  # fmt: skip


def run_of(name: str, seed: int, dof: float | None = None) -> Run:
    """Draw a run from a model, whose angles are small where it is free."""
    rng = np.random.default_rng(seed)
    model = ms.ObservationModel(
        sigma=math.radians(0.3), bearing_dof=dof, landmark_sigma=8.0, **MODELS[name]
    )
    n, stood = 12, (5, 6, 7) if model.stops else ()
    if model.motion == "straight":
        steps = trajectories.draw_steps(n - 2, rng, log_sigma=model.log_step_sigma)
        poses = trajectories.nearly_straight(
            steps, rng, heading_sigma=model.heading_sigma, lateral_sigma=model.lateral_sigma
        )
    else:
        poses = trajectories.smooth(
            n, rng, turn_sigma=model.turn_sigma, drift_sigma=model.drift_sigma,
            step_change_sigma=model.step_change_sigma,
        )  # fmt: skip
        poses = poses[[k - sum(s <= k for s in stood) for k in range(n)]]
        c, s = math.cos(poses[0, 2]), math.sin(poses[0, 2])
        poses[:, :2] = poses[:, :2] @ np.array([[c, -s], [s, c]])
        poses[:, 2] -= poses[0, 2]
    along = np.linspace(-1.0, poses[-1, 0] + 2.0, 10)
    landmarks = np.column_stack([along, np.tile([1.0, -1.0], 5) * rng.uniform(2.0, 5.0, 10)])
    scans = []
    motions = [None, *relative_motions(poses)]
    for (x, y, theta), motion in zip(poses.tolist(), motions, strict=True):
        odometry = None
        if model.motion == "odometry" and motion is not None:
            odometry = OdometryNoise().measure(motion, rng)
        noise = rng.normal(size=10) if dof is None else rng.standard_t(dof, 10)
        bearings = np.arctan2(landmarks[:, 1] - y, landmarks[:, 0] - x) - theta
        scans.append(ms.BearingScan(bearings + model.sigma * noise, odometry=odometry))
    return Run(model, poses, landmarks, scans, stood)


def deviations_of(whole: WholeRun) -> FloatArray:
    """(m, 3) as the graph states them; GTSAM's are along the axes of each pose."""
    marginals, found = gtsam.Marginals(whole.graph, whole.values), []
    for k, theta in enumerate(whole.poses[:, 2].tolist()):
        axes = gtsam.Rot3.Rz(theta).matrix()
        found.append(np.sqrt(np.diag(axes @ marginals.marginalCovariance(X(k)) @ axes.T)))
    return np.array(found)


@pytest.mark.parametrize(
    ("name", "dof"),
    [*((name, None) for name in MODELS), ("smooth", 4.0), ("straight with jitter", 4.0)],
)
def test_the_whole_run_is_solved_as_least_squares_written_out(name: str, dof: float | None) -> None:
    """However the robot moves; odometry agrees with GTSAM's to first order only."""
    run = run_of(name, 0, dof)
    whole = run.smoothed(np.random.default_rng(1))
    truth = np.concatenate([run.truth.ravel(), run.landmarks.ravel()])
    best = least_squares(run.residuals, truth, x_scale="jac", ftol=1e-10)
    m = len(run.scans)
    deviations = np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))
    off = np.concatenate([whole.poses.ravel(), whole.points.ravel()]) - best.x
    off[2 : 3 * m : 3] = wrap_angle(off[2 : 3 * m : 3])
    assert np.abs(off / deviations).max() < (0.1 if name == "odometry" else 0.02)
    # GTSAM's curvature has the weights of Student's t, the oracle's its slopes.
    stated = deviations_of(whole) / deviations[: 3 * m].reshape(-1, 3)
    assert np.abs(stated - 1.0).max() < (0.01 if dof is None else 0.1)


@pytest.mark.parametrize("name", MODELS)
def test_the_truth_lies_where_the_whole_run_says(name: str) -> None:
    """Squares of errors in stated deviations are one on average, over runs and poses."""
    squares = []
    for seed in range(20):
        run = run_of(name, seed)
        whole = run.smoothed(np.random.default_rng(seed))
        off = whole.poses - run.truth
        off[:, 2] = wrap_angle(off[:, 2])
        deviations = deviations_of(whole)
        found = deviations > 2e-3  # the others are given: the frame, the line, the first step
        squares += ((off / deviations)[found] ** 2).tolist()
    assert max(squares) < 4.5**2
    assert 0.6 < np.mean(squares) < 1.5


def test_the_first_heading_of_a_straight_run_is_off_its_line_like_any_other() -> None:
    """The frame is that of the line, and the robot need not look along it."""
    first = []
    for seed in range(4):
        run = run_of("straight with jitter", seed)
        sees = {"detection_probability": 0.9, "false_alarm_rate": 0.05, "expected_landmarks": 10.0}
        slam = fed(
            ms.SlamConfig(model=replace(run.model, **sees), lag=20, start_hypotheses=10), run.scans
        )
        best = slam.posterior[0]
        assert best.poses is not None
        assert best.pose_covariances is not None
        sigmas = np.sqrt(best.pose_covariances[:, 2, 2])
        assert (sigmas < 0.2 * JITTER).all()
        for headings in (best.poses[:, 2], slam.trajectory[:, 2]):
            assert (np.abs(headings - run.truth[:, 2]) < 4.0 * sigmas).all(), seed
        first.append(abs(run.truth[0, 2]) / sigmas[0])
    assert max(first) > 10.0, "none of the runs would tell"


def test_a_smooth_run_with_a_step_of_no_length_has_an_optimum() -> None:
    """The online estimate of two poses may coincide to the bit."""
    model = ms.ObservationModel(sigma=0.01, motion="smooth")
    scan = ms.BearingScan([])
    steps = [frame_step(), *(next_step(model, scan, k, False, None) for k in range(1, 4))]
    poses = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 0, 0]])
    nothing, nobody = [np.empty(0)] * 4, [np.empty(0, np.int64)] * 4
    whole = smooth_whole_run(
        steps, nobody, nothing, nothing, poses, {}, dof=None, landmark_sigma=15.0
    )
    assert np.isfinite(whole.poses).all()
    np.testing.assert_allclose(whole.poses[:2], poses[:2], atol=1e-3)
