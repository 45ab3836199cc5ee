"""Figure of the calibration study: how often candidates of a stated probability were true."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from calibration_cells import Cell
from calibration_scores import LAPLACE, LIKELIHOOD, POLYGONS, QUADRATURE, Row
from calibration_tables import forecasts
from matplotlib.figure import Figure

from mht_slam.plotting.reliability import draw_reliability_curve

FEWEST = 15
"""Candidates of a bin that is drawn; a curve breaks at bins with fewer."""
STYLES: dict[str, dict[str, object]] = {
    POLYGONS[-1]: {"color": "0.55", "marker": "s", "linestyle": "--"},
    LIKELIHOOD: {"color": "#2f6fad", "marker": "^", "linestyle": ":"},
    LAPLACE: {"color": "black", "marker": "o", "linestyle": "-"},
    QUADRATURE: {"color": "black", "marker": "D", "linestyle": "-.", "markerfacecolor": "white"},
}
PANELS: tuple[tuple[str, Callable[[Cell], bool]], ...] = (
    (
        "drawn from the model",
        lambda cell: cell.from_model and not cell.detections and not cell.heading_sigma_deg,
    ),
    ("with misses and clutter", lambda cell: cell.detections),
    ("with wandering headings", lambda cell: cell.heading_sigma_deg > 0.0),
    ("other scenes or noise", lambda cell: not cell.from_model),
)

_SIDESTEP = 0.006
"""Markers of two scorers beside each other, not over each other."""


def draw(cells: Sequence[Cell], rows: Sequence[Row]) -> Figure:
    """Draw one panel per group of cells, a curve per scorer over all candidates of the group."""
    groups = []
    for title, belongs in PANELS:
        names = {cell.name for cell in cells if belongs(cell)}
        mine = [row for row in rows if row.cell in names]
        if mine:
            groups.append((title, mine))
    figure = Figure(figsize=(3.3 * len(groups), 4.2), layout="constrained")
    panels = figure.subplots(1, len(groups), sharey=True, squeeze=False)[0]
    for axes, (title, mine) in zip(panels, groups, strict=True):
        axes.plot([0, 1], [0, 1], color="0.8", linewidth=4, zorder=1, solid_capstyle="butt")
        for place, (scorer, style) in enumerate(STYLES.items()):
            draw_reliability_curve(
                axes,
                forecasts(mine, scorer),
                scorer,
                style,
                fewest=FEWEST,
                sidestep=_SIDESTEP * (place - 1.5),
            )
        axes.set(
            xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), aspect="equal", xlabel="stated probability"
        )
        axes.set_title(f"{title}\n{len(mine):,} scenes", fontsize=10)
        axes.grid(alpha=0.25)
    panels[0].set_ylabel("share that was true")
    handles = {
        label: handle
        for axes in panels
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        handles=list(handles.values()),
        loc="outside lower center",
        ncols=min(4, 2 * len(groups)),
        frameon=False,
    )
    return figure
