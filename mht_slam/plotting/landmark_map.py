"""Figure (b): one hypothesis in F_L, regions of both pairs under the graph's ellipses."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from mht_slam.arrays import FloatArray
from mht_slam.association import MISSED, Association
from mht_slam.hypotheses import Hypothesis, LandmarkFrameMap, MapRegion
from mht_slam.plotting.frames import (
    LandmarkFrameEstimate,
    TrueLayout,
    between,
    estimate_in_landmark_frame,
    true_base,
)
from mht_slam.plotting.labels import place_labels
from mht_slam.plotting.style import (
    ELLIPSE_COVERAGE,
    INK,
    SHARED_TONE,
    TRUTH_TONE,
    draw_ellipse,
    draw_shape,
    ellipse_bounds,
    in_window,
    set_window,
)

PAIR_STYLES: tuple[dict[str, Any], ...] = (
    {"edgecolor": "#1f4e8c", "linestyle": "-", "hatch": "///"},
    {"edgecolor": "#c8701a", "linestyle": "--", "hatch": "..."},
    {"edgecolor": "#3d7a3d", "linestyle": ":", "hatch": "xx"},
)
"""Line, hatch and colour of each pair, in the order of the map's pairs."""


def landmark_map_figure(
    landmark_map: LandmarkFrameMap,
    hypothesis: Hypothesis,
    *,
    truth: TrueLayout | None = None,
) -> Figure:
    """Draw the map of one hypothesis in F_L.

    Regions of landmarks (hatched) and of observation points from every pair, what they share, and
    over them the ellipses that hold 95 % of the factor graph's estimate in the same frame (see
    `estimate_in_landmark_frame`; drawn only where the hypothesis was solved). The two base
    landmarks are certain by definition of the frame. Axes are in units of their distance.

    `landmark_map` and `hypothesis` must be of the same association. With `truth` the true places
    are marked, unless a base detection is really a false alarm.

    Source: the paper's section 3, Fig. 6; docs/method.md, section 3.
    """
    figure = Figure(figsize=(9.0, 8.6), layout="constrained")
    axes = figure.subplots()
    estimate = None
    if hypothesis.poses is not None:
        estimate = estimate_in_landmark_frame(hypothesis, landmark_map.base)
    true_points = _true_points(truth, hypothesis.association, landmark_map.base)
    regions = (*landmark_map.landmarks, *landmark_map.observation_points)
    places = _places(regions, estimate)
    _set_window(axes, regions, places, estimate, true_points)
    pairs = _pairs(regions)
    for region in regions:
        is_landmark = region in landmark_map.landmarks
        if len(region.by_pair) > 1:
            draw_shape(axes, region.intersection, facecolor=SHARED_TONE, edgecolor="none", zorder=1)
        for scans, shape in region.by_pair:
            style = dict(PAIR_STYLES[pairs.index(scans) % len(PAIR_STYLES)])
            if not is_landmark:
                del style["hatch"]
            draw_shape(axes, shape, fill=False, linewidth=1.4, zorder=2, **style)
    if estimate is not None:
        _draw_estimate(axes, estimate, landmark_map.base)
    axes.plot([0.0, 1.0], [0.0, 0.0], "s", color=INK, markersize=7, zorder=6)
    axes.plot(*true_points.T, "*", color=TRUTH_TONE, markersize=10, markeredgecolor=INK, zorder=7)
    base_names = [f"landmark {row}" for row in landmark_map.base]
    names = [f"{r.name} (base)" if r.name in base_names else r.name for r in regions]
    axes.set_xlabel("along the base, |base landmarks| = 1")
    axes.set_ylabel("left of the base, |base landmarks| = 1")
    axes.set_title(_title(landmark_map, hypothesis))
    figure.legend(
        handles=_legend(pairs, estimate is not None, len(true_points) > 0),
        loc="outside lower center",
        ncols=3,
        fontsize=9,
        frameon=False,
    )
    shown = in_window(axes, places)
    place_labels(axes, places[shown], [names[i] for i in shown], avoid=true_points)
    return figure


