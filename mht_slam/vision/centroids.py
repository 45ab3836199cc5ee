"""The column of a blob to a fraction of a pixel, and how far to trust it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion, gaussian_filter

from mht_slam.arrays import BoolArray, FloatArray
from mht_slam.vision.blobs import CORNERS_TOO, Blob

RIM = 2
"""Pixels outside the threshold's edge that may still be covered in part."""
FRAME = 4
"""Pixels outside that edge up to which the background is looked at."""

FLOOR = 0.05
"""Standard deviation that no centroid goes below, pixels: what remains without any noise."""

ROUGHNESS = 0.1
"""Scatter of the middles of a whole cone's rows, pixels, that remains without any noise."""
SCATTERED = 2.0
"""A blob is lopsided where that scatter is larger than expected by this factor."""
LOPSIDED_SPREAD = 3.0
"""Standard deviation added to a lopsided blob, in units of the scatter: a cone of which a tenth
to a half is hidden moves by .5 to 2.8 of them."""
TOUCHING_SPREAD = 0.05
"""Standard deviation added to a blob cut from its neighbour, widths."""

UNTOLD = 0.3
"""Noise of the share of a pixel that colours do not tell: anything between 0 and 1."""

_MAD_TO_SIGMA = 1.4826
_NEARBY = 1.0
"""Standard deviation of the weights of a blob's pixels in the colour of its rim, pixels."""


@dataclass(frozen=True)
class Centroid:
    """Where a blob is, in columns of the panorama."""

    column: float
    """Coverage-weighted mean column; it may lie past an edge."""
    sigma: float
    """Its standard deviation, columns."""
    lopsided: bool
    """Whether the blob is not its own mirror image, as when a part of it is hidden."""


def centroid(blob: Blob, colours: FloatArray, *, coarseness: float = 1.0) -> Centroid:
    """Return the centroid column of a blob, each pixel weighted by how much of it is covered.

    Parameters
    ----------
    blob : its window, see `Blob`.
    colours : (h, w, 3) of the window.
    coarseness : columns per pixel of the sensor, above 1 where a ring was stretched.

    A pixel inside counts 1. A pixel of the rim is a mixture of the blob's colour and the
    background's, so it counts its place between the two along the axis of the blob's chroma, on
    which every grey is 0; where the background has as much of that chroma, only the threshold says
    what is covered. The variance is that of rim pixels whose mixture is noisy, with the noise seen
    in the background, plus `FLOOR`, plus what touching and lopsidedness add.
    """
    core = binary_erosion(blob.mask, CORNERS_TOO)
    reach = binary_dilation(blob.mask, CORNERS_TOO, iterations=RIM) & ~blob.others
    rim = reach & ~core
    share, noise = _coverage(blob, colours, core)
    weights = np.where(core, 1.0, np.where(rim, np.clip(share, 0.0, 1.0), 0.0))
    profile = weights.sum(axis=0)
    total = float(profile.sum())
    mean = float(profile @ blob.columns) / total
    away = blob.columns.astype(np.float64) - mean
    mixed = rim & (share > -noise) & (share < 1.0 + noise)
    row_noise = coarseness**0.5 * noise * np.sqrt(mixed @ away**2)
    scatter, expected = _scatter_of_rows(weights, away, row_noise, coarseness)
    lopsided = scatter > SCATTERED * expected
    variance = float(row_noise @ row_noise) / total**2 + (FLOOR * coarseness) ** 2
    variance += (LOPSIDED_SPREAD * scatter * lopsided) ** 2
    variance += (TOUCHING_SPREAD * blob.width * blob.touching) ** 2
    return Centroid(mean, float(np.sqrt(variance)), lopsided)


def _scatter_of_rows(
    weights: FloatArray, away: FloatArray, row_noise: FloatArray, coarseness: float
) -> tuple[float, float]:
    """Standard deviation of the middles of the rows, by their weight, and what is expected.

    An upright cone or post, seen whole, has the middles of all its rows on its axis. `row_noise`
    (h,) is the standard deviation of each row's sum of weighted columns.
    """
    per_row = weights.sum(axis=1)
    kept = per_row >= 1.0
    shares = per_row[kept] / per_row[kept].sum()
    middles = weights[kept] @ away / per_row[kept]
    scatter = np.sqrt(shares @ (middles - shares @ middles) ** 2)
    noise = shares @ (row_noise[kept] / per_row[kept]) ** 2
    return float(scatter), float(np.sqrt(noise + (ROUGHNESS * coarseness) ** 2))


def _coverage(blob: Blob, colours: FloatArray, core: BoolArray) -> tuple[FloatArray, float]:
    """Share (h, w) of each pixel that the blob covers, and that share's noise."""
    inside = core if core.any() else blob.mask
    colour = np.median(colours[inside], axis=0)
    chroma = colour - colour.mean()
    along = colours @ chroma
    frame = (
        binary_dilation(blob.mask, CORNERS_TOO, iterations=FRAME)
        & ~binary_dilation(blob.mask, CORNERS_TOO, iterations=RIM)
        & ~binary_dilation(blob.others, CORNERS_TOO, iterations=RIM)
    )
    level = float(np.median(along[frame])) if frame.any() else 0.0
    # From one pixel to the next: something else in the background is no noise.
    steps = np.diff(along, axis=1)[frame[:, 1:] & frame[:, :-1]]
    noise = _MAD_TO_SIGMA * float(np.median(np.abs(steps))) / 2.0**0.5 if len(steps) else 0.0
    contrast = np.maximum(_nearby_inside(along, inside) - level, 1e-6)
    typical = float(np.median(contrast[inside]))
    if typical <= max(noise, 1e-6):
        # The background has as much of that chroma: only the threshold tells what is covered.
        return blob.mask.astype(np.float64), UNTOLD
    return (along - level) / contrast, noise / typical


def _nearby_inside(values: FloatArray, inside: BoolArray) -> FloatArray:
    """Mean (h, w) of the values inside that are near: light from one side shades a cone."""
    weight = gaussian_filter(inside.astype(np.float64), _NEARBY)
    total = gaussian_filter(np.where(inside, values, 0.0), _NEARBY)
    elsewhere = float(np.median(values[inside]))
    return np.where(weight > 1e-9, total / np.maximum(weight, 1e-9), elsewhere)
