"""How good bearings from panoramas are, over rendered scenes, and a picture of what is detected.

``python benchmarks/vision/panoramas.py --output runs/panoramas`` writes rows.csv (a cone a row),
summary.md (the table of docs/vision.md) and detections.png (its figure). Seeds are the scenes'
numbers; the same options give the same rows.
"""

from __future__ import annotations

import argparse
import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from mht_slam.measurements import wrap_angle
from mht_slam.plotting.detections import detections_figure
from mht_slam.simulation.panorama import GREY, Body, View, cones_at, render_panorama
from mht_slam.vision import DetectionOptions, detect_cones

CONES = 8
VIEW = View()
VIEWS = {
    "2.5 to 8 m": (VIEW, 2.5, 8.0),
    "8 to 14 m": (VIEW, 8.0, 14.0),
    "14 to 20 m": (VIEW, 14.0, 20.0),
    "2.5 to 14 m, noise .05": (replace(VIEW, noise=0.05), 2.5, 14.0),
    "2.5 to 14 m, blur 1.5 pixels": (replace(VIEW, blur=1.5), 2.5, 14.0),
    "2.5 to 14 m, light from the front": (replace(VIEW, shading=0.0), 2.5, 14.0),
    "2.5 to 14 m, hard light from the side": (replace(VIEW, shading=0.3), 2.5, 14.0),
    "2.5 to 8 m, 720 columns": (replace(VIEW, width=720, height=90), 2.5, 8.0),
}
FIGURE_PLACES = [
    (5.0, 2.0), (3.0, -1.0), (8.0, 6.0), (4.0, 4.0), (6.0, 0.02), (10.0, -8.0), (-5.0, 5.0),
    (-3.0, -3.0), (-3.4, -3.1), (-6.0, -6.6), (-8.0, 1.0), (-2.5, 7.0),
]  # fmt: skip
FIGURE_POST = Body(2.4, 2.47, 1.5, 0.08, 0.08, GREY)


def main() -> None:
    """Render, detect, and write the rows, the table and the figure."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--output", type=Path, default=Path("runs/panoramas"))
    parser.add_argument("--scenes", type=int, default=25, help="scenes of eight cones per view")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    rows = [
        row for name in VIEWS for seed in range(options.scenes) for row in scene_rows(name, seed)
    ]
    with (options.output / "rows.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["view", "seed", "error_pixels", "sigma_pixels", "flagged"])
        writer.writerows(rows)
    table = summary(rows)
    (options.output / "summary.md").write_text(table, encoding="utf-8")
    picture = render_panorama(
        [0, 0, 0], [*cones_at(FIGURE_PLACES), FIGURE_POST], np.random.default_rng(0)
    )
    detections_figure(detect_cones(picture)).savefig(options.output / "detections.png", dpi=110)
    print(table)


def scene_rows(name: str, seed: int) -> list[tuple[str, int, float, float, int]]:
    """Error and sigma of each cone of a scene, pixels; nan where it is not detected."""
    view, near, far = VIEWS[name]
    rng = np.random.default_rng(seed)
    bearings = (np.arange(CONES) + rng.uniform(0.15, 0.85, CONES)) * 2.0 * math.pi / CONES
    distances = rng.uniform(near, far, CONES)
    cones = cones_at(np.column_stack([np.cos(bearings), np.sin(bearings)]) * distances[:, None])
    picture = np.round(255.0 * render_panorama([0, 0, 0], cones, rng, view=view)).astype(np.uint8)
    found = detect_cones(picture, options=DetectionOptions(allow_none=True))
    pixels = view.width / (2.0 * math.pi)
    rows = []
    for bearing in bearings.tolist():
        apart = np.abs(wrap_angle(found.bearings - bearing)) * pixels
        nearest = int(apart.argmin()) if len(found) else 0
        if not len(found) or apart[nearest] > 10.0:
            rows.append((name, seed, math.nan, math.nan, 0))
            continue
        flagged = int(found.lopsided[nearest] or found.touching[nearest])
        sigma = float(found.sigmas[nearest] * pixels)
        rows.append((name, seed, float(apart[nearest]), sigma, flagged))
    return rows


def summary(rows: list[tuple[str, int, float, float, int]]) -> str:
    """The table: a view a row."""
    lines = [
        "| view | cones | missed | flagged | error RMS, pixels | error / sigma, RMS |",
        "|---|---|---|---|---|---|",
    ]
    for name in VIEWS:
        own = np.array([row[2:] for row in rows if row[0] == name])
        seen = own[np.isfinite(own[:, 0])]
        error, sigma = seen[:, 0], seen[:, 1]
        lines.append(
            f"| {name} | {len(own)} | {len(own) - len(seen)} | {int(seen[:, 2].sum())} "
            f"| {np.sqrt(np.mean(error**2)):.3f} | {np.sqrt(np.mean((error / sigma) ** 2)):.2f} |"
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
