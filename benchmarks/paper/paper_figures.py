"""The method in pictures on one experiment: layout, cells, hypotheses, F_L, zones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from paper_measure import (
    GRAPH,
    PAPER,
    Experiment,
    base_detections,
    experiment_scene,
    landmark_rows,
    model_of,
)

import mht_slam as ms
from mht_slam.arrays import FloatArray
from mht_slam.plotting import (
    TrueLayout,
    cells_figure,
    landmark_map_figure,
    order_changes_figure,
)
from mht_slam.plotting.frames import between
from mht_slam.plotting.labels import place_labels
from mht_slam.plotting.style import (
    CHOSEN_TONE,
    CONE_TONE,
    INK,
    TRUTH_TONE,
    draw_shape,
    set_window,
)
from mht_slam.plotting.zones import ZONE_TONES
from mht_slam.polygon.cones import cells, cones
from mht_slam.simulation import Scene
from mht_slam.simulation.paper_scene import (
    LANDMARKS,
    LAWNMOWER_TRACK,
    OBSERVATION_POINTS,
    SEEN,
    SENSOR_RANGE,
)

EPSILON_DEG, LARGE_EPSILON_DEG = 2.0, 5.0
"""Of the experiments that are drawn; the larger one only where hypotheses are compared."""
ZONE_GRID = 200
MAX_RANGE = 100.0
POINTS = ("O1", "O2", "O3")

Order = tuple[str, ...]
"""Whose detection a scan gives to Lc, Ld and Le as O2 sees them; the truth is `SEEN`."""


@dataclass(frozen=True)
class Example:
    """One experiment with all its 36 hypotheses ranked."""

    scene: Scene
    epsilon: float
    ranking: ms.Ranking

    @property
    def layout(self) -> TrueLayout:
        """Where everything was."""
        return TrueLayout(self.scene.poses, self.scene.landmarks, self.scene.truth)

    def orders(self, association: ms.Association) -> tuple[Order, Order]:
        """What a hypothesis makes of the detections of O1 and of O3."""
        names = {row: name for name, row in landmark_rows(self.scene).items()}
        of_detection = [
            {int(detection): names[row] for row, detection in enumerate(column)}
            for column in self.scene.truth.table.T
        ]
        table = {of_detection[1][int(row[1])]: row for row in association.table}
        first, third = (
            tuple(of_detection[scan][int(table[name][scan])] for name in SEEN) for scan in (0, 2)
        )
        return first, third


def draw_method(seed: int) -> dict[str, Figure]:
    """Draw every figure of the method; keys name the files."""
    example = example_of(seed)
    seen = np.array([LANDMARKS[name] for name in SEEN])
    return {
        "layout": layout_figure(),
        "cells": cells_figure(
            example.scene.run,
            epsilon=example.epsilon,
            max_range=MAX_RANGE,
            association=example.scene.truth,
            truth=example.layout,
        ),
        "hypotheses": hypotheses_figure(example),
        "ratios": ratios_figure([example, example_of(seed, LARGE_EPSILON_DEG)]),
        "landmark_frame": _landmark_frame_figure(example),
        "zones": zones_on_track_figure(seen),
    }


def example_of(seed: int, epsilon_deg: float = EPSILON_DEG) -> Example:
    """Rank all hypotheses of the first experiment."""
    experiment = Experiment(PAPER, epsilon_deg, 0, seed)
    scene = experiment_scene(experiment)
    ranking = ms.rank(
        scene.run,
        epsilon=experiment.epsilon,
        method="exhaustive",
        top_k=None,
        base=base_detections(scene),
        max_range=MAX_RANGE,
        include_zero=True,
    )
    return Example(scene, experiment.epsilon, ranking)


def layout_figure() -> Figure:
    """Draw the lawnmower run, the five landmarks and what is in view of O1 to O3, in metres."""
    figure = Figure(figsize=(8.0, 6.2), layout="constrained")
    axes = figure.subplots()
    axes.plot(*LAWNMOWER_TRACK.T, "-", color="0.6", linewidth=1.2)
    for point in OBSERVATION_POINTS:
        circle = Circle(tuple(point.tolist()), SENSOR_RANGE, fill=False, color="0.8", linestyle=":")
        axes.add_patch(circle)
    places = np.array(list(LANDMARKS.values()))
    in_view = np.array([name in SEEN for name in LANDMARKS])
    axes.plot(*places[in_view].T, "*", color=TRUTH_TONE, markersize=13, markeredgecolor=INK)
    axes.plot(*places[~in_view].T, "*", color="white", markersize=13, markeredgecolor=INK)
    axes.plot(*OBSERVATION_POINTS.T, "o", color=INK)
    axes.set_xlabel("along the last leg, metres")
    axes.set_ylabel("left of it, metres")
    axes.set_aspect("equal")
    first, second = np.diff(OBSERVATION_POINTS[:, 0])
    axes.set_title(
        f"The run: {len(SEEN)} of {len(LANDMARKS)} landmarks in view of O1 to O3 (dotted: "
        f"{SENSOR_RANGE:g} m)\n|O1 O2| = {first:g} m, |O2 O3| = {second:g} m",
        fontsize=10,
    )
    place_labels(axes, np.vstack([places, OBSERVATION_POINTS]), [*LANDMARKS, *POINTS])
    return figure


def hypotheses_figure(example: Example) -> Figure:
    """Draw all n! hypotheses of both pairs: one cell a landmark, every cone used once."""
    orders = list(permutations(SEEN))
    figure = Figure(figsize=(13.0, 7.0), layout="constrained")
    panels = figure.subplots(2, len(orders), sharex="row", sharey="row")
    for row, columns in enumerate(((0, 1), (1, 2))):
        for axes, order in zip(panels[row], orders, strict=True):
            _draw_hypothesis(axes, example, columns, order)
            axes.tick_params(labelsize=7)
        a, b = (POINTS[column] for column in columns)
        panels[row, 0].set_ylabel(f"pair ({a}, {b})\nbaselines |{a} {b}|", fontsize=9)
    figure.supxlabel("along the run, baselines", fontsize=9)
    figure.suptitle(
        f"The {len(orders)} hypotheses of each pair at ±{EPSILON_DEG:g}°: cells (blue) for Lc, Ld "
        "and Le of O2, and whose detections the other scan gives them.\nOnly the first column is "
        "right; stars are the true landmarks.",
        fontsize=10,
    )
    return figure


def ratios_figure(examples: Sequence[Example]) -> Figure:
    """Draw the intersection ratio of every pair of hypotheses, one panel an experiment."""
    figure = Figure(figsize=(6.2 * len(examples) + 0.6, 6.2), layout="constrained")
    panels = figure.subplots(1, len(examples), sharey=True, squeeze=False)[0]
    for axes, example in zip(panels, examples, strict=True):
        _draw_ratios(axes, example)
    panels[0].set_ylabel("pair (O1, O2): whose detections O1 gives them")
    figure.suptitle(
        "Intersection ratios of all pairs of hypotheses; blank is zero, the true pair is framed",
        fontsize=11,
    )
    return figure


def zones_on_track_figure(seen: FloatArray) -> Figure:
    """Draw the zones of the landmarks in view, and where the track changes their order."""
    figure = order_changes_figure(OBSERVATION_POINTS, seen)
    axes = figure.axes[0]
    (x_low, x_high), (y_low, y_high) = axes.get_xlim(), axes.get_ylim()
    # Half a cell off the edges, the grid meets no landmark.
    x, y = (
        np.linspace(low, high, ZONE_GRID + 1)[:-1] + 0.5 * (high - low) / ZONE_GRID
        for low, high in ((x_low, x_high), (y_low, y_high))
    )
    letters = list(ZONE_TONES)
    zones = [[letters.index(ms.zone((a, b), seen)) for a in x] for b in y]
    axes.imshow(
        zones,
        extent=(x_low, x_high, y_low, y_high),
        origin="lower",
        cmap=ListedColormap(list(ZONE_TONES.values())),
        zorder=0,
    )
    axes.plot(*OBSERVATION_POINTS.T, "o", color=INK, zorder=6)
    in_zones = [
        f"{name} in {ms.zone(point, seen)}"
        for name, point in zip(POINTS, OBSERVATION_POINTS, strict=True)
    ]
    place_labels(axes, OBSERVATION_POINTS, in_zones, avoid=seen)
    axes.annotate("A", seen.mean(axis=0), ha="center", va="center", zorder=6)
    changes = [
        f"{' and '.join(SEEN[i] for i in change.pair)} swap {change.point[0]:.1f} m past O1"
        for change in ms.order_changes(OBSERVATION_POINTS, seen)
    ]
    key = ", ".join(f"{k} is {name}" for k, name in enumerate(SEEN))
    axes.set_title(
        f"{'; '.join(changes)} ({key}).\nZones: A inside; B (shaded) outside, with the visual "
        "order of A; C (white) with another",
        fontsize=10,
    )
    axes.set_xlabel("along the last leg, metres")
    axes.set_ylabel("left of it, metres")
    return figure


def _draw_ratios(axes: Axes, example: Example) -> None:
    orders = list(permutations(SEEN))
    table = np.zeros((len(orders), len(orders)))
    for hypothesis in example.ranking:
        first, third = example.orders(hypothesis.association)
        table[orders.index(first), orders.index(third)] = hypothesis.score
    axes.imshow(table, cmap="Greys", vmin=0.0, vmax=2.0 * float(table.max()))
    for i, j in np.ndindex(table.shape):
        if table[i, j] > 0.0:
            axes.text(j, i, f"{table[i, j]:.3f}", ha="center", va="center", fontsize=9)
    axes.add_patch(Rectangle((-0.5, -0.5), 1, 1, fill=False, edgecolor=TRUTH_TONE, linewidth=3))
    names = [" ".join(order) for order in orders]
    axes.set_xticks(range(len(orders)), names, rotation=45, ha="right")
    axes.set_yticks(range(len(orders)), names)
    axes.set_xlabel("pair (O2, O3): whose detections O3 gives to Lc, Ld, Le of O2")
    above = int((table > table[0, 0]).sum())
    where = "the greatest" if above == 0 else f"exceeded by {above}"
    axes.set_title(
        f"±{math.degrees(example.epsilon):g}°: {int((table > 0.0).sum())} of {table.size} "
        f"positive, the true one is {where}",
        fontsize=10,
    )


def _draw_hypothesis(axes: Axes, example: Example, columns: tuple[int, int], order: Order) -> None:
    """One pair of scans with the cells of one hypothesis, in the pair's F_R."""
    scene, rows = example.scene, landmark_rows(example.scene)
    bearings = [scene.scans[column].bearings for column in columns]
    for apex, seen in zip((0.0, 1.0), bearings, strict=True):
        for cone in cones(seen, apex, epsilon=example.epsilon, max_range=MAX_RANGE):
            draw_shape(axes, cone, facecolor=CONE_TONE, edgecolor="none", alpha=0.6)
    all_cells = cells(*bearings, epsilon=example.epsilon, max_range=MAX_RANGE)
    drawn = []
    for name, other in zip(SEEN, order, strict=True):
        # O2, the second scan of one pair and the first of the other, names the landmarks.
        owners = [name if column == 1 else other for column in columns]
        cell = tuple(
            int(scene.truth.table[rows[owner], column])
            for owner, column in zip(owners, columns, strict=True)
        )
        drawn.append(all_cells.polygons[cell])
        draw_shape(axes, drawn[-1], facecolor=CHOSEN_TONE, edgecolor=INK, zorder=3)
    ends = scene.poses[list(columns), :2]
    points = between(scene.landmarks, ends[0], ends[1])
    path = np.array([[0.0, 0.0], [1.0, 0.0]])
    axes.plot(*path.T, "o-", color=INK, markersize=4, zorder=4)
    axes.plot(*points.T, "*", color=TRUTH_TONE, markersize=7, markeredgecolor=INK, zorder=5)
    set_window(axes, np.vstack([path, points]), [], reach=0.0)
    _widen(axes, points)
    (x_low, x_high), (y_low, y_high) = axes.get_xlim(), axes.get_ylim()
    window = shapely.box(x_low, y_low, x_high, y_high)
    n_empty = sum(bool(polygon.is_empty) for polygon in drawn)
    n_seen = sum(bool(shapely.intersects(polygon, window)) for polygon in drawn)
    counts = {"without a cell": n_empty, "beyond the view": len(drawn) - n_empty - n_seen}
    notes = [f"{count} {what}" for what, count in counts.items() if count]
    axes.set_title("\n".join([" ".join(order), ", ".join(notes)]), fontsize=8)


def _widen(axes: Axes, points: FloatArray) -> None:
    """Room above the landmarks, where wrong cells lie."""
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.5 * float(np.ptp(points[:, 1])))


def _landmark_frame_figure(example: Example) -> Figure:
    """Both pairs' regions of the true hypothesis, and the graph's estimate over them."""
    true = next(h for h in example.ranking if h.association.exact(example.scene.truth))
    drawn = true.map_in_landmark_frame
    if drawn is None:
        raise RuntimeError("the true base cells meet: there is no F_L")
    posterior = ms.refine(
        example.scene.run, example.ranking, model=model_of(GRAPH, example.epsilon)
    )
    solved = next(h for h in posterior if h.association.exact(example.scene.truth))
    return landmark_map_figure(drawn, solved, truth=example.layout)
