"""Tracks through dense scans: bearing against scan number, one colour a track."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.association import MISSED, Association
from mht_slam.measurements import BearingScan, wrap_angle
from mht_slam.plotting.style import INK
from mht_slam.tracking.exchanges import exchanges

COLOURS = "tab20"
MOST_NAMES = 30
"""Runs of more tracks are drawn without their numbers."""
SEAM_STEP = np.pi
"""A bearing that changes by more between two detections has crossed the seam at 180 degrees."""


def tracks_figure(scans: Sequence[BearingScan], association: Association) -> Figure:
    """Draw the bearings of all scans, joined along the rows of an association.

    Crosses are detections of no track; rings are where two tracks exchange places in the visual
    order. Dotted lines bridge scans that miss a landmark. Raises `AssociationError` unless the
    association is over these scans.
    """
    crossings = exchanges(scans, association)
    figure = Figure(figsize=(10.0, 6.0), layout="constrained")
    axes = figure.subplots()
    palette = matplotlib.colormaps[COLOURS].colors  # type: ignore[attr-defined]
    table = association.table
    for row, entries in enumerate(table):
        seen = np.flatnonzero(entries != MISSED).astype(np.int64)
        bearings = np.array([scans[k].bearings[entries[k]] for k in seen.tolist()])
        colour = palette[row % len(palette)]
        axes.plot(seen, np.degrees(bearings), ".", color=colour, markersize=4, zorder=3)
        for steps, style in ((np.diff(seen) == 1, "-"), (np.diff(seen) > 1, ":")):
            x, y = _joined(seen, bearings, steps)
            axes.plot(x, np.degrees(y), style, color=colour, linewidth=1.2, zorder=2)
        if len(table) <= MOST_NAMES:
            axes.annotate(
                f"{row}",
                (float(seen[-1]), float(np.degrees(bearings[-1]))),
                xytext=(4, 0),
                textcoords="offset points",
                va="center",
                fontsize=8,
                color=colour,
            )
    stray = np.array(association.false_alarms, dtype=np.int64).reshape(-1, 2)
    at = [float(np.degrees(scans[k].bearings[j])) for k, j in stray.tolist()]
    axes.plot(stray[:, 0], at, "x", color="0.6", markersize=4, zorder=1)
    for crossing in crossings:
        i = crossing.pair[0]
        places = [scans[k].bearings[table[i, k]] for k in (crossing.before, crossing.after)]
        middle = wrap_angle(places[0] + 0.5 * wrap_angle(float(places[1] - places[0])))
        axes.plot(
            0.5 * (crossing.before + crossing.after),
            np.degrees(middle),
            "o",
            markersize=9,
            markerfacecolor="none",
            markeredgecolor=INK,
            markeredgewidth=0.9,
            zorder=4,
        )
    axes.set_xlim(-0.5, 1.03 * max(len(scans), 1))
    axes.set_ylim(-185.0, 185.0)
    axes.set_yticks(range(-180, 181, 45))
    axes.set_xlabel("scan")
    axes.set_ylabel("bearing, degrees from forward")
    axes.set_title(
        f"{len(table)} tracks through {len(scans)} scans; exchanges of places: {len(crossings)}"
    )
    figure.legend(
        handles=[
            Line2D([], [], color=INK, marker=".", label="track"),
            Line2D([], [], color=INK, linestyle=":", label="scans that miss it"),
            Line2D([], [], color="0.6", marker="x", linestyle="", label="in no track"),
            Line2D(
                [], [], color=INK, marker="o", linestyle="", markersize=9, fillstyle="none",
                label="two tracks exchange places",
            ),
        ],
        loc="outside lower center",
        ncols=4,
        frameon=False,
    )  # fmt: skip
    return figure


def _joined(
    seen: IntArray, bearings: FloatArray, wanted: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Ends of the wanted steps with gaps between them; none is drawn across the seam."""
    across = np.abs(np.diff(bearings)) > SEAM_STEP
    steps = np.flatnonzero(wanted & ~across)
    gap = np.full(len(steps), np.nan)
    x = np.column_stack([seen[steps], seen[steps + 1], gap]).ravel()
    y = np.column_stack([bearings[steps], bearings[steps + 1], gap]).ravel()
    return x, y
