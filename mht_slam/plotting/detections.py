"""What was detected in a panorama: the picture with its bearings, and every cone enlarged."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mht_slam.vision.detection import PanoramaDetections

WHOLE = "#00e5ff"
DOUBTFUL = "#ffe600"
"""Colour of a cone that is lopsided, or was cut from a neighbour."""

MOST_CUTOUTS = 12
CUTOUTS_IN_A_ROW = 6
SURROUNDINGS = 1.6
"""Side of a cut-out, in units of the cone's larger side."""
SMALLEST_CUTOUT = 16
"""Its least side, pixels."""


def detections_figure(detections: PanoramaDetections, title: str = "") -> Figure:
    """Draw a panorama with its detections, each numbered by its place in the scan.

    Above the whole panorama, each cone's column and number; below it up to `MOST_CUTOUTS` cones
    enlarged, with the outline of their pixels, the centroid, and bearing and sigma in degrees. A
    lopsided cone, or one cut from a neighbour, is in another colour and says which.
    """
    shown = min(len(detections), MOST_CUTOUTS)
    rows_of_cutouts = math.ceil(shown / CUTOUTS_IN_A_ROW)
    height, width, _ = detections.panorama.shape
    top = 12.0 * height / width + 0.9
    figure = Figure(figsize=(12.0, top + 2.6 * rows_of_cutouts), layout="constrained")
    grid = figure.add_gridspec(
        1 + rows_of_cutouts, CUTOUTS_IN_A_ROW, height_ratios=[top, *[2.6] * rows_of_cutouts]
    )
    _draw_panorama(figure.add_subplot(grid[0, :]), detections, title)
    for index in range(shown):
        row, column = divmod(index, CUTOUTS_IN_A_ROW)
        _draw_cutout(figure.add_subplot(grid[1 + row, column]), detections, index)
    return figure


def _draw_panorama(axes: Axes, detections: PanoramaDetections, title: str) -> None:
    height, width, _ = detections.panorama.shape
    axes.imshow(detections.panorama, interpolation="nearest")
    for index, column in enumerate(detections.columns.tolist()):
        colour = _colour(detections, index)
        # Numbers stand on two levels, so that those of neighbours stay apart.
        bottom = 1.08 if index % 2 else 1.01
        axes.plot([column, column], [bottom, 0.9], color="black", linewidth=0.6,
                  transform=axes.get_xaxis_transform(), clip_on=False)  # fmt: skip
        axes.text(
            column, bottom, f"{index}", transform=axes.get_xaxis_transform(), fontsize=8,
            ha="center", va="bottom", clip_on=False,
            bbox={"facecolor": colour, "edgecolor": "none", "pad": 1.0},
        )  # fmt: skip
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    axes.set_xlabel("column, pixels")
    axes.set_ylabel("row")
    hidden = len(detections) - min(len(detections), MOST_CUTOUTS)
    more = f", the first {MOST_CUTOUTS} enlarged" if hidden else ""
    axes.set_title(f"{title}{': ' if title else ''}{len(detections)} cones{more}", pad=24.0)


def _draw_cutout(axes: Axes, detections: PanoramaDetections, index: int) -> None:
    panorama, mask = detections.panorama, detections.mask
    height, width, _ = panorama.shape
    column = float(detections.columns[index])
    broad = float(detections.widths[index]) * width / (2.0 * math.pi)
    nearby = np.arange(math.floor(column - broad / 2.0), math.ceil(column + broad / 2.0) + 1)
    rows = np.flatnonzero(mask[:, nearby % width].any(axis=1))
    side = max(SMALLEST_CUTOUT, SURROUNDINGS * max(broad, float(np.ptp(rows)) + 1.0))
    middle = 0.5 * float(rows[0] + rows[-1])
    columns = np.arange(math.floor(column - side / 2.0), math.ceil(column + side / 2.0) + 1)
    top, bottom = max(0, math.floor(middle - side / 2.0)), math.ceil(middle + side / 2.0)
    down = np.arange(top, min(height, bottom + 1))
    window = np.ix_(down, columns % width)
    extent = (columns[0] - 0.5, columns[-1] + 0.5, down[-1] + 0.5, down[0] - 0.5)
    axes.imshow(panorama[window], extent=extent, interpolation="nearest")
    colour = _colour(detections, index)
    axes.contour(columns, down, mask[window].astype(np.float64), [0.5], colors=colour,
                 linewidths=0.9)  # fmt: skip
    axes.axvline(column, color="black", linewidth=1.0)
    axes.set_xlim(extent[0], extent[1])
    axes.set_ylim(extent[2], extent[3])
    axes.set_xticks([])
    axes.set_yticks([])
    bearing, sigma = np.degrees([detections.bearings[index], detections.sigmas[index]])
    remarks = [
        word
        for word, holds in (
            ("touching", detections.touching[index]),
            ("lopsided", detections.lopsided[index]),
        )
        if holds
    ]
    axes.set_title(f"{index}: {bearing:.2f} \N{PLUS-MINUS SIGN} {sigma:.3f} deg", fontsize=9)
    axes.set_xlabel(", ".join(remarks), fontsize=9)


def _colour(detections: PanoramaDetections, index: int) -> str:
    doubtful = detections.touching[index] or detections.lopsided[index]
    return DOUBTFUL if doubtful else WHOLE
