"""Where a long drive has been and what it saw: smoothed path, map, loops, what is still open."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mht_slam.arrays import FloatArray
from mht_slam.errors import NoEstimateError
from mht_slam.plotting.labels import place_labels
from mht_slam.plotting.style import CHOSEN_TONE, INK, draw_ellipse, set_window

if TYPE_CHECKING:
    from mht_slam.hypotheses import Hypothesis
    from mht_slam.incremental.estimator import MultiHypothesisSlam

ALTERNATIVE_TONE = "#e0a860"
"""Light beside ink, also where colours are lost."""
FARTHEST = 1.0
"""Extents of the path, on either side of it, that the window follows landmarks to."""
MOST_LABELS = 40
AHEAD = np.array([[0.0, 0.0], [1.0, 0.0]])
"""In view at any rate: a robot that has not moved has a path without extent."""


def slam_map_figure(slam: MultiHypothesisSlam) -> Figure:
    """Draw the smoothed path and map of an estimator, in the frame of the first pose.

    Confirmed landmarks are filled and have their 95 % ellipse. Rings are where the robot was when
    a loop was closed. In a light tone, the other hypotheses over the open scans: their poses and
    landmarks, moved so that the oldest open pose of the best one lies on the smoothed path. Raises
    `NoEstimateError` before the first scan.
    """
    if not slam.n_scans:
        raise NoEstimateError("no scan has been taken: there is nothing to draw")
    path, landmarks = slam.trajectory, slam.map
    covariances, confirmed = landmarks.covariances, landmarks.confirmed
    figure = Figure(figsize=(9.0, 7.5), layout="constrained")
    axes = figure.subplots()
    sure = np.flatnonzero(confirmed).tolist()
    bounds = [(*point, *point) for point in landmarks.points[confirmed].tolist()]
    set_window(axes, np.concatenate([path[:, :2], AHEAD]), bounds, reach=FARTHEST)
    for i in sure:
        draw_ellipse(
            axes, landmarks.points[i], covariances[i], fill=False, edgecolor=CHOSEN_TONE, zorder=2
        )
    _draw_alternatives(axes, slam, path)
    axes.plot(*landmarks.points[confirmed].T, "o", color=CHOSEN_TONE, markeredgecolor=INK, zorder=4)
    axes.plot(*landmarks.points[~confirmed].T, "o", color="none", markeredgecolor="0.5", zorder=3)
    axes.plot(*path[:, :2].T, "-", color=INK, linewidth=1.0, zorder=5)
    axes.plot(*path[:1, :2].T, "s", color=INK, markersize=5, zorder=6)
    axes.plot(*path[-1:, :2].T, "^", color=INK, markersize=7, zorder=6)
    _draw_loops(axes, slam.loops, path, np.concatenate([path[:, :2], landmarks.points]))
    unit = slam.posterior.unit
    axes.set_xlabel(f"forward of the first pose, {unit}s")
    axes.set_ylabel(f"left of it, {unit}s")
    n_loops = len(slam.loops)
    axes.set_title(
        f"{len(path)} scans, {len(sure)} landmarks confirmed of {len(landmarks)}, "
        f"{n_loops} {'loop' if n_loops == 1 else 'loops'} closed; {slam.status}"
    )
    figure.legend(handles=_handles(has_loops=n_loops > 0), loc="outside lower center", ncols=3,
                  frameon=False)  # fmt: skip
    return figure


def carried_over(poses: FloatArray, source: FloatArray, target: FloatArray) -> FloatArray:
    """Move (k, 2) or (k, 3) points or poses by the motion that takes pose `source` to `target`.

    >>> carried_over(np.array([[1.0, 0.0]]), np.zeros(3), np.array([2.0, 0.0, np.pi / 2])).round(9)
    array([[2., 1.]])
    """
    turn = target[2] - source[2]
    c, s = np.cos(turn), np.sin(turn)
    moved = poses.copy()
    moved[:, :2] = (poses[:, :2] - source[:2]) @ np.array([[c, s], [-s, c]]) + target[:2]
    moved[:, 2:] += turn
    return moved


def _draw_alternatives(axes: Axes, slam: MultiHypothesisSlam, path: FloatArray) -> None:
    posterior = slam.posterior
    if len(posterior) < 2:
        return
    best = _estimate(posterior[0])[0]
    first = posterior.scans[0]
    for hypothesis in posterior[1:]:
        poses, points = _estimate(hypothesis)
        poses, points = (carried_over(part, best[0], path[first]) for part in (poses, points))
        axes.plot(*poses[:, :2].T, "-", color=ALTERNATIVE_TONE, linewidth=2.5, zorder=1)
        axes.plot(*points.T, "x", color=ALTERNATIVE_TONE, markersize=7, zorder=1)


def _estimate(hypothesis: Hypothesis) -> tuple[FloatArray, FloatArray]:
    assert hypothesis.poses is not None  # noqa: S101 - narrows the type
    assert hypothesis.landmarks is not None  # noqa: S101 - narrows the type
    assert hypothesis.ranged is not None  # noqa: S101 - narrows the type
    return hypothesis.poses, hypothesis.landmarks[hypothesis.ranged]


def _draw_loops(
    axes: Axes, loops: tuple[tuple[int, int, float], ...], path: FloatArray, avoid: FloatArray
) -> None:
    if not loops:
        return
    at = path[[scan for scan, _, _ in loops], :2]
    axes.plot(*at.T, "o", color="none", markeredgecolor=INK, markersize=12, zorder=6)
    if len(loops) <= MOST_LABELS:
        texts = [f"scan {scan}: {count}" for scan, count, _ in loops]
        place_labels(axes, at, texts, avoid=avoid)


def _handles(*, has_loops: bool) -> list[Line2D]:
    handles = [
        Line2D([], [], color=INK, linewidth=1.0, label="smoothed path"),
        Line2D([], [], color=INK, marker="s", linestyle="", markersize=5, label="first pose"),
        Line2D([], [], color=INK, marker="^", linestyle="", label="last pose"),
        Line2D([], [], color=CHOSEN_TONE, marker="o", markeredgecolor=INK, linestyle="",
               label="landmark and its 95 % ellipse"),
        Line2D([], [], color="none", marker="o", markeredgecolor="0.5", linestyle="",
               label="landmark seen twice only"),
        Line2D([], [], color=ALTERNATIVE_TONE, marker="x", linewidth=2.5,
               label="other hypotheses over the open scans"),
    ]  # fmt: skip
    if has_loops:
        ring = Line2D([], [], color="none", marker="o", markeredgecolor=INK, markersize=12,
                      label="loop closed: landmarks recognised")  # fmt: skip
        handles.append(ring)
    return handles
