"""An unwrapped ring is the panorama that was bent, and a ring outside the picture is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mht_slam.errors import ImageError, OptionError
from mht_slam.simulation.panorama import GREY, Body, View, cones_at, render_panorama, render_ring
from mht_slam.vision import PanoramaCamera, Ring, unwrap
from mht_slam.vision.unwrapping import row_radii

RING = Ring(150.4, 152.7, 60.0, 145.0)


def test_unwrapping_a_ring_gives_the_panorama_back() -> None:
    bodies = [*cones_at([[4, 1], [-3, 2]]), Body(2, -3, 1.5, 0.3, 0.3, GREY)]
    smooth = View(width=911, height=85, noise=0.0, grass=0.0, blur=1.0)
    camera = PanoramaCamera(ring=RING)
    ring = render_ring([0, 0, 0], bodies, np.random.default_rng(0), camera=camera, view=smooth)
    opened = unwrap(ring, RING, width=911)
    panorama = render_panorama([0, 0, 0], bodies, np.random.default_rng(0), view=smooth)
    assert opened.shape == panorama.shape
    # Outer and inner rows are blurred with the black around them.
    error = np.abs(opened - panorama)[4:-4]
    assert error.mean() < 0.01
    assert np.median(error) < 0.005


def test_columns_go_from_the_right_by_the_bottom() -> None:
    picture = np.zeros((300, 305, 3))
    for quarter, (row, column) in enumerate([(150, 250), (250, 152), (150, 55), (50, 152)]):
        picture[row - 4 : row + 5, column - 4 : column + 5, quarter % 3] = 0.25 * (quarter + 1)
    opened = unwrap(picture, Ring(150.0, 152.0, 60.0, 145.0), width=400)
    middle = int(np.argmin(np.abs(row_radii(Ring(150.0, 152.0, 60.0, 145.0)) - 99.0)))
    brightness = opened[middle].max(axis=1)
    assert brightness[[0, 100, 200, 300]] == pytest.approx([0.25, 0.5, 0.75, 1.0])


def test_the_outer_circle_is_the_top_row() -> None:
    radii = row_radii(RING)
    assert len(radii) == 85
    assert radii[0] == pytest.approx(144.5)
    assert radii[-1] == pytest.approx(60.5)


def test_a_width_left_alone_is_the_outer_circles_length() -> None:
    opened = unwrap(np.zeros((300, 305, 3)), RING)
    assert opened.shape == (85, math.ceil(2.0 * math.pi * 145.0), 3)


def test_a_ring_that_leaves_the_picture_is_refused() -> None:
    with pytest.raises(ImageError, match="leaves the picture"):
        unwrap(np.zeros((300, 250, 3)), RING)
    with pytest.raises(OptionError, match="centre_row is 150"):
        unwrap(np.zeros((100, 400, 3)), RING)
