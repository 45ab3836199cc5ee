"""Zones of the visual order as in the paper's Fig. 1, and the order changes along a path."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt
import shapely
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mht_slam.arrays import FloatArray
from mht_slam.errors import OptionError
from mht_slam.plotting.labels import place_labels
from mht_slam.plotting.style import CHOSEN_TONE, INK, TRUTH_TONE, draw_shape, set_window
from mht_slam.tracking.zones import convex_corners, order_changes

ZONE_TONES = {"A": "#f6d8a8", "B": "#cfe0ef", "C": "white"}
ZONE_MEANINGS = {
    "A": "A: inside, all apparent angles below 180°",
    "B": "B: outside, same visual order",
    "C": "C: another visual order",
}
ROOM = 0.8
"""What is shown round the landmarks, as a share of their extent, so that zones have places."""
ROOM_OF_PATH = 0.05
"""The same round a path among landmarks."""


def zones_figure(landmarks: npt.ArrayLike) -> Figure:
    """Draw the zones A, B and C of landmarks in convex position, and the lines between them.

    `landmarks` is (n, 2), any unit. Solid lines are where the visual order changes: the lines
    through two landmarks outside the segment between them. Raises as `mht_slam.zone` for landmarks
    that have no zones. Source: the paper's Fig. 1; docs/method.md, section 6.
    """
    corners = convex_corners(landmarks)
    figure = Figure(figsize=(7.0, 6.4), layout="constrained")
    axes = figure.subplots()
    _show(axes, corners, ROOM)
    window = shapely.box(*_bounds(axes))
    axes.set_facecolor(ZONE_TONES["C"])
    sides = np.roll(corners, -1, axis=0) - corners
    inner = [_left_of(c, s, window) for c, s in zip(corners, sides, strict=True)]
    outer = [_left_of(c, -s, window) for c, s in zip(corners, sides, strict=True)]
    for k, beyond in enumerate(outer):
        others = [half for j, half in enumerate(inner) if j != k]
        region = shapely.intersection_all([window, beyond, *others])
        draw_shape(axes, region, facecolor=ZONE_TONES["B"], zorder=1)
    draw_shape(axes, shapely.Polygon(corners), facecolor=ZONE_TONES["A"], zorder=1)
    _draw_lines(axes, corners)
    _draw_landmarks(axes, np.asarray(landmarks, dtype=np.float64))
    axes.set_title("Zones of the visual order")
    handles = [
        Patch(facecolor=ZONE_TONES[name], edgecolor="0.6", label=ZONE_MEANINGS[name])
        for name in ZONE_TONES
    ]
    _legend(figure, [*handles, _change_line()], columns=2)
    return figure


def order_changes_figure(path: npt.ArrayLike, landmarks: npt.ArrayLike) -> Figure:
    """Draw a path among landmarks in any layout, and every place where the visual order changes.

    `path` is (m, 2) and `landmarks` (n, 2), in one frame. Changes that the paper's rule sees are
    filled, the others hollow. Raises as `mht_slam.order_changes`, and `OptionError` for a path of
    fewer than two vertices.
    """
    changes = order_changes(path, landmarks)
    vertices = np.asarray(path, dtype=np.float64)
    points = np.asarray(landmarks, dtype=np.float64).reshape(-1, 2)
    if len(vertices) < 2:
        raise OptionError(f"path has {len(vertices)} vertices: give at least two")
    figure = Figure(figsize=(7.0, 6.4), layout="constrained")
    axes = figure.subplots()
    _show(axes, np.concatenate([vertices, points]), ROOM_OF_PATH)
    _draw_lines(axes, points)
    axes.plot(*vertices.T, "-", color=CHOSEN_TONE, linewidth=2.5, zorder=3)
    end, before = vertices[-1], vertices[-2]
    axes.annotate(
        "",
        xy=(float(end[0]), float(end[1])),
        xytext=tuple((before + 0.98 * (end - before)).tolist()),
        arrowprops={"arrowstyle": "-|>", "color": CHOSEN_TONE, "mutation_scale": 18},
        zorder=3,
    )
    for change in changes:
        axes.plot(
            *change.point,
            "o",
            markersize=9,
            markerfacecolor=TRUTH_TONE if change.by_paper_rule else "white",
            markeredgecolor=TRUTH_TONE,
            markeredgewidth=1.6,
            zorder=5,
        )
    _draw_landmarks(axes, points)
    if changes:
        places = np.array([change.point for change in changes])
        names = ["{} and {}".format(*change.pair) for change in changes]
        place_labels(axes, places, names, avoid=points)
    axes.set_title(f"{len(changes)} changes of the visual order along the path")
    handles = [
        Line2D([], [], color=CHOSEN_TONE, linewidth=2.5, label="path"),
        _ring(TRUTH_TONE, "change, also by the paper's rule"),
        _change_line(),
        _ring("white", "change that the paper's rule misses"),
    ]
    _legend(figure, handles, columns=2)
    return figure


def _show(axes: Axes, must: FloatArray, share: float) -> None:
    room = share * float(np.ptp(must, axis=0).max())
    low, high = must.min(axis=0) - room, must.max(axis=0) + room
    set_window(axes, must, [(*low.tolist(), *high.tolist())], reach=share)
    axes.set_xlabel("x")
    axes.set_ylabel("y")


def _bounds(axes: Axes) -> tuple[float, float, float, float]:
    (x_low, x_high), (y_low, y_high) = axes.get_xlim(), axes.get_ylim()
    return x_low, y_low, x_high, y_high


def _left_of(start: FloatArray, along: FloatArray, window: shapely.Polygon) -> shapely.Polygon:
    """Everything on the left of a line, as far as the window reaches."""
    x_low, y_low, x_high, y_high = window.bounds
    reach = 4.0 * (x_high - x_low + y_high - y_low)
    ahead = reach * along / np.hypot(*along)
    aside = np.array([-ahead[1], ahead[0]])
    return shapely.Polygon(
        [start - ahead, start + ahead, start + ahead + aside, start - ahead + aside]
    )


def _draw_lines(axes: Axes, points: FloatArray) -> None:
    """Draw the line through every pair: dotted between the two, solid outside."""
    x_low, y_low, x_high, y_high = _bounds(axes)
    reach = 4.0 * (x_high - x_low + y_high - y_low)
    for i, j in combinations(range(len(points)), 2):
        first, second = points[i], points[j]
        ahead = reach * (second - first) / np.hypot(*(second - first))
        axes.plot(*np.stack([first, second], axis=1), ":", color="0.6", linewidth=0.8, zorder=2)
        for start, end in ((second, second + ahead), (first, first - ahead)):
            axes.plot(*np.stack([start, end], axis=1), "-", color="0.45", linewidth=0.8, zorder=2)


def _draw_landmarks(axes: Axes, points: FloatArray) -> None:
    axes.plot(*points.T, "o", color=INK, markersize=6, zorder=4)
    for k, point in enumerate(points):
        axes.annotate(
            f"{k}",
            (float(point[0]), float(point[1])),
            xytext=(5, -12),
            textcoords="offset points",
            zorder=6,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.5},
        )


def _change_line() -> Line2D:
    return Line2D([], [], color="0.45", linewidth=0.8, label="crossing it changes the order")


def _ring(filling: str, label: str) -> Line2D:
    return Line2D(
        [], [], marker="o", linestyle="", markersize=9, markeredgecolor=TRUTH_TONE,
        markerfacecolor=filling, label=label,
    )  # fmt: skip


def _legend(figure: Figure, handles: Sequence[Artist], *, columns: int) -> None:
    figure.legend(handles=list(handles), loc="outside lower center", ncols=columns, frameon=False)
