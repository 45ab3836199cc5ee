"""Simulated drives and short-hands that tests of the estimator share."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import mht_slam as ms
from mht_slam.arrays import FloatArray
from mht_slam.datasets.drive import Drive
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.motion_terms import motion_terms
from mht_slam.simulation.drives import DriveKind, OdometryNoise, simulate_drive


def noiseless(kind: DriveKind, seed: int, n_landmarks: int = 8, n_scans: int = 20) -> Drive:
    """A drive that sees every landmark in every scan, and nothing else."""
    return simulate_drive(
        kind, n_landmarks, n_scans, np.random.default_rng(seed), sigma=1e-7, miss=0.0,
        false_alarms=0.0, max_range=math.inf, occlusion=False, rounds=1.0,
        odometry=OdometryNoise() if kind == "loop" else None,
    )  # fmt: skip


def ordinary(kind: DriveKind, seed: int, n_landmarks: int = 8, n_scans: int = 20) -> Drive:
    """A drive with noise, misses and false alarms."""
    return simulate_drive(
        kind, n_landmarks, n_scans, np.random.default_rng(seed), sigma=math.radians(0.5),
        rounds=1.0, odometry=OdometryNoise() if kind == "loop" else None,
    )  # fmt: skip


def passing(kind: DriveKind, n_scans: int = 24) -> tuple[list[ms.BearingScan], ms.Association]:
    """A gentle drive, with its true association, past landmarks that keep some distance."""
    turn = {"straight": 0.0, "smooth": 0.05, "loop": 2.0 * math.pi / n_scans}[kind]
    rng = np.random.default_rng(n_scans)
    pose, landmarks, scans, labels = np.zeros(3), [], [], []
    poses = []
    for k in range(n_scans):
        poses.append(pose)
        c, s = math.cos(pose[2]), math.sin(pose[2])
        if k % 3 == 0:
            aside = rng.uniform(3.0, 4.0) * (-1.0 if kind == "loop" else (-1.0) ** k)
            landmarks.append(pose[:2] + aside * np.array([-s, c]))
        pose = pose + np.array([c, s, turn if kind == "loop" else turn * math.cos(0.3 * k)])
    for k, (x, y, theta) in enumerate(poses):
        away = np.array(landmarks) - [x, y]
        seen = rng.permutation(len(landmarks))
        seen = seen[np.hypot(*away[seen].T) < 12.0]
        motion = (1.0, 0.0, theta - poses[k - 1][2]) if k else (0.0, 0.0, 0.0)
        step = ms.Odometry(*motion, [1e-3, 1e-4, 1e-4])
        scans.append(ms.BearingScan(np.arctan2(*away[seen].T[::-1]) - theta, odometry=step))
        labels.append(seen.tolist())
    return scans, ms.Association.from_labels(labels)


KEEN = math.radians(0.05)
"""What the model says of bearings that have no noise: passing landmarks stay apart."""
ROW = np.array([[3.0, 2.0], [4.0, -2.5], [6.0, 3.5], [8.0, -2.0], [11.0, 2.5]])


def along_a_row(last: int, first: int = 0) -> list[ms.BearingScan]:
    """Scans on a straight way past `ROW`, without noise."""
    away = [ROW - [0.9 * k, 0.0] for k in range(first, last)]
    return [
        ms.BearingScan(np.arctan2(*points.T[::-1]), time=float(k))
        for k, points in enumerate(away, first)
    ]


def config_for(kind: DriveKind, sigma: float = math.radians(0.5), **options: Any) -> SlamConfig:
    """What an estimator of such a drive assumes."""
    base = SlamConfig().model
    model = replace(base, sigma=sigma, bearing_dof=None if sigma < 1e-2 else base.bearing_dof)
    options = {"start_hypotheses": options.get("hypotheses", 10)} | options
    return SlamConfig(model=model, motion="odometry" if kind == "loop" else kind, **options)


def fed(
    config: SlamConfig | ms.MultiHypothesisSlam, scans: Iterable[ms.BearingScan]
) -> ms.MultiHypothesisSlam:
    """Return the estimator that has taken in these scans."""
    slam = ms.MultiHypothesisSlam(config) if isinstance(config, SlamConfig) else config
    for scan in scans:
        slam.update(scan)
    return slam


def written(slam: ms.MultiHypothesisSlam, folder: Path) -> bytes:
    """The bytes of its checkpoint."""
    path = folder / "written.npz"
    slam.save(path)
    return path.read_bytes()


def check_sound(slam: ms.MultiHypothesisSlam) -> None:
    """Fail for anything that an estimator must never hold, whatever it was fed."""
    posterior = slam.posterior
    if slam.status != "initialising":
        probabilities = [h.probability for h in posterior]
        assert len(probabilities) >= 1
        assert math.isclose(sum(probabilities), 1.0, abs_tol=1e-9)
        assert probabilities == sorted(probabilities, reverse=True)
        # Associations over the open scans may be equal: they do not tell settled landmarks apart.
        assert len({branch.key for branch in slam._branches}) == len(posterior), "a branch twice"
        for hypothesis in posterior:
            assert hypothesis.poses is not None
            assert np.isfinite(hypothesis.poses).all()
            assert hypothesis.landmarks is not None
            assert np.isfinite(hypothesis.landmarks).all()
            for covariances in (hypothesis.pose_covariances, hypothesis.landmark_covariances):
                assert covariances is not None
                assert np.isfinite(covariances).all()
                assert (np.diagonal(covariances, axis1=1, axis2=2) >= 0.0).all()
        marginals: Sequence[dict[int, float]] = slam.marginal_associations
        for marginal in marginals:
            assert 0.0 < sum(marginal.values()) < 1.0 + 1e-9
    assert slam.online_trajectory.shape == (slam.n_scans, 3)
    assert np.isfinite(slam.online_trajectory).all()
    assert slam.association.n_scans == slam.n_scans
    past = slam.committed
    assert np.isfinite(past.mean).all()
    assert np.isfinite(past.covariance).all()
    assert len(set(past.ids.tolist())) == len(past.ids)
    for branch in slam._branches:
        for owner in branch.owners:
            named = owner[owner >= 0].tolist()
            assert len(set(named)) == len(named), "two detections of one scan are one landmark"


def terms(
    kind: int, parameters: FloatArray, poses: Sequence[FloatArray] | FloatArray
) -> tuple[float, FloatArray, FloatArray]:
    """Log volume, residual and derivatives of the step between the last two of three poses."""
    residual, jacobian = np.empty(3), np.empty((3, 9))
    volume = motion_terms(kind, parameters, *poses, residual, jacobian)
    return volume, residual, jacobian
