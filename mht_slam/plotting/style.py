"""What all figures share: tones that survive greyscale, shapely shapes, ellipses, windows."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse, Polygon
from scipy.stats import chi2

from mht_slam.arrays import FloatArray

INK = "black"
CONE_TONE = "0.88"
CELL_TONE = "0.55"
CHOSEN_TONE = "#7fa8d1"
SHARED_TONE = "#c9c9c9"
TRUTH_TONE = "#b01030"

ELLIPSE_COVERAGE = 0.95

MARGIN = 0.08
"""Free space round a figure's window, as a share of its longer side."""


def draw_shape(axes: Axes, shape: Any, **style: Any) -> None:
    """Draw the polygons of a shapely geometry; points, lines and emptiness leave nothing."""
    for part in shapely.get_parts(shape):
        if part.geom_type == "Polygon" and not part.is_empty:
            axes.add_patch(Polygon(shapely.get_coordinates(part.exterior), closed=True, **style))


def draw_ellipse(axes: Axes, centre: FloatArray, covariance: FloatArray, **style: Any) -> None:
    """Draw the region that holds `ELLIPSE_COVERAGE` of a Gaussian (2,), (2, 2)."""
    variances, vectors = np.linalg.eigh(covariance)
    width, height = 2.0 * np.sqrt(chi2.ppf(ELLIPSE_COVERAGE, df=2) * np.maximum(variances, 0.0))
    angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
    axes.add_patch(
        Ellipse((float(centre[0]), float(centre[1])), width, height, angle=angle, **style)
    )


def ellipse_bounds(centre: FloatArray, covariance: FloatArray) -> tuple[float, ...]:
    """Bounds (x low, y low, x high, y high) of the ellipse that `draw_ellipse` draws."""
    half = np.sqrt(chi2.ppf(ELLIPSE_COVERAGE, df=2) * np.diag(covariance))
    return (*(centre - half).tolist(), *(centre + half).tolist())


def set_window(axes: Axes, must: FloatArray, wanted: Iterable[Any], *, reach: float) -> None:
    """Show all points `must` (k, 2), and of the bounds `wanted` what lies near them.

    Cells may be a hundred baselines long; `reach` times the extent of `must` is what a window
    follows them on each side. Axes are equal.
    """
    low, high = must.min(axis=0), must.max(axis=0)
    extent = float((high - low).max()) or 1.0
    farthest_low, farthest_high = low - reach * extent, high + reach * extent
    for bounds in wanted:
        box = np.asarray(bounds, dtype=np.float64)
        if np.isfinite(box).all():
            low = np.minimum(low, np.maximum(box[:2], farthest_low))
            high = np.maximum(high, np.minimum(box[2:], farthest_high))
    margin = MARGIN * float((high - low).max())
    # A window too flat to read gets some height.
    missing = np.maximum(0.0, 0.45 * float((high - low).max()) - (high - low)) / 2.0
    low, high = low - margin - missing, high + margin + missing
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal", adjustable="box")


def in_window(axes: Axes, points: FloatArray) -> list[int]:
    """Indices of the (k, 2) points inside the axes' window."""
    (x_low, x_high), (y_low, y_high) = axes.get_xlim(), axes.get_ylim()
    x, y = points[:, 0], points[:, 1]
    inside = (x >= x_low) & (x <= x_high) & (y >= y_low) & (y <= y_high)
    return [int(i) for i in np.flatnonzero(inside)]
