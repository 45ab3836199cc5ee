"""A ring opened into a panorama: columns are bearings, rows are radii."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

from mht_slam.arrays import FloatArray, whole_number
from mht_slam.errors import ImageError, OptionError
from mht_slam.vision.camera import Ring
from mht_slam.vision.images import MIN_SIDE, colour_image


def unwrap(image: npt.ArrayLike, ring: Ring, *, width: int | None = None) -> FloatArray:
    """Open the ring of a catadioptric picture.

    Parameters
    ----------
    image : (rows, columns, 3), see `colour_image`.
    width : columns of the panorama; None takes the outer circle's length in pixels, so that
        nothing is lost.

    Returns (height, width, 3) in [0, 1], one row per pixel of radius. Row i has the radius
    ``row_radii(ring)[i]``, the outermost on top; column j has the angle 2 pi j / width from the
    picture's right, by the bottom. Colours are interpolated linearly: of the four pixels around a
    point none gets a negative weight, so edges do not ring.

    Raises `ImageError` for a picture that is none, or where the ring leaves it; `OptionError`.
    """
    picture = colour_image(image)
    _refuse_outside(picture, ring)
    if width is None:
        width = math.ceil(2.0 * math.pi * ring.outer_radius)
    whole_number(width, "width", at_least=MIN_SIDE)
    radii = row_radii(ring)[:, None]
    angles = 2.0 * math.pi * np.arange(width) / width
    rows = ring.centre_row + radii * np.sin(angles)
    columns = ring.centre_column + radii * np.cos(angles)
    channels = [
        map_coordinates(picture[:, :, channel], [rows, columns], order=1, mode="nearest")
        for channel in range(3)
    ]
    return np.stack(channels, axis=-1)


def row_radii(ring: Ring) -> FloatArray:
    """Radius (height,) of each row of the panorama, pixels of the ring, from top to bottom."""
    height = max(MIN_SIDE, round(ring.outer_radius - ring.inner_radius))
    share = (np.arange(height) + 0.5) / height
    return np.asarray(ring.outer_radius + share * (ring.inner_radius - ring.outer_radius))


def _refuse_outside(picture: FloatArray, ring: Ring) -> None:
    for axis, centre, size in (
        ("row", ring.centre_row, picture.shape[0]),
        ("column", ring.centre_column, picture.shape[1]),
    ):
        if not -0.5 <= centre <= size - 0.5:
            raise OptionError(
                f"ring centre_{axis} is {centre:g}, outside the picture's {size}: give its centre"
            )
        # A pixel's width of tolerance: circles are measured by hand.
        reach = min(centre, size - 1.0 - centre) + 1.5
        if ring.outer_radius > reach:
            raise ImageError(
                f"image: the ring's outer_radius {ring.outer_radius:g} leaves the picture, which "
                f"ends {reach - 1.5:g} pixels from the centre: give a smaller one"
            )
