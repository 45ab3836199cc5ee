"""Pictures of a world with cones: panoramas, and the rings that catadioptric cameras see.

Coverage of a pixel's width is exact and rows are supersampled, so that a body's silhouette is
centred on its bearing to far below a pixel. Source: docs/method.md, section 7; the looks are ours.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

from mht_slam.arrays import FloatArray, finite_array, finite_number, whole_number
from mht_slam.errors import OptionError
from mht_slam.simulation.sensors import bearings_and_ranges
from mht_slam.vision.camera import PanoramaCamera, Ring

ORANGE = (0.95, 0.40, 0.08)
GREY = (0.45, 0.45, 0.47)

_SKY_ABOVE = np.array([0.35, 0.55, 0.85])
_SKY_AT_HORIZON = np.array([0.80, 0.87, 0.93])
_GRASS = np.array([0.30, 0.45, 0.18])
_GRASS_GRAIN = 1.2
"""Standard deviation of the blur that makes tufts of independent pixels, pixels."""
_BLUR_REACH = 3.0
"""Standard deviations at which a blur is cut off."""
_ROWS_PER_ROW = 4
_FINE = 2
"""Columns of the panorama behind a ring, per pixel of its outer circle."""
_RING_SAMPLES = 2
"""Samples per pixel of a ring and axis."""

DEFAULT_CAMERA = PanoramaCamera()


@dataclass(frozen=True)
class Body:
    """An upright body of the world: a cone, or a post that may stand before one.

    Raises `OptionError` naming the field, for a value out of its range.
    """

    x: float
    y: float
    height: float = 0.7
    """Length above the ground, in the world's unit (metres, for the defaults)."""
    base_radius: float = 0.18
    top_radius: float = 0.0
    colour: tuple[float, float, float] = ORANGE
    """Red, green, blue in [0, 1]."""

    def __post_init__(self) -> None:
        finite_number(self.x, "body x")
        finite_number(self.y, "body y")
        finite_number(self.height, "body height", above=0.0)
        finite_number(self.base_radius, "body base_radius", above=0.0)
        finite_number(self.top_radius, "body top_radius", at_least=0.0, at_most=self.base_radius)
        if not isinstance(self.colour, tuple) or len(self.colour) != 3:
            raise OptionError(f"body colour is {self.colour!r}: give (red, green, blue)")
        for value in self.colour:
            finite_number(value, "body colour", at_least=0.0, at_most=1.0)


@dataclass(frozen=True)
class View:
    """What the camera's pictures look like, whatever stands in the world.

    Raises `OptionError` naming the field, for a value out of its range.
    """

    width: int = 1440
    """Columns of a whole turn."""
    height: int = 180
    """Rows of a panorama, evenly spaced in elevation."""
    highest: float = math.radians(15.0)
    """Elevation of the top edge, radians."""
    lowest: float = math.radians(-30.0)
    """Elevation of the bottom edge, radians."""
    camera_height: float = 0.6
    """Height of the camera above the ground, in the world's unit."""
    blur: float = 0.7
    """Standard deviation of the point spread, pixels."""
    noise: float = 0.02
    """Standard deviation of each channel's noise, of a full scale of 1."""
    grass: float = 0.15
    """Relative standard deviation of the grass's brightness."""
    shading: float = 0.15
    """How much brighter a body's left edge is than its middle, and its right edge darker."""

    def __post_init__(self) -> None:
        whole_number(self.width, "view width", at_least=8)
        whole_number(self.height, "view height", at_least=2)
        finite_number(self.lowest, "view lowest", above=-0.5 * math.pi)
        finite_number(self.highest, "view highest", above=self.lowest, below=0.5 * math.pi)
        finite_number(self.camera_height, "view camera_height", above=0.0)
        for name in ("blur", "noise", "grass"):
            finite_number(getattr(self, name), f"view {name}", at_least=0.0)
        finite_number(self.shading, "view shading", at_least=0.0, at_most=1.0)


DEFAULT_VIEW = View()


