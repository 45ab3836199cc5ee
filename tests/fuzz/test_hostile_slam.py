"""The incremental estimator, given options and scans that no robot should ever bring home."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mht_slam as ms
from mht_slam.arrays import freeze
from mht_slam.errors import MeasurementError

from .test_hostile_runs import bearings, examples, loose_scans, mostly, seen_scans

Survives = Callable[..., Any]

SIGMAS = st.sampled_from([None, None, None, 1e-12, 1e-6, 0.01, 0.5, 3.1, 1e3])
MOTIONS = (*("smooth", "odometry") * 4, "straight", "straight", "free")
LENGTHS = st.sampled_from([0.0, 1.0, 1.0, 1.0, -1.0, 1e-300, 1e-9, 1e-3, 30.0, 1e6, 1e9, 1e300])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("slam")


@st.composite
def odometry(draw: st.DrawFn) -> ms.Odometry | None:
    """Steps of any length and turn, some without a covariance, some much too sure of all or of
    one direction."""
    kind = draw(st.sampled_from(["fine", "fine", "fine", "fine", "none", "bare"]))
    if kind == "none":
        return None
    motion = (
        draw(LENGTHS),
        draw(mostly(0.0, 0.1, -2.0, 1e9)),
        draw(st.one_of(bearings, st.just(1e9))),
    )
    if kind == "bare":
        return ms.Odometry(*motion)
    variance = draw(st.sampled_from([1e-2, 1e-3, 1e-4, 1e-12, 1e4, 1e-200, 1e200]))
    covariance = np.diag([variance, variance, min(variance, 1.0)])
    coupled = draw(mostly(0.0, 0.5, 1.0 - 1e-9, -1.0 + 1e-15))
    i, j = draw(st.sampled_from([(0, 1), (0, 2), (1, 2)]))
    covariance[i, j] = covariance[j, i] = (
        coupled * math.sqrt(covariance[i, i]) * math.sqrt(covariance[j, j])
    )
    try:
        return ms.Odometry(*motion, covariance)
    except MeasurementError:
        return ms.Odometry(*motion)


@st.composite
def drives(draw: st.DrawFn) -> list[ms.BearingScan]:
    """Scans of landmarks from a path, or of nothing, in time or out of it."""
    count = draw(st.integers(0, 14))
    if count and draw(st.booleans()):
        most = draw(st.sampled_from([2, 5, 8]))
        values = draw(draw(st.sampled_from([seen_scans, loose_scans]))(count, 0, most))
    else:
        first = draw(st.lists(bearings, max_size=6))
        others = st.lists(bearings, max_size=6)
        values = [first if draw(st.booleans()) else draw(others) for _ in range(count)]
    times = draw(st.sampled_from(["none", "right", "any"]))
    found = []
    for k, entries in enumerate(values):
        time = None
        if times != "none":
            time = float(k) if times == "right" else draw(st.sampled_from([-1e9, 0.0, 1.0, 1e300]))
        found.append(
            ms.BearingScan(entries, sigma=draw(SIGMAS), time=time, odometry=draw(odometry()))
        )
    return found


@st.composite
def configs(draw: st.DrawFn) -> dict[str, Any]:
    return {
        "motion": draw(st.sampled_from(MOTIONS)),
        "hypotheses": draw(st.sampled_from([1, 2, 5])),
        "start_hypotheses": draw(st.sampled_from([1, 3, 10])),
        "lag": draw(st.sampled_from([1, 2, 3, 8])),
        "drop": draw(mostly(12.0, 1e-9, 1e9)),
        "ranked": draw(st.sampled_from([1, 3])),
        "depth": draw(st.sampled_from([1, 6])),
        "pair_within": draw(st.sampled_from([1, 5, 100])),
        "return_probability": draw(mostly(0.02, 1e-12, 1.0 - 1e-12)),
        "sight": draw(st.sampled_from([None, None, 1e-300, 1e-9, 5.0, 1e9, 1e300])),
        "settled": draw(mostly(0.3, 1e-9, 1e9)),
        "active": draw(st.sampled_from([1, 40])),
        "familiar": draw(mostly(0.5, 1e-9, 1e9)),
        "loop_odds": draw(mostly(6.0, 1e-9)),
        "loop_scans": draw(st.sampled_from([1, 3, 50])),
        "loop_every": draw(st.sampled_from([1, 10])),
        "twin_odds": draw(mostly(1.0, 1e-9, 1e9)),
        "most_landmarks": draw(st.sampled_from([1, 2, 1000])),
        "remaps": draw(st.sampled_from([0, 0, 0, 2])),
    }


@st.composite
def models(draw: st.DrawFn) -> dict[str, Any]:
    return {
        "sigma": draw(mostly(0.02, 1e-15, 1e-6, 1.0, 3.1)),
        "bearing_dof": draw(st.sampled_from([None, 4.0, 0.1, 1e6])),
        "landmark_sigma": draw(mostly(15.0, 1e-6, 0.5, 1e9)),
        "turn_sigma": draw(mostly(0.07, 1e-9, 3.1)),
        "drift_sigma": draw(mostly(0.09, 1e-9, 3.1)),
        "step_change_sigma": draw(mostly(0.2, 1e-9, 5.0, 100.0)),
        "heading_sigma": draw(mostly(0.05, 0.0, 3.1)),
        "lateral_sigma": draw(mostly(0.05, 0.0, 1e9)),
        "log_step_sigma": draw(mostly(1.0, 1e-9, 10.0)),
        "log_step_mean": draw(mostly(0.0, -50.0, 50.0)),
        "stops": draw(st.booleans()),
        "detection_probability": draw(mostly(0.9, 1e-12, 1.0)),
        "false_alarm_rate": draw(mostly(0.05, 0.0, 1e-300, 1e9)),
        "expected_landmarks": draw(mostly(10.0, 1e-12, 1e9)),
        "stay_probability": draw(mostly(0.97, 1e-12, 1.0)),
        "field_of_view": draw(mostly(2.0 * math.pi, 1e-9, 1.0, math.pi)),
    }


@examples(60)
@given(config=configs(), model=models(), scans=drives(), cut=st.integers(0, 14))
def test_the_estimator_survives(
    config: dict[str, Any],
    model: dict[str, Any],
    scans: list[ms.BearingScan],
    cut: int,
    survives: Survives,
    folder: Path,
) -> None:
    made = survives(ms.ObservationModel, **model)
    options = survives(ms.SlamConfig, model=made, **config) if made is not None else None
    if options is None:
        return
    slam = ms.MultiHypothesisSlam(options)
    taken = []
    for k, scan in enumerate(scans):
        if k == cut:
            slam.save(folder / "slam.npz")
            slam = ms.MultiHypothesisSlam.load(folder / "slam.npz")
        before = slam.n_scans
        try:
            posterior = slam.update(scan)
        except MeasurementError as refusal:
            assert f"scan {before} " in str(refusal)
            assert slam.n_scans == before
            continue
        taken.append(len(scan))
        check_belief(slam, posterior)
    assert slam.association.n_detections == tuple(taken)
    assert slam.online_trajectory.shape == (len(taken), 3)
    check_whole_run(slam, survives)
    for scan_number, count, odds in slam.loops:
        assert 0 <= scan_number < len(taken)
        assert count >= 1
        assert math.isfinite(odds)


def check_whole_run(slam: ms.MultiHypothesisSlam, survives: Survives) -> None:
    """The run smoothed as a whole has a place for everything, or is refused."""
    poses = survives(lambda: freeze(slam.trajectory.copy()))
    if poses is not None:
        assert poses.shape == (slam.n_scans, 3)
        points = slam.map.points
        assert points.shape == (slam.association.n_landmarks, 2)
        assert np.isfinite(points).all(), "a landmark"


@examples(2)
@given(count=st.sampled_from([100, 300]), motion=st.sampled_from(MOTIONS[:3]), data=st.data())
def test_crowds_survive(count: int, motion: ms.Motion, data: Any) -> None:
    """Hundreds of detections, all of them alike in some scans."""
    config = ms.SlamConfig(motion=motion, hypotheses=2, start_hypotheses=2)
    slam = ms.MultiHypothesisSlam(config)
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    for _ in range(3):
        alike = data.draw(st.sampled_from([False, False, True]))
        angles = np.full(count, 0.7) if alike else rng.uniform(-math.pi, math.pi, count)
        step = ms.Odometry(1.0, 0.0, 0.1, [0.01, 0.01, 0.001])
        check_belief(slam, slam.update(ms.BearingScan(angles, odometry=step)))


@pytest.mark.parametrize("motion", ["smooth", "odometry", "straight"])
def test_two_thousand_scans_of_nothing_survive(motion: ms.Motion) -> None:
    slam = ms.MultiHypothesisSlam(ms.SlamConfig(motion=motion))
    step = ms.Odometry(1.0, 0.0, 0.01, [0.01, 0.01, 0.001])
    for k in range(2000):
        posterior = slam.update(ms.BearingScan([], time=float(k), odometry=step))
    check_belief(slam, posterior)
    assert slam.association.n_landmarks == 0


def check_belief(slam: ms.MultiHypothesisSlam, posterior: ms.Posterior) -> None:
    """No nan leaves, whatever came in."""
    started = slam.status != "initialising"
    assert (len(posterior) > 0) == started
    probabilities = np.array([h.probability for h in posterior])
    if started:
        assert abs(probabilities.sum() - 1.0) < 1e-9, "probabilities"
    for hypothesis in posterior:
        assert math.isfinite(hypothesis.log_evidence)
        assert hypothesis.poses is not None
        assert np.isfinite(hypothesis.poses).all(), "a pose"
        for covariances in (hypothesis.pose_covariances, hypothesis.landmark_covariances):
            assert covariances is not None
            assert np.isfinite(covariances).all(), "a covariance"
            assert (np.diagonal(covariances, axis1=1, axis2=2) >= 0.0).all()
    for marginal in slam.marginal_associations:
        assert 0.0 < sum(marginal.values()) < 1.0 + 1e-9
    assert np.isfinite(slam.committed.mean).all()
    assert all(dropped.behind >= -1e-9 for dropped in slam.dropped)


@examples(60)
@given(
    name=st.sampled_from(
        ["hypotheses", "lag", "ranked", "depth", "pair_within", "active", "loop_scans",
         "loop_every", "drop", "return_probability", "settled", "familiar", "loop_odds", "sight",
         "remaps", "motion", "model"]
    ),
    value=st.one_of(
        st.floats(), st.integers(-3, 3),
        st.sampled_from([None, True, "x", b"", [], {}, 10**400, math.nan, object(), np.float32(1)]),
    ),
)  # fmt: skip
def test_configurations_are_made_or_refused(name: str, value: Any, survives: Survives) -> None:
    config = survives(ms.SlamConfig, **{name: value})
    if config is not None:
        assert ms.MultiHypothesisSlam(config).n_scans == 0


@examples(30)
@given(content=st.binary(max_size=200), data=st.data())
def test_any_file_is_loaded_or_refused(
    content: bytes, survives: Survives, folder: Path, data: Any
) -> None:
    path = folder / "any.npz"
    if data.draw(st.booleans()):
        ms.MultiHypothesisSlam().save(path)
        whole = bytearray(path.read_bytes())
        for _ in range(data.draw(st.integers(1, 4))):
            whole[data.draw(st.integers(0, len(whole) - 1))] ^= data.draw(st.integers(1, 255))
        content = bytes(whole[: data.draw(st.integers(0, len(whole)))])
    path.write_bytes(content)
    slam = survives(ms.MultiHypothesisSlam.load, path)
    if slam is not None:
        slam.update(ms.BearingScan([0.1]))
