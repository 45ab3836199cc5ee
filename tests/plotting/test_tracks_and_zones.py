"""Figures of zones, order changes and tracks show what geometry and tracks say."""

from __future__ import annotations

import io

import numpy as np
import pytest
import shapely
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from mht_slam.association import Association
from mht_slam.errors import AssociationError, OptionError, TooFewLandmarksError
from mht_slam.measurements import BearingScan
from mht_slam.plotting import order_changes_figure, tracks_figure, zones_figure
from mht_slam.plotting.style import TRUTH_TONE
from mht_slam.plotting.zones import ZONE_TONES
from mht_slam.tracking.zones import zone

PENTAGON = [(0.0, 0.0), (4.0, -0.5), (5.0, 3.0), (2.0, 4.5), (-1.0, 2.5)]
ALL_AROUND = [(-4.0, -3.0), (4.0, -3.0), (4.0, 5.0), (0.0, 5.4), (-4.0, 5.0), (0.0, 2.0)]


def drawn(figure: Figure) -> None:
    FigureCanvasAgg(figure).print_png(io.BytesIO())


def zone_shown(figure: Figure, point: np.ndarray) -> str:
    """Name of the tone of the patch that a point lies in."""
    shown = "C"
    for patch in figure.axes[0].patches:
        if shapely.Polygon(patch.get_xy()).contains(shapely.Point(point)):
            shown = next(
                name for name, tone in ZONE_TONES.items() if to_rgba(tone) == patch.get_facecolor()
            )
    return shown


def test_every_place_has_the_tone_of_its_zone() -> None:
    figure = zones_figure(PENTAGON)
    drawn(figure)
    axes, rng = figure.axes[0], np.random.default_rng(0)
    low, high = np.array([axes.get_xlim(), axes.get_ylim()]).T
    places = rng.uniform(low, high, (300, 2))
    shown = [zone_shown(figure, place) for place in places]
    assert shown == [zone(place, PENTAGON) for place in places]
    assert set(shown) == {"A", "B", "C"}


def test_layouts_without_zones_are_refused() -> None:
    with pytest.raises(OptionError, match="convex position"):
        zones_figure(ALL_AROUND)
    with pytest.raises(TooFewLandmarksError, match="landmarks has 2"):
        zones_figure(PENTAGON[:2])


def test_changes_that_the_paper_rule_misses_are_hollow() -> None:
    figure = order_changes_figure([(-7.5, -2.5), (-2.0, -1.2), (2.5, 0.8), (7, 6.5)], ALL_AROUND)
    drawn(figure)
    rings = [line for line in figure.axes[0].lines if line.get_markeredgecolor() == TRUTH_TONE]
    fillings = {line.get_markerfacecolor() for line in rings}
    assert fillings == {TRUTH_TONE, "white"}
    hollow = [line for line in rings if line.get_markerfacecolor() == "white"]
    assert len(hollow) == 2
    assert f"{len(rings)} changes" in figure.axes[0].get_title()
    drawn(order_changes_figure([(0.0, 0.0), (0.1, 0.1)], PENTAGON[1:]))
    with pytest.raises(OptionError, match="path has 1"):
        order_changes_figure([(0.0, 0.0)], ALL_AROUND)


def test_tracks_are_drawn_apart_over_gaps_and_the_seam() -> None:
    bearings = [[3.0, 0.1, 0.3], [3.1, 0.2, 0.25], [-3.1, 0.3, 0.2], [-3.0, 1.5], [-2.9, 0.4, 0.1]]
    scans = [BearingScan(scan) for scan in bearings]
    association = Association(
        [[0, 0, 0, 0, 0], [1, 1, 1, -1, 1], [2, 2, 2, -1, 2]], [len(scan) for scan in scans]
    )
    figure = tracks_figure(scans, association)
    drawn(figure)
    axes = figure.axes[0]
    assert axes.get_title() == "3 tracks through 5 scans; exchanges of places: 1"
    for line in axes.lines:
        steps = np.abs(np.diff(np.asarray(line.get_ydata(), dtype=float)))
        if line.get_linestyle() in ("-", ":"):
            assert np.nanmax(steps, initial=0.0) < 180.0
    dotted = [line for line in axes.lines if line.get_linestyle() == ":"]
    assert sum(np.isfinite(np.asarray(line.get_xdata())).sum() for line in dotted) == 2 * 2
    (crosses,) = [line for line in axes.lines if line.get_marker() == "x"]
    assert crosses.get_xdata().tolist() == [3]


def test_a_run_without_tracks_is_drawn_too() -> None:
    drawn(tracks_figure([BearingScan([0.1]), BearingScan([])], Association([], (1, 0))))
    with pytest.raises(AssociationError, match="these scans"):
        tracks_figure([BearingScan([0.1])], Association([], (2,)))
