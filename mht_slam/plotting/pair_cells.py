"""Figure (a): cones and cells of each pair in its own F_R, as the paper's Figs. 2 and 7."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mht_slam.arrays import FloatArray
from mht_slam.association import MISSED, Association
from mht_slam.measurements import RunPair, StraightRun
from mht_slam.plotting.frames import TrueLayout, between
from mht_slam.plotting.labels import place_labels
from mht_slam.plotting.style import (
    CELL_TONE,
    CHOSEN_TONE,
    CONE_TONE,
    INK,
    TRUTH_TONE,
    draw_shape,
    in_window,
    set_window,
)
from mht_slam.polygon.cones import cells, cones

FARTHEST_SHOWN = 12.0
"""A cell that begins farther away than this, baselines, does not widen the window."""

PANEL_WIDTH = 5.5
ROOM_FOR_TEXT = 1.9
"""Inches: of a panel, and of a figure's height for titles, axis labels and legend."""

_ENDS = np.array([[0.0, 0.0], [1.0, 0.0]])


def cells_figure(
    run: StraightRun | RunPair,
    *,
    epsilon: float,
    max_range: float = 100.0,
    scans: Sequence[int] = (0, 1, 2),
    association: Association | None = None,
    truth: TrueLayout | None = None,
) -> Figure:
    """Draw the cones and cells of each compared pair of scans, one panel per pair.

    Every panel is the pair's own F_R: its first observation point at the origin, the second at
    (1, 0). All n^2 cells are outlined; those of `association` (over the scans drawn) are filled
    and labelled by its rows. A window follows long cells only a short way.

    Parameters
    ----------
    epsilon : vision error, radians. max_range : where cells are cut, baselines of each pair.
    scans : three scans of a straight run; a `RunPair` is drawn whole.
    truth : where landmarks and observation points really were, over the same scans.

    Source: the paper's section 3, Figs. 2 and 7; docs/method.md, section 3.
    """
    if isinstance(run, RunPair):
        members, pairs = run.scans, ((0, 1), (2, 3))
    else:
        members, pairs = run.select(scans).scans, ((0, 1), (1, 2))
    figure = Figure(figsize=(2.0 * PANEL_WIDTH + 1.0, PANEL_WIDTH), layout="constrained")
    panels = figure.subplots(1, len(pairs), squeeze=False)[0]
    label_later = [
        _draw_pair(
            axes,
            (members[first].bearings, members[second].bearings),
            (first, second),
            epsilon=epsilon,
            max_range=max_range,
            association=association,
            truth=truth,
        )
        for axes, (first, second) in zip(panels, pairs, strict=True)
    ]
    tallest = max(np.ptp(axes.get_ylim()) / np.ptp(axes.get_xlim()) for axes in panels)
    figure.set_figheight(PANEL_WIDTH * min(float(tallest), 1.3) + ROOM_FOR_TEXT)
    figure.suptitle(f"Cones of ±{math.degrees(epsilon):g}° and the cells where two of them meet")
    figure.legend(
        handles=_legend(association is not None, truth is not None),
        loc="outside lower center",
        ncols=5,
        frameon=False,
    )
    for label in label_later:
        label()
    return figure


def _draw_pair(
    axes: Axes,
    bearings: tuple[FloatArray, FloatArray],
    columns: tuple[int, int],
    *,
    epsilon: float,
    max_range: float,
    association: Association | None,
    truth: TrueLayout | None,
) -> Callable[[], None]:
    """Draw one panel; returns what writes its labels once the figure has its final size."""
    for apex, seen in zip((0.0, 1.0), bearings, strict=True):
        for cone in cones(seen, apex, epsilon=epsilon, max_range=max_range):
            draw_shape(axes, cone, facecolor=CONE_TONE, edgecolor="0.75", linewidth=0.4, alpha=0.6)
    all_cells = cells(*bearings, epsilon=epsilon, max_range=max_range)
    chosen = _chosen_cells(association, columns)
    for index in np.argwhere(all_cells.filled):
        place = (int(index[0]), int(index[1]))
        style = (
            {"facecolor": CHOSEN_TONE, "edgecolor": INK, "linewidth": 1.3, "zorder": 4}
            if place in chosen
            else {"fill": False, "edgecolor": CELL_TONE, "linewidth": 0.9, "zorder": 3}
        )
        draw_shape(axes, all_cells.polygons[place], **style)
    shown = [place for place in chosen if all_cells.filled[place]]
    # Without a hypothesis every cell is as good as another.
    framed = shown or [(int(i), int(j)) for i, j in np.argwhere(all_cells.filled)]
    polygons = np.array([all_cells.polygons[place] for place in framed], dtype=np.object_)
    true_points = _true_points(truth, columns)
    must = np.vstack([_ENDS, _nearest_points(polygons), true_points])
    must = must[np.abs(must - [0.5, 0.0]).max(axis=1) <= FARTHEST_SHOWN]
    set_window(axes, must, shapely.bounds(polygons).reshape(-1, 4), reach=0.35)
    axes.plot(*_ENDS.T, "o-", color=INK, markersize=6, linewidth=1.5, zorder=5)
    axes.plot(*true_points.T, "*", color=TRUTH_TONE, markersize=10, markeredgecolor=INK, zorder=6)
    names = f"O{columns[0] + 1}", f"O{columns[1] + 1}"
    n_cut = sum(bool(all_cells.cut[place]) for place in shown)
    note = f"; {n_cut} of the filled reach beyond {max_range:g} baselines" if n_cut else ""
    axes.set_title(
        f"Pair ({names[0]}, {names[1]}): {int(all_cells.filled.sum())} cells{note}", fontsize=10
    )
    axes.set_xlabel(f"along the run, baselines |{names[0]} {names[1]}|")
    axes.set_ylabel("to the left, baselines")
    named = [(all_cells.polygons[place], chosen[place]) for place in shown]
    return partial(_label, axes, named, columns, true_points)


