"""Pictures from files and arrays, and the only door to scikit-image.

Inside the package a picture is (rows, columns, 3) float64 in [0, 1]: red, green, blue.
"""

from __future__ import annotations

import os
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from mht_slam.arrays import FloatArray
from mht_slam.errors import ImageError, ImageNotFoundError, MissingExtraError

MIN_SIDE = 8
"""The fewest rows and columns in which a blob and its surroundings fit."""


def read_image(path: str | os.PathLike[str]) -> FloatArray:
    """Read a colour picture from a file: PNG, JPEG, TIFF and whatever else scikit-image reads.

    Returns (rows, columns, 3) in [0, 1]. Raises `ImageNotFoundError` where there is no file,
    `ImageError` for a file that is no picture or not one with colours, `MissingExtraError`.

    An orientation stored beside the pixels, as phones do, is not applied.
    """
    source = Path(path)
    if not source.is_file():
        raise ImageNotFoundError(f"{source}: no such file: name a picture that exists")
    io = scikit_image("io")
    try:
        # From memory: for a file that is no picture, its readers leave the file open.
        pixels = io.imread(BytesIO(source.read_bytes()))
    except Exception as cause:  # every backend has errors of its own, some not even OSError
        raise ImageError(f"{source}: cannot be read as a picture: give a PNG or JPEG") from cause
    return colour_image(pixels, str(source))


def colour_image(pixels: npt.ArrayLike, name: str = "image") -> FloatArray:
    """Check a picture and scale it to (rows, columns, 3) in [0, 1].

    Takes whole numbers over their type's range (0 to 255 for uint8) or floats in [0, 1]; a fourth
    channel is opacity, over white. Raises `ImageError`, naming the picture, for anything else.
    """
    try:
        array = np.asarray(pixels)
    except ValueError as cause:
        raise ImageError(f"{name}: no array: give one picture, rows x columns x 3") from cause
    if array.ndim == 2 or (array.ndim == 3 and array.shape[2] in (1, 2)):
        raise ImageError(f"{name}: shape {array.shape} is a grey picture: colour finds the cones")
    if array.ndim != 3 or array.shape[2] not in (3, 4):
        raise ImageError(f"{name}: shape {array.shape}: give one picture, rows x columns x 3")
    if min(array.shape[:2]) < MIN_SIDE:
        raise ImageError(f"{name}: shape {array.shape}: give at least {MIN_SIDE} rows and columns")
    if array.dtype.kind == "u":
        scaled = array / float(np.iinfo(array.dtype).max)
    elif array.dtype.kind == "f":
        scaled = array.astype(np.float64)
        if not (np.isfinite(scaled).all() and scaled.min() >= 0.0 and scaled.max() <= 1.0):
            raise ImageError(f"{name}: values outside [0, 1]: scale floats, or give uint8")
    else:
        raise ImageError(f"{name}: pixels of type {array.dtype}: give uint8, or floats in [0, 1]")
    if scaled.shape[2] == 4:
        opacity = scaled[:, :, 3:]
        scaled = scaled[:, :, :3] * opacity + (1.0 - opacity)
    return np.asarray(scaled, dtype=np.float64)


def write_image(path: str | os.PathLike[str], image: FloatArray) -> None:
    """Write a picture (rows, columns, 3) in [0, 1] with eight bits a channel.

    Raises `OSError` for a place that cannot be written, `MissingExtraError`.
    """
    eight_bits = np.round(255.0 * image).astype(np.uint8)
    scikit_image("io").imsave(Path(path), eight_bits, check_contrast=False)


def scikit_image(part: str) -> Any:
    """Import and return a part of scikit-image; a `MissingExtraError` where it is not installed."""
    try:
        return import_module(f"skimage.{part}")
    except ImportError as cause:
        raise MissingExtraError(
            "pictures need scikit-image, which is not installed: pip install 'mht-slam[vision]'"
        ) from cause
