"""Figures are drawn for every kind of run and hypothesis, legibly, and show what they claim."""

from __future__ import annotations

import io
import math
from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text

from mht_slam import (
    Association,
    BearingScan,
    Comparison,
    Hypothesis,
    StraightRun,
    compare,
    rank,
    refine,
)
from mht_slam.comparison import ComparisonRow
from mht_slam.errors import NoEstimateError
from mht_slam.plotting import (
    TrueLayout,
    cells_figure,
    comparison_figure,
    landmark_map_figure,
    run_map_figure,
)
from mht_slam.plotting.labels import place_labels
from mht_slam.simulation import Scene, simulate_pair, simulate_scene

EPSILON = math.radians(2.0)


def solved(scene: Scene) -> tuple[Figure, Figure, Figure]:
    """All three figures of a scene, its truth known to the figures."""
    # Labels leave one association, so that six landmarks need no enumeration.
    labelled = [
        BearingScan(scan.bearings, labels=[f"{row}" for row in rows])
        for scan, rows in zip(scene.scans, scene.truth.landmark_of_detection(), strict=True)
    ]
    run = StraightRun(labelled) if scene.motion == "straight" else scene.pair
    ranking = rank(run, epsilon=EPSILON, top_k=5, include_zero=True)
    listed = [h for h in ranking if h.association == scene.truth] or list(ranking[:1])
    posterior = refine(run, ranking, sigma=EPSILON / 2.0)
    hypothesis = next(h for h in posterior if h.association == listed[0].association)
    layout = TrueLayout(scene.poses, scene.landmarks, scene.truth)
    landmark_map = listed[0].map_in_landmark_frame
    assert landmark_map is not None
    return (
        cells_figure(run, epsilon=EPSILON, association=hypothesis.association, truth=layout),
        landmark_map_figure(landmark_map, hypothesis, truth=layout),
        comparison_figure(compare(ranking, posterior, scene.truth), scene.truth),
    )


def assert_legible(figure: Figure) -> None:
    """It renders, axes stand inside, and labels keep clear of one another."""
    FigureCanvasAgg(figure)
    picture = io.BytesIO()
    figure.savefig(picture, dpi=60)
    assert len(picture.getvalue()) > 5_000
    width, height = figure.bbox.width, figure.bbox.height
    for legend in figure.legends:
        x0, y0, x1, y1 = legend.get_window_extent().extents
        assert x0 >= -1.0 and y0 >= -1.0 and x1 <= width + 1.0 and y1 <= height + 1.0
    for axes in figure.axes:
        _, y0, _, y1 = axes.title.get_window_extent().extents
        assert y1 <= height + 1.0, "the title is cut off"
        labels = [text for text in axes.texts if isinstance(text, Annotation) and text.get_text()]
        boxes = [Text.get_window_extent(label).extents for label in labels]  # without lines
        for a, b in combinations(boxes, 2):
            sides = np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2])
            assert (sides <= 1.0).any(), "two labels overlap"


@pytest.mark.parametrize("n", [3, 4, 6])
def test_a_run_of_any_size_is_drawn(n: int) -> None:
    figures = solved(simulate_scene("annulus", n, np.random.default_rng(n), epsilon=EPSILON))
    for figure in figures:
        assert_legible(figure)
    for figure in figures[:2]:
        for axes in figure.axes:
            assert axes.get_aspect() == 1.0


def test_a_pair_of_runs_is_drawn() -> None:
    for figure in solved(simulate_pair("annulus", 3, np.random.default_rng(3), epsilon=EPSILON)):
        assert_legible(figure)


def near_parallel_run() -> tuple[StraightRun, Association]:
    """Landmarks 60 baselines away: cones of two degrees never close."""
    landmarks = np.array([[0.0, 60.0], [40.0, 60.0], [1.0, 2.0]])
    scans = [BearingScan(np.arctan2(landmarks[:, 1], landmarks[:, 0] - x)) for x in (0.0, 1.0, 2.0)]
    return StraightRun(scans), Association([[0, 0, 0], [1, 1, 1], [2, 2, 2]], (3, 3, 3))


def test_unbounded_cells_do_not_stretch_the_window() -> None:
    run, truth = near_parallel_run()
    figure = cells_figure(run, epsilon=EPSILON, association=truth)
    assert_legible(figure)
    for axes in figure.axes:
        assert np.ptp(axes.get_xlim()) < 60.0
        assert "reach beyond 100 baselines" in axes.get_title()


