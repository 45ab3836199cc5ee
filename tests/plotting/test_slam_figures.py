"""Figures of a drive show what the estimator has; frames are few and survive a kill."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.animation import PillowWriter
from matplotlib.figure import Figure
from PIL import Image

from mht_slam.errors import NoEstimateError
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.estimator import MultiHypothesisSlam
from mht_slam.measurements import BearingScan
from mht_slam.plotting import FrameRecorder, slam_animation, slam_frames, slam_map_figure
from mht_slam.plotting.slam_map import ALTERNATIVE_TONE, carried_over
from mht_slam.simulation.drives import simulate_drive


@pytest.fixture(scope="module")
def scans() -> tuple[BearingScan, ...]:
    rng = np.random.default_rng(1)
    return simulate_drive("smooth", 10, 18, rng, sigma=math.radians(0.5)).scans


@pytest.fixture(scope="module")
def slam(scans: tuple[BearingScan, ...]) -> MultiHypothesisSlam:
    slam = MultiHypothesisSlam(SlamConfig(lag=6, hypotheses=4))
    for scan in scans:
        slam.update(scan)
    return slam


def lines_of(figure: Figure, colour: str) -> list[Any]:
    return [line for line in figure.axes[0].lines if line.get_color() == colour]


def test_the_map_shows_path_landmarks_ellipses_and_alternatives(slam: MultiHypothesisSlam) -> None:
    figure = slam_map_figure(slam)
    axes = figure.axes[0]
    (path,) = [line for line in lines_of(figure, "black") if line.get_linestyle() == "-"]
    assert np.array_equal(path.get_xydata(), slam.trajectory[:, :2])
    assert len(axes.patches) == slam.map.confirmed.sum() > 0
    drawn = {tuple(point) for line in axes.lines for point in line.get_xydata().tolist()}
    assert {tuple(point) for point in slam.map.points.tolist()} <= drawn
    light = [line for line in lines_of(figure, ALTERNATIVE_TONE) if line.get_linestyle() == "-"]
    assert len(light) == len(slam.posterior) - 1 > 0
    assert "loops closed; tracking" in axes.get_title()


def test_a_loop_is_a_ring_where_it_was_closed(
    slam: MultiHypothesisSlam, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(MultiHypothesisSlam, "loops", ((4, 3, 7.5),))
    axes = slam_map_figure(slam).axes[0]
    assert "1 loop closed" in axes.get_title()
    rings = [line.get_xydata() for line in axes.lines if line.get_markersize() == 12]
    assert np.array_equal(rings, [slam.trajectory[4:5, :2]])
    assert "scan 4: 3" in {text.get_text() for text in axes.texts}


def test_alternatives_move_with_the_pose_that_they_start_from() -> None:
    poses = np.array([[1.0, 2.0, 0.5], [2.0, 2.0, 0.7]])
    target = np.array([-3.0, 1.0, 2.0])
    moved = carried_over(poses, poses[0], target)
    assert moved[0] == pytest.approx(target)
    assert math.dist(moved[0, :2], moved[1, :2]) == pytest.approx(1.0)
    back = carried_over(moved, target, poses[0])
    assert back == pytest.approx(poses)


def test_before_there_is_an_estimate_there_is_nothing_to_draw() -> None:
    empty = MultiHypothesisSlam()
    for draw in (slam_map_figure, slam_frames.frame_of):
        with pytest.raises(NoEstimateError):
            draw(empty)
    with pytest.raises(NoEstimateError, match="three scans"):
        slam_animation((), np.empty((0, 3)))


def pretend(n_scans: int) -> Any:
    """What a frame needs of an estimator, at no cost."""
    pose = np.array([[float(n_scans), 0.0, 0.0]])
    best = SimpleNamespace(poses=pose, landmarks=np.ones((1, 2)), ranged=np.array([True]))
    posterior = type("Posterior", (list,), {"scans": (n_scans - 1,)})([best])
    return SimpleNamespace(
        n_scans=n_scans,
        posterior=posterior,
        committed=SimpleNamespace(points=np.full((n_scans, 2), 0.1)),
        status="tracking",
        loops=(),
    )


@pytest.mark.parametrize("n_scans", [1, 119, 121, 500, 1000])
def test_frames_are_few_evenly_spread_and_the_same_after_a_kill(
    n_scans: int, tmp_path: Path
) -> None:
    undisturbed = FrameRecorder()
    for k in range(1, n_scans + 1):
        undisturbed.take(pretend(k))
    scans = [frame.scan for frame in undisturbed.frames]
    assert len(scans) <= slam_frames.MOST_FRAMES
    assert len(scans) >= min(n_scans, slam_frames.MOST_FRAMES // 2)
    assert len(set(np.diff(scans).tolist())) <= 1

    log, saved, killed = tmp_path / "log", n_scans // 3, n_scans // 2
    before = FrameRecorder(log)
    for k in range(1, killed + 1):
        before.take(pretend(k))
    with log.open("a") as file:
        file.write('{"scan": 3, "first_')  # where the kill came
    after = FrameRecorder(log, resumed_at=saved)
    for k in range(saved + 1, n_scans + 1):
        after.take(pretend(k))
    assert [frame.scan for frame in after.frames] == scans
    for one, other in zip(after.frames, undisturbed.frames, strict=True):
        assert np.array_equal(one.settled, other.settled)
        assert np.array_equal(one.poses[0], other.poses[0])


def test_a_new_run_forgets_the_log_of_another(tmp_path: Path) -> None:
    log = tmp_path / "log"
    FrameRecorder(log).take(pretend(5))
    assert FrameRecorder(log).frames == ()
    assert log.read_text() == ""


def test_the_animation_has_a_picture_for_each_frame(
    scans: tuple[BearingScan, ...], tmp_path: Path
) -> None:
    recorder = FrameRecorder()
    slam = MultiHypothesisSlam(SlamConfig(lag=6, hypotheses=4))
    for scan in scans[:9]:
        slam.update(scan)
        recorder.take(slam)
    assert [frame.scan for frame in recorder.frames] == list(range(2, 9))
    animation = slam_animation(recorder.frames, slam.online_trajectory)
    path = tmp_path / "run.gif"
    animation.save(path, PillowWriter(10), dpi=40)
    with Image.open(path) as picture:
        assert picture.n_frames == 7
        sizes = set()
        for k in range(7):
            picture.seek(k)
            sizes.add(picture.size)
    assert len(sizes) == 1