def _true_points(
    truth: TrueLayout | None, association: Association, base: tuple[int, int]
) -> FloatArray:
    """True landmarks and observation points in the F_L of the base detections, or none."""
    if truth is None:
        return np.empty((0, 2))
    first, second = true_base(truth, association, base)
    if MISSED in (first, second) or first == second:
        return np.empty((0, 2))
    points = np.vstack([truth.landmarks, truth.poses[:, :2]])
    return between(points, truth.landmarks[first], truth.landmarks[second])


def _places(regions: tuple[MapRegion, ...], estimate: LandmarkFrameEstimate | None) -> FloatArray:
    """(k, 2) where each region's label belongs: its shared part, else its first pair's."""
    places = []
    for region in regions:
        shape = region.intersection
        if shape.is_empty:
            shape = next((s for _, s in region.by_pair if not s.is_empty), shapely.Point(0.5, 0.0))
        places.append(shapely.get_coordinates(shapely.centroid(shape))[0])
    result = np.array(places)
    if estimate is not None:
        by_name = {f"landmark {row}": xy for row, xy in enumerate(estimate.landmarks)}
        by_name |= {f"O{k + 1}": xy for k, xy in enumerate(estimate.points)}
        for i, region in enumerate(regions):
            result[i] = by_name[region.name]
    return result


def _set_window(
    axes: Axes,
    regions: tuple[MapRegion, ...],
    places: FloatArray,
    estimate: LandmarkFrameEstimate | None,
    true_points: FloatArray,
) -> None:
    wanted = [shapely.bounds(region.intersection) for region in regions]
    if estimate is not None:
        wanted += [
            np.array(ellipse_bounds(centre, covariance))
            for centre, covariance in (
                *zip(estimate.landmarks, estimate.landmark_covariances, strict=True),
                *zip(estimate.points, estimate.point_covariances, strict=True),
            )
        ]
    set_window(axes, np.vstack([places, true_points]), wanted, reach=0.5)


def _pairs(regions: tuple[MapRegion, ...]) -> list[tuple[int, int]]:
    pairs: list[tuple[int, int]] = []
    for region in regions:
        pairs += [scans for scans, _ in region.by_pair if scans not in pairs]
    return pairs


def _draw_estimate(axes: Axes, estimate: LandmarkFrameEstimate, base: tuple[int, int]) -> None:
    style = {"fill": False, "edgecolor": INK, "linewidth": 1.8, "zorder": 5}
    for row, (centre, covariance) in enumerate(
        zip(estimate.landmarks, estimate.landmark_covariances, strict=True)
    ):
        if row in base:
            continue
        draw_ellipse(axes, centre, covariance, **style)
        axes.plot(*centre, "+", color=INK, markersize=9, markeredgewidth=1.6, zorder=6)
    for centre, covariance in zip(estimate.points, estimate.point_covariances, strict=True):
        draw_ellipse(axes, centre, covariance, **style)
        axes.plot(*centre, "o", color=INK, markersize=5, zorder=6)


def _title(landmark_map: LandmarkFrameMap, hypothesis: Hypothesis) -> str:
    score = "" if hypothesis.score is None else f"polygon score {hypothesis.score:.3f}, "
    lines = [f"Hypothesis in F_L: {score}probability {hypothesis.probability:.3f}"]
    if landmark_map.cut:
        lines.append("some of its cells are unbounded and were cut")
    if hypothesis.failure is not None:
        lines.append(f"no graph estimate: {hypothesis.failure}")
    return "\n".join(lines)


def _legend(
    pairs: list[tuple[int, int]], has_estimate: bool, has_truth: bool
) -> list[Patch | Line2D]:
    handles: list[Patch | Line2D] = [
        Patch(fill=False, label=f"from scans {a} and {b} (hatched: landmarks)", **style)
        for (a, b), style in zip(pairs, PAIR_STYLES, strict=False)
    ]
    handles.append(Patch(facecolor=SHARED_TONE, label="shared by both pairs"))
    handles.append(Line2D([], [], color=INK, marker="s", linestyle="none", label="base landmarks"))
    if has_estimate:
        handles.append(
            Patch(
                fill=False,
                edgecolor=INK,
                linewidth=1.8,
                label=f"factor graph, {ELLIPSE_COVERAGE:.0%}",
            )
        )
    if has_truth:
        handles.append(
            Line2D(
                [], [], color=TRUTH_TONE, marker="*", markersize=10, markeredgecolor=INK,
                linestyle="none", label="truth",
            )
        )  # fmt: skip
    return handles
