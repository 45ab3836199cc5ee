"""The whole run as the most probable hypothesis has it: path, landmarks, and how sure it is."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mht_slam.errors import NoEstimateError
from mht_slam.hypotheses import Hypothesis
from mht_slam.plotting.labels import place_labels
from mht_slam.plotting.style import (
    CHOSEN_TONE,
    INK,
    draw_ellipse,
    ellipse_bounds,
    in_window,
    set_window,
)

FARTHEST = 3.0
"""Extents of the path, on either side of it, that the window follows landmarks to."""
MOST_LABELS = 40
HEADING_LENGTH = 0.04
"""Length of a heading's stroke, as a share of the window."""


def run_map_figure(hypothesis: Hypothesis, unit: str = "baseline") -> Figure:
    """Draw poses and landmarks of a solved hypothesis in the run's frame.

    Landmarks with a range have their 95 % ellipse and the number of their row; those seen once are
    left out, because their distance is the prior's. `unit` is the posterior's. Raises
    `NoEstimateError` for a hypothesis without an estimate.
    """
    poses, landmarks, covariances = (
        hypothesis.poses,
        hypothesis.landmarks,
        hypothesis.landmark_covariances,
    )
    is_ranged = hypothesis.ranged
    if poses is None or landmarks is None or covariances is None or is_ranged is None:
        raise NoEstimateError("the hypothesis has no estimate to draw")
    ranged = np.flatnonzero(is_ranged)
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    axes = figure.subplots()
    bounds = [ellipse_bounds(landmarks[row], covariances[row]) for row in ranged]
    set_window(axes, poses[:, :2], bounds, reach=FARTHEST)
    for row in ranged.tolist():
        draw_ellipse(
            axes, landmarks[row], covariances[row], fill=False, edgecolor=CHOSEN_TONE, zorder=1
        )
    axes.plot(*landmarks[ranged].T, "o", color=CHOSEN_TONE, markeredgecolor=INK, zorder=3)
    axes.plot(*poses[:, :2].T, "-", color=INK, linewidth=0.8, zorder=2)
    axes.plot(*poses[:, :2].T, ".", color=INK, zorder=4)
    stroke = HEADING_LENGTH * float(np.ptp(axes.get_xlim()))
    ends = poses[:, :2] + stroke * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    axes.plot(*np.stack([poses[:, :2], ends], axis=1).T, color=INK, linewidth=0.8, zorder=2)
    shown = [int(ranged[i]) for i in in_window(axes, landmarks[ranged])]
    if len(shown) <= MOST_LABELS:
        place_labels(axes, landmarks[shown], [f"{row}" for row in shown], avoid=poses[:, :2])
    axes.set_xlabel(f"along the first step, {unit}s")
    axes.set_ylabel(f"left of it, {unit}s")
    outside = len(ranged) - len(shown)
    axes.set_title(
        f"The most probable hypothesis, p = {hypothesis.probability:.3f}: {len(poses)} scans, "
        f"{len(ranged)} landmarks" + (f", {outside} of them farther away" if outside else "")
    )
    figure.legend(
        handles=[
            Line2D([], [], color=INK, marker=".", linewidth=0.8, label="path and headings"),
            Line2D(
                [], [], color=CHOSEN_TONE, marker="o", markeredgecolor=INK,
                label="landmark and its 95 % ellipse",
            ),
        ],
        loc="outside lower center",
        ncols=2,
        frameon=False,
    )  # fmt: skip
    return figure
