"""Robots that are blinded, carried off or lied to: lost, and found again."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import mht_slam as ms
from mht_slam.simulation.drives import DRIVE_KINDS, DriveKind, OdometryNoise, simulate_drive

from .drives import KEEN, check_sound, config_for, fed, ordinary, passing


@pytest.mark.parametrize("kind", ["smooth", "loop"])
def test_a_robot_that_is_carried_off_goes_on(kind: DriveKind) -> None:
    """Elsewhere in the middle of a drive: lost, found again or not, but never out of order."""
    drive, other = ordinary(kind, 13, n_scans=24), ordinary(kind, 14, n_scans=24)
    slam = fed(config_for(kind, lag=12), drive.scans[:12])
    for scan in other.scans[12:]:
        slam.update(ms.BearingScan(scan.bearings, odometry=scan.odometry))
        check_sound(slam)
    assert slam.status in ("tracking", "lost")


def test_bearings_that_mean_nothing_make_it_lost() -> None:
    drive = ordinary("loop", 15)
    rng = np.random.default_rng(0)
    slam = fed(config_for("loop", lag=12), drive.scans[:10])
    assert slam.status == "tracking"
    for _ in range(12):
        slam.update(
            ms.BearingScan(rng.uniform(-3.1, 3.1, 6), odometry=ms.Odometry(1, 0, 0, [1e-3] * 3))
        )
    assert slam.status == "lost"
    check_sound(slam)


def blinded(seed: int) -> tuple[list[ms.BearingScan], range]:
    """A drive on which some scans see nothing but reflections, and which ones."""
    rng = np.random.default_rng(seed)
    scans, blind = passing("loop", 40)[0], range(10, 24)
    for k in blind:
        nonsense = rng.uniform(-math.pi, math.pi, 3)
        scans[k] = ms.BearingScan(nonsense, odometry=scans[k].odometry)
    return scans, blind


@pytest.mark.parametrize("seed", range(3))
def test_a_robot_that_sees_again_is_found_again(seed: int) -> None:
    scans, blind = blinded(seed)
    slam = ms.MultiHypothesisSlam(config_for("loop", KEEN, hypotheses=5))
    states = []
    for scan in scans:
        slam.update(scan)
        states.append(slam.status)
    first = states.index("lost")
    found = states.index("tracking", first)
    assert blind.start < first < blind.stop
    assert blind.stop < found
    assert set(states[2:first]) == {"tracking"} == set(states[found:])
    assert slam._history.tears == [blind.start]
    # While it was lost, and where it tore, the odometer was trusted less.
    torn = (blind.start - 1, blind.start)
    for k in range(1, len(scans)):
        odometry = scans[k].odometry
        assert odometry is not None
        assert odometry.covariance is not None
        root = np.linalg.inv(slam._history.steps[k].parameters[3:12].reshape(3, 3))
        wider = np.diag(root @ root.T) > 2.0 * np.diag(odometry.covariance)
        doubted = states[k - 1] == "lost" or k in torn
        assert wider.all() if doubted else not wider.any(), k


@pytest.mark.parametrize("kind", DRIVE_KINDS)
def test_an_ordinary_drive_is_never_lost(kind: DriveKind) -> None:
    for seed in range(4):
        drive = ordinary(kind, 20 + seed, n_landmarks=12, n_scans=30)
        slam = ms.MultiHypothesisSlam(config_for(kind, hypotheses=5))
        for scan in drive.scans:
            slam.update(scan)
            assert slam.status != "lost"


def of_scans(association: ms.Association, first: int, last: int) -> ms.Association:
    """What an association says of some scans."""
    return ms.Association.from_labels([
        [None if row < 0 else row for row in labels.tolist()]
        for labels in association.landmark_of_detection()[first:last]
    ])  # fmt: skip


def test_after_a_gross_lie_of_the_odometer_the_robot_goes_on_with_a_map() -> None:
    """Of old or of new landmarks; neither side of the lie is harmed by it."""
    after, at, n = [], 12, 30
    for lie in ((0.0, 0.0, math.pi / 2), (-5.0, 6.0, 0.0), (3.0, 0.0, 0.0), (20.0, -9.0, 2.0)):
        scans, truth = passing("loop", n)
        honest = scans[at].odometry
        assert honest is not None
        motion = np.array([honest.dx, honest.dy, honest.dtheta]) + lie
        told = ms.Odometry(*motion.tolist(), honest.covariance)
        scans[at] = ms.BearingScan(scans[at].bearings, odometry=told)
        slam = fed(config_for("loop", KEEN, hypotheses=5), scans)
        check_sound(slam)
        assert slam.status == "tracking"
        before = of_scans(slam.association, 0, at)
        assert before.f1(of_scans(truth, 0, at)) > 0.98
        after.append(of_scans(slam.association, at, n).f1(of_scans(truth, at, n)))
    assert np.mean(after) > 0.95, after


@pytest.mark.parametrize("seed", [0, 1])
def test_a_robot_that_was_carried_off_says_so_and_finds_its_old_map_again(seed: int) -> None:
    """Six metres that the odometer knows nothing of: without the tear the map stays double."""
    at, rng = 90, np.random.default_rng(seed)
    drive = simulate_drive(
        "loop", 25, 170, rng, sigma=math.radians(0.3), rounds=3.4, odometry=OdometryNoise()
    )
    scans = list(drive.scans)
    told = scans[at].odometry
    assert told is not None
    lie = ms.Odometry(told.dx + 6.0, told.dy - 5.0, told.dtheta, told.covariance)
    scans[at] = replace(scans[at], odometry=lie)
    slam = ms.MultiHypothesisSlam(config_for("loop", hypotheses=5))
    states = []
    for scan in scans:
        slam.update(scan)
        states.append(slam.status)
    lost = [k for k, state in enumerate(states) if state == "lost"]
    assert lost
    assert at <= min(lost) <= at + 4
    assert states[-1] == "tracking"
    assert any(scan > at and together >= 4 for scan, together, _ in slam.loops)