def cones_at(landmarks: npt.ArrayLike) -> list[Body]:
    """Return an orange cone of the default size at each of the (n, 2) places."""
    places = finite_array(landmarks, "landmarks", OptionError, remedy="give x, y of each cone")
    if places.size and (places.ndim != 2 or places.shape[1] != 2):
        raise OptionError(f"landmarks has shape {places.shape}: give (n, 2)")
    return [Body(x, y) for x, y in places.tolist()]


def render_panorama(
    pose: npt.ArrayLike,
    bodies: Iterable[Body],
    rng: np.random.Generator,
    *,
    view: View = DEFAULT_VIEW,
    camera: PanoramaCamera = DEFAULT_CAMERA,
) -> FloatArray:
    """Render what the camera of a robot at `pose` (x, y, theta) sees, all around.

    Returns (height, width, 3) in [0, 1], red, green and blue. A body is centred on column
    ``camera.columns(bearing, width)``, its bearing being that of its axis seen from the camera.
    Nearer bodies hide farther ones. Raises `OptionError` for a camera inside a body.

    >>> render_panorama([0, 0, 0], cones_at([[5, 2]]), np.random.default_rng(0)).shape
    (180, 1440, 3)
    """
    clean = _clean_panorama(pose, list(bodies), rng, view, camera, view.width, view.height)
    return _developed(clean, view, rng, around=True)


def render_ring(
    pose: npt.ArrayLike,
    bodies: Iterable[Body],
    rng: np.random.Generator,
    *,
    camera: PanoramaCamera,
    view: View = DEFAULT_VIEW,
) -> FloatArray:
    """Render the picture of a catadioptric camera: the panorama as a ring on black.

    The elevations of `view` run linearly from the inner to the outer circle of ``camera.ring``;
    its width and height are not used. Returns (rows, columns, 3) in [0, 1], large enough for the
    ring. Raises `OptionError` like `render_panorama`, and for a camera without a ring.
    """
    ring = camera.ring
    if ring is None:
        raise OptionError("camera.ring is None: give the ring to draw, or render a panorama")
    width = _FINE * math.ceil(2.0 * math.pi * ring.outer_radius)
    height = math.ceil(ring.outer_radius - ring.inner_radius)
    fine = _clean_panorama(pose, list(bodies), rng, view, camera, width, height)
    return _developed(_bent(fine, ring), view, rng, around=False)


def _clean_panorama(
    pose: npt.ArrayLike,
    bodies: Sequence[Body],
    rng: np.random.Generator,
    view: View,
    camera: PanoramaCamera,
    width: int,
    height: int,
) -> FloatArray:
    """The scene without the camera's blur and noise (height, width, 3)."""
    edges = np.linspace(view.highest, view.lowest, _ROWS_PER_ROW * height + 1)
    elevations = 0.5 * (edges[:-1] + edges[1:])
    scene = _background(elevations, rng, view, width, height)
    if bodies:
        camera_pose = camera.camera_poses(np.asarray(pose)[None])[0]
        bearings, ranges = bearings_and_ranges(camera_pose, np.array([[b.x, b.y] for b in bodies]))
        columns = camera.columns(bearings, width)
        for index in np.argsort(-ranges, kind="stable").tolist():
            _draw(scene, bodies[index], columns[index], ranges[index], elevations, view)
    return np.asarray(scene.reshape(height, _ROWS_PER_ROW, width, 3).mean(axis=1))


def _background(
    elevations: FloatArray, rng: np.random.Generator, view: View, width: int, height: int
) -> FloatArray:
    share = np.clip(elevations / max(view.highest, 1e-9), 0.0, 1.0)[:, None]
    sky = share * _SKY_ABOVE + (1.0 - share) * _SKY_AT_HORIZON
    tufts = _blurred(rng.standard_normal((height, width, 1)), _GRASS_GRAIN, around=True)
    tufts *= view.grass / tufts.std()
    grass = _GRASS * np.repeat(1.0 + tufts, _ROWS_PER_ROW, axis=0)
    return np.where((elevations > 0.0)[:, None, None], sky[:, None, :], grass)