def _chosen_cells(
    association: Association | None, columns: tuple[int, int]
) -> dict[tuple[int, int], int]:
    """Cell (detection of the first scan, of the second) of each row that both scans see."""
    if association is None:
        return {}
    table = association.table[:, list(columns)]
    return {
        (int(i), int(j)): row for row, (i, j) in enumerate(table) if i != MISSED and j != MISSED
    }


def _true_points(truth: TrueLayout | None, columns: tuple[int, int]) -> FloatArray:
    """True landmarks (k, 2) that both scans see, in the pair's F_R."""
    if truth is None:
        return np.empty((0, 2))
    seen = (truth.association.table[:, list(columns)] != MISSED).all(axis=1)
    ends = truth.poses[list(columns), :2]
    return between(truth.landmarks[seen], ends[0], ends[1])


def _nearest_points(polygons: np.typing.NDArray[np.object_]) -> FloatArray:
    """(k, 2) the point of each cell that is nearest to the middle of the baseline."""
    middle = shapely.Point(0.5, 0.0)
    lines = shapely.shortest_line(polygons, middle)
    return np.asarray(shapely.get_coordinates(shapely.get_point(lines, 0)).reshape(-1, 2))


def _label(
    axes: Axes,
    named: list[tuple[Any, int]],
    columns: tuple[int, int],
    true_points: FloatArray,
) -> None:
    (x_low, x_high), (y_low, y_high) = axes.get_xlim(), axes.get_ylim()
    window = shapely.box(x_low, y_low, x_high, y_high)
    visible = [(shapely.intersection(cell, window), row) for cell, row in named]
    visible = [(cell, row) for cell, row in visible if not cell.is_empty]
    anchors = np.array([*_ENDS, *(_inside(cell) for cell, _ in visible)])
    texts = [
        *(f"O{column + 1}" for column in columns),
        *(f"landmark {row}" for _, row in visible),
    ]
    outlines = shapely.segmentize(
        np.array([cell for cell, _ in visible], dtype=np.object_), (x_high - x_low) / 60.0
    )
    avoid = np.vstack([shapely.get_coordinates(outlines).reshape(-1, 2), true_points])
    inside = in_window(axes, anchors)
    place_labels(axes, anchors[inside], [texts[i] for i in inside], avoid=avoid)


def _inside(cell: Any) -> FloatArray:
    """A point (2,) well inside a cell."""
    return np.asarray(shapely.get_coordinates(shapely.point_on_surface(cell))[0])


def _legend(has_hypothesis: bool, has_truth: bool) -> list[Patch | Line2D]:
    handles: list[Patch | Line2D] = [
        Line2D([], [], color=INK, marker="o", label="observation points"),
        Patch(facecolor=CONE_TONE, edgecolor="0.75", label="cones"),
        Patch(fill=False, edgecolor=CELL_TONE, label="cells"),
    ]
    if has_hypothesis:
        handles.append(Patch(facecolor=CHOSEN_TONE, edgecolor=INK, label="this hypothesis"))
    if has_truth:
        handles.append(
            Line2D(
                [], [], color=TRUTH_TONE, marker="*", markersize=10, markeredgecolor=INK,
                linestyle="none", label="true landmarks",
            )
        )  # fmt: skip
    return handles
