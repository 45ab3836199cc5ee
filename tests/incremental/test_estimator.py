"""The estimator as a whole: what it finds, what changes nothing, and what it survives."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import mht_slam as ms
from mht_slam.arrays import FloatArray
from mht_slam.errors import MeasurementError
from mht_slam.graph.standstill import standstills
from mht_slam.incremental import associate
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.motion_terms import STILL
from mht_slam.simulation.drives import DRIVE_KINDS, DriveKind, OdometryNoise, simulate_drive

from .drives import KEEN, check_sound, config_for, fed, noiseless, ordinary, passing, written


@pytest.mark.parametrize("kind", DRIVE_KINDS)
@pytest.mark.parametrize("n_scans", [20, 24, 30])
def test_passing_landmarks_without_noise_they_are_told_apart(kind: DriveKind, n_scans: int) -> None:
    scans, truth = passing(kind, n_scans)
    slam = fed(config_for(kind, KEEN), scans)
    assert slam.association.exact(truth)
    assert slam.status == "tracking"
    check_sound(slam)


@pytest.mark.parametrize(("kind", "least"), [("straight", 0.99), ("smooth", 0.98), ("loop", 0.9)])
def test_without_noise_little_is_wrong_however_near_landmarks_stand(
    kind: DriveKind, least: float
) -> None:
    """Some a step from the path, and turns of any size: pairwise F1 over six drives."""
    f1 = []
    for seed in range(6):
        drive = noiseless(kind, seed)
        slam = fed(config_for(kind, KEEN), drive.scans)
        f1.append(slam.association.f1(drive.truth()))
        assert slam.status == "tracking"
        check_sound(slam)
    assert np.mean(f1) >= least, f1


@pytest.mark.parametrize("kind", ["straight", "smooth"])
def test_a_drive_without_noise_is_mapped(kind: DriveKind) -> None:
    """Map and trajectory in the frame of the first pose, in first steps, up to priors."""
    drive = noiseless(kind, 1)
    slam = fed(config_for(kind, KEEN), drive.scans)
    truth, found = drive.reference_poses, slam.trajectory
    assert truth is not None
    travelled = np.hypot(*np.diff(truth[:, :2], axis=0).T).sum()
    # The first steps have the prior's heading and drift; compare up to a similarity.
    a, b = (p[:, 0] + 1j * p[:, 1] for p in (truth, found))
    a, b = a - a.mean(), b - b.mean()
    fit = np.vdot(b, a) / np.vdot(b, b)
    assert np.abs(fit * b - a).max() < 0.02 * travelled
    assert slam.map.points.shape == (8, 2)
    assert slam.map.confirmed.all()


@pytest.mark.parametrize("kind", DRIVE_KINDS)
def test_the_order_of_detections_within_a_scan_changes_only_their_indices(kind: DriveKind) -> None:
    drive = ordinary(kind, 3)
    rng = np.random.default_rng(0)
    orders = [rng.permutation(len(scan)) for scan in drive.scans]
    shuffled = [
        ms.BearingScan(scan.bearings[order], time=scan.time, odometry=scan.odometry)
        for scan, order in zip(drive.scans, orders, strict=True)
    ]
    one, two = fed(config_for(kind), drive.scans), fed(config_for(kind), shuffled)
    back = [
        [None if row < 0 else row for row in labels[np.argsort(order)].tolist()]
        for labels, order in zip(two.association.landmark_of_detection(), orders, strict=True)
    ]
    assert ms.Association.from_labels(back) == one.association
    np.testing.assert_allclose(two.online_trajectory, one.online_trajectory, atol=1e-6)
    probabilities = [[h.probability for h in slam.posterior] for slam in (one, two)]
    np.testing.assert_allclose(*probabilities, atol=1e-6)


@pytest.mark.parametrize("angle", [0.3, math.pi / 2, 3.0])
def test_turning_the_robots_axes_turns_the_world_and_nothing_else(angle: float) -> None:
    """Forward is where the odometer says it is."""
    drive = ordinary("loop", 4)
    c, s = math.cos(angle), math.sin(angle)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    turned = []
    for scan in drive.scans:
        step = scan.odometry
        if step is not None:
            motion = rotation @ [step.dx, step.dy, step.dtheta]
            assert step.covariance is not None
            covariance = rotation @ step.covariance @ rotation.T
            step = ms.Odometry(*motion.tolist(), 0.5 * (covariance + covariance.T))
        turned.append(ms.BearingScan(scan.bearings + angle, time=scan.time, odometry=step))
    one, two = fed(config_for("loop"), drive.scans), fed(config_for("loop"), turned)
    assert one.association == two.association
    expected = one.online_trajectory @ rotation.T
    np.testing.assert_allclose(two.online_trajectory[:, :2], expected[:, :2], atol=1e-4)
    np.testing.assert_allclose(two.online_trajectory[:, 2], expected[:, 2], atol=1e-5)


@pytest.mark.parametrize("kind", DRIVE_KINDS)
def test_a_mirrored_world_is_mirrored_and_nothing_else(kind: DriveKind) -> None:
    drive = ordinary(kind, 5)
    mirrored = []
    for scan in drive.scans:
        step = scan.odometry
        if step is not None:
            assert step.covariance is not None
            flip = np.diag([1.0, -1.0, -1.0])
            step = ms.Odometry(step.dx, -step.dy, -step.dtheta, flip @ step.covariance @ flip)
        mirrored.append(ms.BearingScan(-scan.bearings, time=scan.time, odometry=step))
    one, two = fed(config_for(kind), drive.scans), fed(config_for(kind), mirrored)
    assert one.association == two.association
    flipped = two.online_trajectory * [1.0, -1.0, -1.0]
    np.testing.assert_allclose(flipped, one.online_trajectory, atol=1e-6)


@pytest.mark.parametrize("kind", DRIVE_KINDS)
def test_lengths_of_an_odometer_are_the_unit(kind: DriveKind) -> None:
    """In centimetres the same drive is the same, where the model is too."""
    if kind != "loop":
        assert fed(config_for(kind), ordinary(kind, 0).scans[:4]).posterior.unit == "baseline"
        return
    drive = ordinary(kind, 6)
    scale = np.diag([100.0, 100.0, 1.0])
    longer = []
    for scan in drive.scans:
        step = scan.odometry
        if step is not None:
            assert step.covariance is not None
            motion = scale @ [step.dx, step.dy, step.dtheta]
            step = ms.Odometry(*motion.tolist(), scale @ step.covariance @ scale)
        longer.append(ms.BearingScan(scan.bearings, time=scan.time, odometry=step))
    config = config_for(kind)
    model = replace(config.model, landmark_sigma=100.0 * config.model.landmark_sigma)
    one = fed(config, drive.scans)
    two = fed(replace(config, model=model), longer)
    assert one.posterior.unit == two.posterior.unit == "metre"
    assert one.association.f1(two.association) > 0.97


@pytest.mark.parametrize("kind", DRIVE_KINDS)
def test_the_same_scans_make_the_same_bytes(kind: DriveKind, tmp_path: Path) -> None:
    drive = ordinary(kind, 7)
    once, again = (written(fed(config_for(kind), drive.scans), tmp_path) for _ in range(2))
    assert once == again


@pytest.mark.parametrize("kind", DRIVE_KINDS)
@pytest.mark.parametrize("cut", [0, 1, 2, 9, 15, 20])
def test_stopped_and_gone_on_is_never_stopped(kind: DriveKind, cut: int, tmp_path: Path) -> None:
    drive = ordinary(kind, 8)
    config = config_for(kind, hypotheses=4, lag=6)
    path = tmp_path / "stopped.npz"
    fed(config, drive.scans[:cut]).save(path)
    resumed = fed(ms.MultiHypothesisSlam.load(path), drive.scans[cut:])
    never = fed(config, drive.scans)
    assert written(resumed, tmp_path) == written(never, tmp_path)
    np.testing.assert_array_equal(resumed.trajectory, never.trajectory)
    np.testing.assert_array_equal(resumed.map.points, never.map.points)


def test_looking_at_it_changes_nothing(tmp_path: Path) -> None:
    drive = ordinary("smooth", 9)
    blind = fed(config_for("smooth"), drive.scans)
    seen = ms.MultiHypothesisSlam(config_for("smooth"))
    for scan in drive.scans:
        for h in seen.update(scan):
            assert h.poses is not None
            if len(seen.posterior) > 3:
                break
        check_sound(seen)
        _ = seen.marginal_associations, seen.association, seen.dropped
    _ = seen.trajectory, seen.map.covariances
    assert written(seen, tmp_path) == written(blind, tmp_path)


@pytest.mark.parametrize("kind", DRIVE_KINDS)
def test_one_hypothesis_and_one_open_scan_are_enough_to_run(kind: DriveKind) -> None:
    drive = ordinary(kind, 10)
    for options in ({"hypotheses": 1}, {"lag": 1}, {"hypotheses": 1, "lag": 1, "ranked": 1}):
        slam = fed(config_for(kind, **options), drive.scans)
        check_sound(slam)
        assert slam.map.points.shape[1] == 2


@pytest.mark.parametrize("count", range(4))
def test_an_estimator_that_has_seen_little_may_be_asked_anything(count: int) -> None:
    for scan in (ms.BearingScan([]), ms.BearingScan([0.3, -1.0])):
        slam = fed(SlamConfig(), [scan] * count)
        assert slam.n_scans == count
        assert slam.status == ("initialising" if count < 3 else "tracking")
        check_sound(slam)
        assert slam.association.n_scans == count
        assert slam.trajectory.shape == (count, 3)
        assert len(slam.map) == len(slam.map.covariances) == slam.association.n_landmarks
        assert len(slam.marginal_associations) == (len(scan) if count else 0)
        assert slam.loops == ()


EDGES: dict[str, list[list[float]]] = {
    "nothing at all": [[]] * 30,
    "nothing for long": [[0.5, -1.0, 2.0]] * 2 + [[]] * 120 + [[0.5, -1.0, 2.0]] * 2,
    "one landmark": [[math.atan2(3.0, 8.0 - k)] for k in range(15)],
    "one bearing, always the same": [[1.0]] * 15,
    "one bearing, twice in every scan": [[1.0, 1.0, -2.0]] * 15,
    "straight ahead and behind": [[0.0, math.pi]] * 15,
    "now and then": [[0.3, -0.4, 1.5] if k % 4 == 0 else [] for k in range(24)],
}


@pytest.mark.parametrize("name", EDGES)
@pytest.mark.parametrize("motion", ["smooth", "straight", "odometry"])
def test_odd_scans_are_taken_in(name: str, motion: Any) -> None:
    step = ms.Odometry(1.0, 0.0, 0.0, [1e-3, 1e-3, 1e-4])
    slam = ms.MultiHypothesisSlam(SlamConfig(motion=motion, hypotheses=3, start_hypotheses=3))
    for bearings in EDGES[name]:
        slam.update(ms.BearingScan(bearings, odometry=step))
    check_sound(slam)
    assert slam.n_scans == len(EDGES[name])
    assert np.isfinite(slam.trajectory).all()


def test_the_free_motion_takes_scans_too() -> None:
    drive = ordinary("smooth", 2, n_scans=4)
    check_sound(fed(SlamConfig(motion="free", hypotheses=1, start_hypotheses=1), drive.scans))


def test_two_hundred_detections_at_once_are_taken_in() -> None:
    rng = np.random.default_rng(0)
    drive = ordinary("smooth", 11, n_scans=8)
    slam = fed(SlamConfig(hypotheses=2, start_hypotheses=2, ranked=1), drive.scans)
    slam.update(ms.BearingScan(rng.uniform(-math.pi, math.pi, 200)))
    slam.update(drive.scans[-1].__class__(drive.scans[-1].bearings))
    check_sound(slam)


def test_what_is_no_measurement_is_refused_and_nothing_has_changed(tmp_path: Path) -> None:
    drive = ordinary("loop", 12)
    never = fed(config_for("loop"), drive.scans)
    slam = ms.MultiHypothesisSlam(config_for("loop"))
    bad: list[Any] = [
        None,
        [0.1, 0.2],
        ms.BearingScan([0.1], labels=["a"], time=1e6),
        ms.BearingScan([0.1], time=1e6),
        ms.BearingScan([0.1], time=1e6, odometry=ms.Odometry(1.0, 0.0, 0.0)),
    ]
    for k, scan in enumerate(drive.scans):
        late = [ms.BearingScan([0.1], time=float(k - 1)), ms.BearingScan([0.1], time=k - 1.5)]
        for wrong in (*bad, *late):
            first_without_odometry = k == 0 and isinstance(wrong, ms.BearingScan)
            if first_without_odometry and not wrong.labels:
                continue  # nothing to come after yet
            before = written(slam, tmp_path)
            with pytest.raises(MeasurementError, match=f"scan {k} "):
                slam.update(wrong)
            assert written(slam, tmp_path) == before
        slam.update(scan)
    assert written(slam, tmp_path) == written(never, tmp_path)


def test_scans_without_a_time_are_taken_in_between() -> None:
    slam = fed(SlamConfig(), [ms.BearingScan([0.1], time=5.0), ms.BearingScan([0.1])])
    with pytest.raises(MeasurementError, match="time 5"):
        slam.update(ms.BearingScan([0.1], time=5.0))
    slam.update(ms.BearingScan([0.1], time=5.5))


def stopping(
    steps: list[float], odometry: bool, sigma: float = math.radians(0.1)
) -> tuple[list[ms.BearingScan], FloatArray]:
    """A drive along x past eight landmarks, with its places; some steps may be none."""
    rng = np.random.default_rng(1)
    landmarks = np.column_stack([np.linspace(1.0, sum(steps) + 6.0, 8), np.tile([3.0, -4.0], 4)])
    xs, scans = np.cumsum([0.0, *steps]), []
    for x, moved in zip(xs.tolist(), [0.0, *steps], strict=True):
        bearings = np.arctan2(landmarks[:, 1], landmarks[:, 0] - x) + sigma * rng.normal(size=8)
        step = ms.Odometry(moved, 0.0, 0.0, [1e-4, 1e-4, 1e-5]) if odometry else None
        scans.append(ms.BearingScan(bearings, odometry=step))
    return scans, xs


def stopping_config(odometry: bool) -> SlamConfig:
    model = replace(SlamConfig().model, sigma=math.radians(0.2), stops=not odometry)
    return SlamConfig(model=model, motion="odometry" if odometry else "smooth", start_hypotheses=10)


@pytest.mark.parametrize("odometry", [True, False])
def test_a_standstill_is_one_place_and_the_scale_survives_it(odometry: bool) -> None:
    scans, xs = stopping([1.0] * 9 + [0.0] * 6 + [1.0] * 10, odometry)
    slam = fed(stopping_config(odometry), scans)
    truth = ms.Association(np.tile(np.arange(8)[:, None], 26), [8] * 26)
    assert slam.association.exact(truth)
    found = slam.trajectory
    assert np.abs(found[9:16, :2] - found[9, :2]).max() < 0.05
    np.testing.assert_allclose(found[:, 0], xs, atol=0.05 * xs[-1])


@pytest.mark.parametrize("creep", [0.0, 0.01, 0.02])
def test_a_robot_that_creeps_gets_on_and_one_that_stands_does_not(creep: float) -> None:
    """From one scan to the next nothing shows; from where it first stood, all of it does."""
    scans, xs = stopping([1.0] * 8 + [creep] * 24, odometry=False)
    slam = fed(stopping_config(odometry=False), scans)
    sigmas = [np.full(8, slam.config.model.sigma)] * 2
    assert sum(standstills(pair, sigmas)[0] for pair in pairwise(scans[8:])) >= 20, (
        "nothing to tell"
    )
    for found in (slam.trajectory, slam.online_trajectory):
        gone = math.dist(found[-1, :2], found[8, :2])
        assert gone == pytest.approx(xs[-1] - xs[8], rel=0.3, abs=0.02)
    standing = [step.kind == STILL for step in slam._history.steps[9:]]
    assert all(standing) if creep == 0.0 else 0 < sum(standing) < 24


def test_landmarks_arrive_where_none_ever_leaves() -> None:
    """With `stay_probability` 1 none goes out of view for good, and the robot still moves on."""
    scans, truth = passing("smooth", 30)
    config = config_for("smooth", KEEN, sight=12.0)
    later = int((truth.table[:, :5] < 0).all(axis=1).sum())
    assert later >= 3
    for stay in (1.0, config.model.stay_probability):
        slam = fed(replace(config, model=replace(config.model, stay_probability=stay)), scans)
        check_sound(slam)
        assert slam.association.exact(truth), stay


def test_a_window_without_an_optimum_harms_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """However it comes about: scans go by, and the next ones that can be solved are."""
    drive = ordinary("smooth", 16)
    for unusable in (range(6, 7), range(5, 9), range(12, 14), range(3, 20)):
        slam = ms.MultiHypothesisSlam(config_for("smooth", lag=6, hypotheses=3))
        for k, scan in enumerate(drive.scans):
            with monkeypatch.context() as patch:
                if k in unusable:
                    patch.setattr("mht_slam.incremental.estimator.solved", lambda *_: None)
                slam.update(scan)
            check_sound(slam)


def test_effort_and_memory_stay_flat_on_a_long_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sizes of tables and matrices, not seconds; only the log of what was settled grows."""
    drive = simulate_drive(
        "loop", 12, 360, np.random.default_rng(2), sigma=math.radians(0.5), rounds=9.0,
        odometry=OdometryNoise(),
    )  # fmt: skip
    config = config_for("loop", hypotheses=2, ranked=1, lag=5)
    sizes: list[tuple[int, int, int, int]] = []
    tables: list[int] = []
    predict = associate.predict

    def counted(*args: Any) -> Any:
        prediction = predict(*args)
        tables.append(prediction.table.size)
        return prediction

    monkeypatch.setattr(associate, "predict", counted)
    slam = ms.MultiHypothesisSlam(config)
    for scan in drive.scans:
        tables.clear()
        slam.update(scan)
        branch = slam._branches[0]
        sizes.append(
            (sum(tables), branch.root.size, len(slam.committed.mean), len(branch.sightings))
        )
    check_sound(slam)
    third = len(sizes) // 3
    first, last = np.array(sizes[:third]).max(axis=0), np.array(sizes[-third:]).max(axis=0)
    assert (last <= 1.5 * first).all(), (first, last)
    open_scans = len(slam._window.bearings)
    assert open_scans == config.lag
    assert len(slam._history.owners) == len(drive) - open_scans


@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    bearings=st.lists(st.lists(st.floats(-math.pi, math.pi), max_size=5), min_size=3, max_size=12),
    lag=st.integers(1, 6),
    hypotheses=st.integers(1, 4),
)
def test_any_bearings_are_taken_in(bearings: list[list[float]], lag: int, hypotheses: int) -> None:
    slam = fed(
        SlamConfig(lag=lag, hypotheses=hypotheses, start_hypotheses=5),
        map(ms.BearingScan, bearings),
    )
    check_sound(slam)
    assert slam.association.n_detections == tuple(map(len, bearings))
