"""Figures of the documentation: zones, order changes, and tracks.

python benchmarks/tracking/figures.py [--output docs/figures]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from dense_scenes import Setting, dense_scene

import mht_slam as ms
from mht_slam.plotting import order_changes_figure, tracks_figure, zones_figure

PENTAGON = ((0.0, 0.0), (4.0, -0.5), (5.0, 3.0), (2.0, 4.5), (-1.0, 2.5))
ALL_AROUND = ((-4.0, -3.0), (4.0, -3.0), (4.0, 5.0), (0.0, 5.4), (-4.0, 5.0), (0.0, 2.0))
"""The last one stands before the others: not in convex position."""
PATH = ((-7.5, -2.5), (-2.0, -1.2), (2.5, 0.8), (8.5, 4.2))
RUN = Setting("scatter", "lawnmower", step=0.1, n_landmarks=8, sigma_deg=0.5)
SEED = 3


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, default=Path("docs/figures"))
    output = parser.parse_args(arguments).output
    output.mkdir(parents=True, exist_ok=True)
    scene = dense_scene(RUN, np.random.default_rng(SEED))
    tracker = ms.OrderTracker(ms.TrackerConfig(sigma=np.deg2rad(RUN.sigma_deg)))
    for scan in scene.scans:
        tracker.update(scan)
    figures = {
        "zones": zones_figure(PENTAGON),
        "order_changes": order_changes_figure(PATH, ALL_AROUND),
        "tracks": tracks_figure(scene.scans, tracker.association),
    }
    for name, figure in figures.items():
        figure.savefig(output / f"{name}.png", dpi=110)
    return 0


if __name__ == "__main__":
    sys.exit(main())
