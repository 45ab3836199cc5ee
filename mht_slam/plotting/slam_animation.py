"""How a drive was understood: map, path and alternatives from scan to scan, as an animation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.animation import FuncAnimation
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mht_slam.arrays import FloatArray
from mht_slam.errors import NoEstimateError
from mht_slam.plotting.slam_frames import MOST_ALTERNATIVES, SlamFrame
from mht_slam.plotting.slam_map import AHEAD, ALTERNATIVE_TONE, FARTHEST
from mht_slam.plotting.style import CHOSEN_TONE, INK, set_window

FRAMES_PER_SECOND = 10


def slam_animation(
    frames: Sequence[SlamFrame], online_trajectory: FloatArray, unit: str = "baseline"
) -> FuncAnimation:
    """Animate frames of a run whose poses, as they were settled, are (m, 3).

    Filled landmarks are settled, hollow ones where the best hypothesis over the open scans has
    them; the light lines are the alternatives' paths.
    The caller saves: ``animation.save("run.gif", PillowWriter(FRAMES_PER_SECOND))``. Raises
    `NoEstimateError` without frames.
    """
    if not frames:
        raise NoEstimateError("no frames: a run needs three scans to have an estimate")
    figure = Figure(figsize=(7.0, 6.0), layout="constrained")
    axes = figure.subplots()
    bounds = [(*point, *point) for frame in frames for point in frame.settled.tolist()]
    newest = np.concatenate([frame.poses[0][:, :2] for frame in frames])
    set_window(
        axes, np.concatenate([online_trajectory[:, :2], newest, AHEAD]), bounds, reach=FARTHEST
    )
    axes.set_xlabel(f"forward of the first pose, {unit}s")
    axes.set_ylabel(f"left of it, {unit}s")
    title = axes.set_title(_title(frames[-1]))
    alternatives = [
        axes.plot([], [], "-", color=ALTERNATIVE_TONE, linewidth=2.5, zorder=1)[0]
        for _ in range(MOST_ALTERNATIVES)
    ]
    style: dict[str, Any] = {"markersize": 5, "markeredgewidth": 0.8}
    (tentative,) = axes.plot([], [], "o", color="none", markeredgecolor="0.4", **style, zorder=2)
    (settled,) = axes.plot([], [], "o", color=CHOSEN_TONE, markeredgecolor=INK, **style, zorder=3)
    (path,) = axes.plot([], [], "-", color=INK, linewidth=1.0, zorder=4)
    (robot,) = axes.plot([], [], "^", color=INK, markersize=7, zorder=5)
    figure.legend(
        handles=[
            Line2D([], [], color=INK, marker="^", linewidth=1.0, label="path so far"),
            Line2D([], [], color=ALTERNATIVE_TONE, linewidth=2.5, label="alternatives"),
            Line2D([], [], color=CHOSEN_TONE, marker="o", markeredgecolor=INK, linestyle="",
                   label="settled landmark"),
            Line2D([], [], color="none", marker="o", markeredgecolor="0.4", linestyle="",
                   label="by the open scans"),
        ],
        loc="outside lower center", ncols=4, frameon=False, fontsize=8,
    )  # fmt: skip
    # The layout is found once: frames shall not jump.
    figure.draw_without_rendering()
    figure.set_layout_engine("none")

    def show(number: int) -> list[Any]:
        frame = frames[number]
        walked = np.concatenate([online_trajectory[: frame.first_open], frame.poses[0]])
        title.set_text(_title(frame))
        path.set_data(*walked[:, :2].T)
        robot.set_data(*walked[-1:, :2].T)
        settled.set_data(*frame.settled.T)
        tentative.set_data(*frame.tentative.T)
        others = frame.poses[1:]
        for i, line in enumerate(alternatives):
            line.set_data(*(others[i][:, :2].T if i < len(others) else ([], [])))
        return [title, path, robot, settled, tentative, *alternatives]

    return FuncAnimation(figure, show, frames=len(frames), interval=1000 // FRAMES_PER_SECOND)


def _title(frame: SlamFrame) -> str:
    loops = f", loops closed: {frame.n_loops}" if frame.n_loops else ""
    return f"scan {frame.scan}: {len(frame.settled)} landmarks{loops}; {frame.status}"
