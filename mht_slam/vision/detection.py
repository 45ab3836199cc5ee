"""`detect_cones`: from a picture and a calibration to bearings with their sigmas.

Source: the paper's section 4; docs/method.md, section 7.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from mht_slam.arrays import BoolArray, FloatArray, IntArray, finite_number, freeze, whole_number
from mht_slam.errors import ImageError, OptionError
from mht_slam.measurements import BearingScan
from mht_slam.vision.blobs import Blob, connected_blobs, parts
from mht_slam.vision.camera import PanoramaCamera
from mht_slam.vision.centroids import Centroid, centroid
from mht_slam.vision.images import colour_image, scikit_image
from mht_slam.vision.unwrapping import row_radii, unwrap

_TURN = 2.0 * math.pi


@dataclass(frozen=True)
class DetectionOptions:
    """What counts as a cone. The colours are those of `skimage.color.rgb2hsv`.

    Raises `OptionError` naming the field, for a value out of its range.
    """

    hue_from_deg: float = 345.0
    """Start of the hues, degrees on the colour circle: 0 red, 30 orange, 60 yellow, 120 green."""
    hue_to_deg: float = 45.0
    """End of the hues, going up from the start, through red where it is smaller."""
    min_saturation: float = 0.5
    """Least saturation, in [0, 1]: grey, white and pale things have little."""
    min_value: float = 0.3
    """Least value, in [0, 1]: dark pixels have no reliable hue."""
    min_area: int = 12
    """Fewest pixels of a cone."""
    max_width: float = math.radians(60.0)
    """Greatest width of a cone, radians."""
    min_aspect: float = 0.4
    """Least height over width, in pixels of the panorama: what lies flat is no cone."""
    min_fill: float = 0.3
    """Least share of its bounding box that a cone fills; a triangle fills a half."""
    max_share: float = 0.5
    """Share of all pixels above which the colours match the surroundings, which is an error."""
    extra_sigma: float = 0.0
    """Standard deviation that calibration, tilt and the like add to every bearing, radians."""
    allow_none: bool = False
    """Whether a picture without a cone is an empty scan instead of an error."""

    def __post_init__(self) -> None:
        finite_number(self.hue_from_deg, "hue_from_deg", at_least=0.0, at_most=360.0)
        finite_number(self.hue_to_deg, "hue_to_deg", at_least=0.0, at_most=360.0)
        for name in ("min_saturation", "min_value", "min_fill"):
            finite_number(getattr(self, name), name, at_least=0.0, at_most=1.0)
        whole_number(self.min_area, "min_area", at_least=1)
        finite_number(self.max_width, "max_width", above=0.0, below=math.pi)
        finite_number(self.min_aspect, "min_aspect", at_least=0.0)
        finite_number(self.max_share, "max_share", above=0.0, at_most=1.0)
        finite_number(self.extra_sigma, "extra_sigma", at_least=0.0)
        if not isinstance(self.allow_none, bool):
            raise OptionError(f"allow_none is {self.allow_none!r}: give True or False")


@dataclass(frozen=True, eq=False)
class PanoramaDetections:
    """The cones of one picture, in the order of their columns.

    Attributes
    ----------
    bearings : (n,) radians in (-pi, pi], robot frame, seen from the camera's own point.
    sigmas : (n,) their standard deviations, radians.
    columns : (n,) in [0, W), of the panorama.
    widths : (n,) angular widths, radians; half of one is a generous hint for epsilon.
    areas : (n,) pixels.
    touching : (n,) whether a cone was cut from one that touches it; its sigma is wider.
    lopsided : (n,) whether it is not its own mirror image, as when partly hidden; likewise.
    panorama : (H, W, 3) in [0, 1], unwrapped where the picture is a ring.
    mask : (H, W) the pixels of the detected cones.
    """

    bearings: FloatArray
    sigmas: FloatArray
    columns: FloatArray
    widths: FloatArray
    areas: IntArray
    touching: BoolArray
    lopsided: BoolArray
    panorama: FloatArray = field(repr=False)
    mask: BoolArray = field(repr=False)

    def __len__(self) -> int:
        return len(self.bearings)

    @property
    def scan(self) -> BearingScan:
        """The bearings with their sigmas, as one scan."""
        return BearingScan(self.bearings, sigma=self.sigmas)


DEFAULT_OPTIONS = DetectionOptions()


def detect_cones(
    image: npt.ArrayLike,
    camera: PanoramaCamera | None = None,
    options: DetectionOptions = DEFAULT_OPTIONS,
) -> PanoramaDetections:
    """Find the cones of a panorama, or of a catadioptric ring, and their bearings.

    Parameters
    ----------
    image : (rows, columns, 3 or 4) red, green, blue (and opacity): uint8, another unsigned type,
        or floats in [0, 1]. A panorama shows a whole turn in its columns.
    camera : its calibration; None is an unmoved clockwise camera with forward at column 0.
    options : colours and sizes of cones.

    A ring is unwrapped, colours are thresholded in hue, saturation and value, matching pixels that
    touch (also across the seam) are blobs, blobs of two peaks are cut, blobs of another size or
    shape are dropped, and each that is left gets its coverage-weighted centroid column. Bearings
    are those seen from the camera; its offset is in the poses, see `PanoramaCamera`.

    Raises `ImageError` for an array that is no colour picture, for one without a cone (unless
    `options.allow_none`), and for one that matches nearly everywhere; `OptionError` for a ring
    outside the picture; `MissingExtraError` without scikit-image.

    >>> panorama = np.full((40, 360, 3), 0.5)
    >>> panorama[10:30, 88:93] = (0.95, 0.40, 0.08)
    >>> np.degrees(detect_cones(panorama).bearings).round(2).tolist()
    [-90.0]
    """
    chosen = PanoramaCamera() if camera is None else camera
    if not isinstance(chosen, PanoramaCamera):
        raise OptionError(f"camera is {type(chosen).__name__}: give a PanoramaCamera")
    if not isinstance(options, DetectionOptions):
        raise OptionError(f"options is {type(options).__name__}: give DetectionOptions")
    if chosen.ring is None:
        panorama = colour_image(image)
        coarseness = np.ones(len(panorama))
    else:
        panorama = unwrap(image, chosen.ring)
        # A column of the panorama is a pixel of the outer circle.
        coarseness = chosen.ring.outer_radius / row_radii(chosen.ring)
    matching = matching_pixels(panorama, options)
    _refuse_everything(matching, options)
    found = [
        (part, _centroid(part, panorama, coarseness))
        for blob in connected_blobs(matching, options.min_area)
        for part in parts(blob)
        if _is_cone(part, panorama.shape[1], options)
    ]
    if not found and not options.allow_none:
        raise ImageError(_nothing(matching, options))
    return _detections(found, panorama, chosen, options)


def matching_pixels(panorama: FloatArray, options: DetectionOptions) -> BoolArray:
    """Which pixels (H, W) of a picture (H, W, 3) in [0, 1] have the colour of cones."""
    hue, saturation, value = np.moveaxis(scikit_image("color").rgb2hsv(panorama), -1, 0)
    degrees = 360.0 * hue
    if options.hue_from_deg <= options.hue_to_deg:
        in_hue = (degrees >= options.hue_from_deg) & (degrees <= options.hue_to_deg)
    else:
        in_hue = (degrees >= options.hue_from_deg) | (degrees <= options.hue_to_deg)
    matching = in_hue & (saturation >= options.min_saturation) & (value >= options.min_value)
    return np.asarray(matching, dtype=np.bool_)


def _refuse_everything(matching: BoolArray, options: DetectionOptions) -> None:
    share = float(matching.mean())
    if share > options.max_share:
        raise ImageError(
            f"image: {share:.0%} of the pixels match: narrow the hues or raise the least "
            "saturation, cones stand out from their surroundings"
        )


def _nothing(matching: BoolArray, options: DetectionOptions) -> str:
    count = int(matching.sum())
    if count == 0:
        return (
            "image: no pixel matches the cones' colour: widen the hues, lower the least saturation "
            "or value, or allow pictures without a cone"
        )
    return (
        f"image: {count} pixels match, but no blob has the size and shape of a cone (at least "
        f"{options.min_area} pixels): change these options, or allow pictures without a cone"
    )


def _is_cone(blob: Blob, width: int, options: DetectionOptions) -> bool:
    return (
        blob.area >= options.min_area
        and blob.width * _TURN / width <= options.max_width
        and blob.height >= options.min_aspect * blob.width
        and blob.area >= options.min_fill * blob.height * blob.width
    )


def _centroid(blob: Blob, panorama: FloatArray, coarseness: FloatArray) -> Centroid:
    colours = panorama[np.ix_(blob.rows, blob.columns % panorama.shape[1])]
    per_row = blob.mask.sum(axis=1)
    return centroid(
        blob,
        colours,
        coarseness=float(per_row @ coarseness[blob.rows]) / blob.area,
    )


def _detections(
    found: Sequence[tuple[Blob, Centroid]],
    panorama: FloatArray,
    camera: PanoramaCamera,
    options: DetectionOptions,
) -> PanoramaDetections:
    width = panorama.shape[1]
    pixel = _TURN / width
    ordered = sorted(found, key=lambda pair: pair[1].column % width)
    mask = np.zeros(panorama.shape[:2], dtype=np.bool_)
    for blob, _ in ordered:
        mask[np.ix_(blob.rows, blob.columns % width)] |= blob.mask
    columns = np.array([place.column % width for _, place in ordered])
    sigmas = np.array(
        [math.hypot(pixel * place.sigma, options.extra_sigma) for _, place in ordered]
    )
    return PanoramaDetections(
        bearings=freeze(camera.bearings(columns, width)),
        sigmas=freeze(sigmas),
        columns=freeze(columns),
        widths=freeze(np.array([pixel * blob.width for blob, _ in ordered])),
        areas=freeze(np.array([blob.area for blob, _ in ordered], dtype=np.int64)),
        touching=freeze(np.array([blob.touching for blob, _ in ordered], dtype=np.bool_)),
        lopsided=freeze(np.array([place.lopsided for _, place in ordered], dtype=np.bool_)),
        panorama=freeze(panorama),
        mask=freeze(mask),
    )
