"""Calibration of the estimator's live probabilities: who is each detection of the newest scan.

    python benchmarks/recordings/live_calibration.py [--output DIR] [--set SET ...] [--workers N]

Every detection is one forecast: over the landmarks that any hypothesis gives it, and none. A
landmark is who its first detection is. None is right for a false alarm and for the first detection
of a landmark that is really new. The drives are the scored half of each set (drive_sets.py), the
models those of the study of drives. Expected calibration errors stand beside what a perfect
forecaster of the same probabilities shows.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from drive_sets import MODELS, drives_of, half_of
from rich.console import Console

import mht_slam as ms
from mht_slam.datasets import Drive
from mht_slam.errors import RecordingNotFoundError
from mht_slam.evaluation.calibration import (
    Forecast,
    expected_calibration_error_excess,
    top_forecast,
)
from mht_slam.incremental.branch import first_detection
from mht_slam.parallel import ordered_map
from mht_slam.plotting.reliability import draw_reliability_curve

SETS = ("dlr-windows", "victoria-park-windows", "loop", "smooth", "straight")
START = 10
"""Scans that count as the start: over them the estimator keeps a wide beam."""
FEWEST = 30
"""Events below which a point of a curve is not drawn."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive, count, and write summary.md and live_calibration.png."""
    options = _parse(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    lines = [
        "| set | scans | detections | mean probability of the first answer | right | ECE "
        "| of chance | excess |",
        "|---|---|---|---|---|---|---|---|",
    ]
    later: dict[str, list[Forecast]] = {}
    with ProcessPoolExecutor(options.workers) as executor:
        for name in options.set:
            try:
                count = len(drives_of(name))
            except RecordingNotFoundError as error:
                print(f"live_calibration: {error}", file=sys.stderr)
                return 2
            places = [i for i in range(count) if half_of(name, i) == "scored"]
            told = list(ordered_map(executor, forecasts_of, [(name, i) for i in places]))
            for part, chosen in (("first ten", 0), ("later", 1)):
                forecasts = [forecast for drive in told for forecast in drive[chosen]]
                lines.append(_row(name, part, forecasts))
            later[name] = [forecast for drive in told for forecast in drive[1]]
    table = "\n".join(lines) + "\n"
    (options.output / "summary.md").write_text(table)
    _draw(later, options.output / "live_calibration.png")
    Console().print(table, markup=False)
    return 0


def forecasts_of(place: tuple[str, int]) -> tuple[list[Forecast], list[Forecast]]:
    """Return the forecasts for the first `START` scans of a drive, and for the others."""
    name, index = place
    drive = drives_of(name)[index]
    slam = ms.MultiHypothesisSlam(ms.SlamConfig(model=MODELS[name]))
    found: tuple[list[Forecast], list[Forecast]] = [], []
    met: set[int] = set()
    for k, (scan, who) in enumerate(zip(drive.scans, drive.identities, strict=True)):
        slam.update(scan)
        if k:
            for truth, owners in zip(who.tolist(), slam.marginal_associations, strict=True):
                right = [
                    truth < 0 or truth not in met
                    if number < 0
                    else 0 <= truth == _who(drive, number)
                    for number in owners
                ]
                # A landmark in two pieces is right under either name; probabilities add up.
                p = list(owners.values())
                true = sum(x for x, fine in zip(p, right, strict=True) if fine)
                wrong = [x for x, fine in zip(p, right, strict=True) if not fine]
                listed = any(right)
                entries = ([true] if listed else []) + wrong
                found[k >= START].append(Forecast(np.minimum(entries, 1.0), 0 if listed else None))
        met |= {identity for identity in who.tolist() if identity >= 0}
    return found


def _who(drive: Drive, number: int) -> int:
    scan, detection = first_detection(number)
    return int(drive.identities[scan][detection])


def _row(name: str, part: str, forecasts: Sequence[Forecast]) -> str:
    top = top_forecast(forecasts)
    error = expected_calibration_error_excess(forecasts, rng=np.random.default_rng(0), n_draws=100)
    figures = (top.mean_probability, top.accuracy, error.error, error.of_chance, error.excess)
    cells = [name, part, str(len(forecasts)), *(f"{figure:.3f}" for figure in figures)]
    return "| " + " | ".join(cells) + " |"


def _draw(later: dict[str, list[Forecast]], path: Path) -> None:
    figure, axes = plt.subplots(figsize=(5.2, 5.0), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=0.8)
    for i, (name, forecasts) in enumerate(later.items()):
        style = {"color": f"C{i % 10}", "marker": "os^Dv"[i % 5]}
        draw_reliability_curve(axes, forecasts, name, style, fewest=FEWEST)
    axes.set(
        xlabel="stated probability of an owner of a detection",
        ylabel="share that is right, 95 % interval",
        xlim=(0, 1),
        ylim=(0, 1),
    )
    axes.legend(loc="upper left", fontsize=8)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--output", type=Path, default=Path("runs/live_calibration"))
    parser.add_argument("--set", nargs="+", choices=list(MODELS), default=list(SETS))
    parser.add_argument("--workers", type=int, default=1)
    return parser.parse_args(arguments)


if __name__ == "__main__":
    raise SystemExit(main())