def _draw(
    scene: FloatArray,
    body: Body,
    column: float,
    distance: float,
    elevations: FloatArray,
    view: View,
) -> None:
    """Paint a body over the scene, each pixel by the share of its width that is covered."""
    if distance <= body.base_radius:
        raise OptionError(f"the camera is inside the body at ({body.x:g}, {body.y:g}): move either")
    width = scene.shape[1]
    # How high up the body a ray of each elevation meets it, taken at the distance of its axis.
    level = (view.camera_height + distance * np.tan(elevations)) / body.height
    rows = np.flatnonzero((level >= 0.0) & (level <= 1.0))
    radius = body.base_radius + (body.top_radius - body.base_radius) * level[rows, None]
    half = np.arcsin(radius / distance) * width / (2.0 * math.pi)
    reach = math.ceil(float(half.max(initial=0.0))) + 1
    near = np.arange(math.floor(column) - reach, math.ceil(column) + reach + 1)
    left = np.maximum(near - 0.5, column - half)
    right = np.minimum(near + 0.5, column + half)
    cover = np.clip(right - left, 0.0, 1.0)[:, :, None]
    across = np.clip((near - column) / np.maximum(half, 1e-9), -1.0, 1.0)[:, :, None]
    paint = np.clip(np.array(body.colour) * (1.0 - view.shading * across), 0.0, 1.0)
    window = np.ix_(rows, np.mod(near, width))
    scene[window] = scene[window] * (1.0 - cover) + paint * cover


def _bent(panorama: FloatArray, ring: Ring) -> FloatArray:
    """Lay a panorama round its ring; samples inside a pixel are averaged."""
    height, width, _ = panorama.shape
    shape = tuple(
        math.floor(centre + ring.outer_radius) + 2
        for centre in (ring.centre_row, ring.centre_column)
    )
    total = np.zeros((*shape, 3))
    shifts = (np.arange(_RING_SAMPLES) + 0.5) / _RING_SAMPLES - 0.5
    for down in shifts:
        for right in shifts:
            rows = np.arange(shape[0])[:, None] + down - ring.centre_row
            columns = np.arange(shape[1]) + right - ring.centre_column
            radii = np.hypot(rows, columns)
            inside = (radii >= ring.inner_radius) & (radii <= ring.outer_radius)
            turn = np.arctan2(rows, columns)[inside] / (2.0 * math.pi)
            share = (ring.outer_radius - radii[inside]) / (ring.outer_radius - ring.inner_radius)
            total[inside] += _interpolated(panorama, share * height - 0.5, turn * width)
    return total / _RING_SAMPLES**2


def _interpolated(panorama: FloatArray, rows: FloatArray, columns: FloatArray) -> FloatArray:
    """Colours (k, 3) between the pixels of a panorama, which closes round its seam."""
    height, width, _ = panorama.shape
    above, before = np.floor(rows).astype(np.int64), np.floor(columns).astype(np.int64)
    down, right = (rows - above)[:, None], (columns - before)[:, None]
    upper, lower = np.clip(above, 0, height - 1), np.clip(above + 1, 0, height - 1)
    left, next_ = np.mod(before, width), np.mod(before + 1, width)
    top = panorama[upper, left] * (1.0 - right) + panorama[upper, next_] * right
    bottom = panorama[lower, left] * (1.0 - right) + panorama[lower, next_] * right
    return np.asarray(top * (1.0 - down) + bottom * down, dtype=np.float64)


def _developed(
    clean: FloatArray, view: View, rng: np.random.Generator, *, around: bool
) -> FloatArray:
    """Blur and noise of the camera."""
    image = _blurred(clean, view.blur, around=around)
    return np.clip(image + view.noise * rng.standard_normal(image.shape), 0.0, 1.0)


def _blurred(image: FloatArray, sigma: float, *, around: bool) -> FloatArray:
    """Gaussian blur of both axes (rows, columns, channels); columns close up if `around`."""
    across: Literal["wrap", "nearest"] = "wrap" if around else "nearest"
    reach = math.ceil(_BLUR_REACH * sigma)
    blurred = gaussian_filter(
        image, (sigma, sigma, 0.0), mode=("nearest", across, "nearest"), radius=reach
    )
    return np.asarray(blurred, dtype=np.float64)