def test_without_a_hypothesis_the_cells_are_drawn_alone() -> None:
    run, _ = near_parallel_run()
    assert_legible(cells_figure(run, epsilon=EPSILON))


def test_scans_without_a_common_cell_are_drawn() -> None:
    run = StraightRun([BearingScan([1.0 - 0.2 * k, 2.0 - 0.2 * k]) for k in range(3)])
    assert_legible(cells_figure(run, epsilon=math.radians(0.1)))


def row(score: float, evidence: float, rank_: int, table: list[list[int]]) -> ComparisonRow:
    association = Association(table, (3, 3, 3))
    return ComparisonRow(association, score, rank_, evidence, evidence, rank_, 0.0)


def test_hopeless_hypotheses_stand_on_the_floor_and_are_counted() -> None:
    keep = [[0, 0, 0], [1, 1, 1], [2, 2, 2]]
    swaps = [[[0, 0, 1], [1, 1, 0], [2, 2, 2]], [[0, 0, 0], [1, 1, 2], [2, 2, 1]]]
    rows = (row(0.5, -10.0, 1, keep), row(0.4, -5000.0, 2, swaps[0]))
    rows = (*rows, row(0.3, -math.inf, 3, swaps[1]))
    comparison = Comparison(rows, None, True, None, None)
    figure = comparison_figure(comparison)
    assert_legible(figure)
    low, high = figure.axes[0].get_ylim()
    assert -40.0 < low < high
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert any("2 more than 30 nats below, 1 of them without" in text for text in texts)


def test_a_truth_on_the_floor_is_still_marked() -> None:
    tables = [[[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 0, 1], [1, 1, 0], [2, 2, 2]]]
    rows = (row(0.5, -10.0, 1, tables[0]), row(0.4, -5000.0, 2, tables[1]))
    figure = comparison_figure(Comparison(rows, None, True, 2, 2), Association(tables[1], (3,) * 3))
    assert_legible(figure)
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "truth" in texts
    assert any("1 more than 30 nats below" in text for text in texts)


def test_hypotheses_that_all_failed_are_counted() -> None:
    rows = (row(0.5, -math.inf, 1, [[0, 0, 0], [1, 1, 1], [2, 2, 2]]),)
    figure = comparison_figure(Comparison(rows, None, False, None, None))
    assert_legible(figure)
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert any("1 of them without an estimate" in text for text in texts)


def test_nothing_to_compare_is_said() -> None:
    figure = comparison_figure(Comparison((), None, False, None, None))
    assert "no hypothesis" in figure.axes[0].texts[0].get_text()


def test_labels_of_crowded_points_keep_apart() -> None:
    figure = Figure(figsize=(6.0, 6.0))
    axes = figure.subplots()
    points = np.array([[0.5, 0.5], [0.51, 0.5], [0.5, 0.51], [0.52, 0.52], [0.02, 0.98]])
    place_labels(axes, points, [f"landmark {k}" for k in range(5)])
    assert_legible(figure)


def test_the_map_of_a_run_shows_landmarks_with_a_range_and_counts_those_outside() -> None:
    scene = simulate_scene("annulus", 4, np.random.default_rng(2), epsilon=EPSILON, n_scans=5)
    hypothesis = refine(scene.run, [scene.truth], sigma=EPSILON / 2.0, evidence="laplace")[0]
    figure = run_map_figure(hypothesis)
    assert_legible(figure)
    (axes,) = figure.axes
    assert "5 scans, 4 landmarks" in axes.get_title()
    assert len(axes.patches) == 4, "one ellipse each"
    table = scene.truth.table.copy()
    table[0, 1:] = -1
    seen_once = refine(
        scene.run, [Association(table, scene.truth.n_detections)], sigma=EPSILON / 2.0
    )[0]
    assert len(run_map_figure(seen_once).axes[0].patches) == 3, "its range is the prior's"


def test_a_hypothesis_without_an_estimate_has_no_map() -> None:
    scene = simulate_scene("annulus", 3, np.random.default_rng(2), epsilon=EPSILON)
    failed = Hypothesis(scene.truth, None, -math.inf, -math.inf, 0.0, failure="none")
    with pytest.raises(NoEstimateError, match="no estimate"):
        run_map_figure(failed)
