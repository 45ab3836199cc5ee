"""The overlay shows every cone of the scan, enlarged, with what is doubtful about it."""

from __future__ import annotations

import numpy as np

from mht_slam.plotting.detections import DOUBTFUL, MOST_CUTOUTS, WHOLE, detections_figure
from mht_slam.simulation.panorama import cones_at, render_panorama
from mht_slam.vision import DetectionOptions, PanoramaDetections, detect_cones


def seen(places: list[list[float]]) -> PanoramaDetections:
    picture = render_panorama([0, 0, 0], cones_at(places), np.random.default_rng(0))
    return detect_cones(picture, options=DetectionOptions(allow_none=True))


def test_each_cone_is_numbered_and_enlarged() -> None:
    found = seen([[4.0, 3.0], [5.0, 0.0], [-3.0, 2.0]])
    figure = detections_figure(found, "picture.png")
    figure.canvas.draw()
    whole, *cutouts = figure.axes
    assert whole.get_title() == "picture.png: 3 cones"
    assert [text.get_text() for text in whole.texts] == ["0", "1", "2"]
    for index, axes in enumerate(cutouts):
        assert axes.get_title().startswith(f"{index}: {np.degrees(found.bearings[index]):.2f} ")
        (line,) = axes.lines
        low, high = axes.get_xlim()
        assert line.get_xdata()[0] == found.columns[index]
        assert low < found.columns[index] < high


def test_doubtful_cones_stand_out_and_say_why() -> None:
    found = seen([[5.0, 0.0], [5.3, 0.3], [-4.0, 0.0]])
    assert found.touching.sum() == 2
    figure = detections_figure(found)
    for index, axes in enumerate(figure.axes[1:]):
        assert axes.get_xlabel().startswith("touching" if found.touching[index] else "")
    colours = [text.get_bbox_patch().get_facecolor() for text in figure.axes[0].texts]
    assert len(set(colours)) == 2
    assert WHOLE != DOUBTFUL


def test_many_cones_and_none_are_drawn() -> None:
    circle = [[5.0 * np.cos(k), 5.0 * np.sin(k)] for k in np.arange(14) * 0.44]
    figure = detections_figure(seen(circle))
    assert "the first 12 enlarged" in figure.axes[0].get_title()
    assert len(figure.axes) == 1 + MOST_CUTOUTS
    assert detections_figure(seen([])).axes[0].get_title() == "0 cones"
