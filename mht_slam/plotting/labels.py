"""Labels beside their points, where they cover neither each other nor other points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mht_slam.arrays import FloatArray

_DISTANCES = (6.0, 13.0, 24.0, 36.0, 50.0, 66.0)
"""How far a label may stand from its point, printer's points, nearest tried first."""

_DIRECTIONS = np.deg2rad([45.0, 135.0, -45.0, -135.0, 90.0, -90.0, 0.0, 180.0])
_PADDING = 2.0
_LINE_FROM = 12.0
"""From this distance on, a thin line ties the label to its point."""


def place_labels(
    axes: Axes,
    anchors: FloatArray,
    texts: Sequence[str],
    *,
    avoid: FloatArray | None = None,
    size: float = 8.5,
) -> None:
    """Write `texts` beside `anchors` (k, 2), in data coordinates.

    Greedy: each label takes the nearest place that covers no earlier label, no anchor and none of
    the points to `avoid` (j, 2), is nearer to its own anchor than to any other, and stays inside
    the axes; where there is none, the one that offends least. Call it last: the limits of the
    axes must stand.
    """
    figure = cast("Figure", axes.figure)
    figure.draw_without_rendering()
    to_pixels = axes.transData.transform
    points = to_pixels(anchors)
    obstacles = points if avoid is None or not len(avoid) else np.vstack([points, to_pixels(avoid)])
    scale = figure.dpi / 72.0
    frame = np.array(axes.get_window_extent().extents)
    taken: list[FloatArray] = []
    for anchor, point, text in zip(anchors.tolist(), points, texts, strict=True):
        label = axes.annotate(
            text,
            anchor,
            xytext=(0.0, 0.0),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=size,
            zorder=10,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8},
            arrowprops={"arrowstyle": "-", "linewidth": 0.6, "shrinkA": 0.0, "shrinkB": 3.0},
        )
        label.set_in_layout(False)
        extent = label.get_window_extent()
        half = 0.5 * np.array([extent.width, extent.height]) + _PADDING * scale
        best: tuple[float, FloatArray, float] | None = None
        for distance in _DISTANCES:
            for direction in _DIRECTIONS:
                way = np.array([np.cos(direction), np.sin(direction)])
                offset = distance * scale * way + half * np.sign(np.round(way, 6))
                box = np.concatenate([point + offset - half, point + offset + half])
                cost = _cost(box, taken, obstacles, frame)
                cost += _mistakable(box, point, points)
                if best is None or cost < best[0]:
                    best = (cost, offset, distance)
            if best is not None and best[0] == 0.0:
                break
        assert best is not None  # noqa: S101 - the directions are not empty
        _, offset, distance = best
        taken.append(np.concatenate([point + offset - half, point + offset + half]))
        label.set_position(tuple((offset / scale).tolist()))
        if label.arrow_patch is not None:
            label.arrow_patch.set_visible(distance >= _LINE_FROM)


def _cost(box: FloatArray, taken: list[FloatArray], points: FloatArray, frame: FloatArray) -> float:
    """What covering other labels, covering points and leaving the frame cost, in areas."""
    covered = sum(_overlap(box, other) for other in taken)
    inside = ((points > box[:2]) & (points < box[2:])).all(axis=1).sum()
    area = float(np.prod(box[2:] - box[:2]))
    return float(20.0 * covered + 0.5 * area * inside + 3.0 * (area - _overlap(box, frame)))


def _mistakable(box: FloatArray, own: FloatArray, anchors: FloatArray) -> float:
    """A share of the label's area where it stands nearer to another's anchor than to its own."""
    inside = np.clip(anchors, box[:2], box[2:])
    nearest = float(np.linalg.norm(anchors - inside, axis=1).min())
    own_distance = float(np.linalg.norm(own - np.clip(own, box[:2], box[2:])))
    return 0.3 * float(np.prod(box[2:] - box[:2])) if nearest < own_distance - 1e-6 else 0.0


def _overlap(a: FloatArray, b: FloatArray) -> float:
    sides = np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2])
    return float(np.prod(np.maximum(sides, 0.0)))
