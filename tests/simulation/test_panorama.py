"""Rendered pictures show each body where its bearing says, nearer before farther."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mht_slam.arrays import FloatArray
from mht_slam.errors import OptionError
from mht_slam.simulation.panorama import (
    GREY,
    Body,
    View,
    cones_at,
    render_panorama,
    render_ring,
)
from mht_slam.vision.camera import PanoramaCamera, Ring

PLAIN = View(blur=0.0, noise=0.0, grass=0.0, shading=0.0)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def difference(bodies: list[Body], view: View = PLAIN, **options: PanoramaCamera) -> FloatArray:
    """How much of each column the bodies change, against the empty world."""
    pictures = [
        render_panorama([0, 0, 0], some, rng(), view=view, **options) for some in (bodies, [])
    ]
    return np.abs(pictures[0] - pictures[1]).sum(axis=(0, 2))


@pytest.mark.parametrize("fraction", [0.0, 0.13, 0.37, 0.5, 0.88])
def test_a_cone_is_centred_on_its_bearing_to_a_hundredth_of_a_pixel(fraction: float) -> None:
    bearing = -math.radians(0.25 * (200.0 + fraction))
    cone = cones_at([[6.0 * math.cos(bearing), 6.0 * math.sin(bearing)]])
    # Grass and sky of equal brightness along a row, so the change has the shape of the cone.
    profile = difference(cone)
    centroid = profile @ np.arange(1440) / profile.sum()
    assert centroid == pytest.approx(200.0 + fraction, abs=0.01)


def test_the_width_of_a_post_is_that_of_the_angle_it_fills() -> None:
    radius, distance = 0.5, 4.0
    post = Body(distance, 0.0, 10.0, radius, radius, GREY)
    picture = render_panorama([0, 0, 0], [post], rng(), view=PLAIN)
    covered = np.abs(picture[0] - picture[0, 720]).sum(axis=1)
    width = covered.sum() / covered.max()
    assert width == pytest.approx(1440 * 2 * math.asin(radius / distance) / (2 * math.pi), abs=0.01)


def test_a_body_across_the_seam_is_whole() -> None:
    profile = difference(cones_at([[6.0, 0.0]]))
    assert profile[1:20] == pytest.approx(profile[-1:-20:-1])
    assert profile[1] > 0.0


@pytest.mark.parametrize("order", [1, -1])
def test_nearer_bodies_hide_farther_ones_whatever_their_order(order: int) -> None:
    post = Body(3.0, 0.0, 5.0, 0.5, 0.5, GREY)
    both = [post, *cones_at([[6.0, 0.0]])][::order]
    assert np.array_equal(
        render_panorama([0, 0, 0], both, rng()), render_panorama([0, 0, 0], [post], rng())
    )


def test_the_camera_turns_with_the_robot_and_stands_at_its_offset() -> None:
    camera = PanoramaCamera(offset=(1.0, 0.5))
    turned = render_panorama([2.0, 1.0, math.pi / 2], cones_at([[3.0, 8.0]]), rng(), camera=camera)
    # The camera is at (1.5, 2), so the cone is 6 before it and 1.5 to the right.
    straight = render_panorama([0, 0, 0], cones_at([[6.0, -1.5]]), rng())
    assert turned == pytest.approx(straight, abs=1e-9)


def test_the_same_seed_draws_the_same_picture() -> None:
    pictures = [render_panorama([0, 0, 0], cones_at([[5, 1]]), rng()) for _ in range(2)]
    assert np.array_equal(*pictures)
    assert pictures[0].min() >= 0.0
    assert pictures[0].max() <= 1.0


def test_the_ring_shows_a_body_at_its_angle_and_black_around() -> None:
    ring = Ring(120.0, 130.0, 40.0, 115.0)
    post = Body(0.0, -3.0, 10.0, 0.3, 0.3, (1.0, 0.0, 0.0))  # on the right: a quarter turn on
    picture = render_ring([0, 0, 0], [post], rng(), camera=PanoramaCamera(ring=ring), view=PLAIN)
    assert not picture[0, 0].any()
    assert not picture[120, 130].any()
    red = picture[:, :, 0] - picture[:, :, 1] > 0.8
    rows, columns = np.nonzero(red)
    assert rows.min() > 160, "below the centre"
    assert columns.mean() == pytest.approx(130.0, abs=0.05)


def test_what_cannot_be_drawn_is_refused() -> None:
    with pytest.raises(OptionError, match="inside the body"):
        render_panorama([0, 0, 0], cones_at([[0.1, 0.0]]), rng())
    with pytest.raises(OptionError, match="ring is None"):
        render_ring([0, 0, 0], [], rng(), camera=PanoramaCamera())
    with pytest.raises(OptionError, match="top_radius"):
        Body(1.0, 2.0, top_radius=1.0)
    with pytest.raises(OptionError, match="body colour"):
        Body(1.0, 2.0, colour=(1.0, 0.5))  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="highest"):
        View(highest=-1.0)
    with pytest.raises(OptionError, match=r"\(n, 2\)"):
        cones_at([1.0, 2.0])
