"""Calibration of the estimator's live probabilities: who is each detection of the newest scan.

    python benchmarks/recordings/live_calibration.py [--output DIR] [--set SET ...] [--half HALF]
        [--workers N]

Every detection is one forecast: over the landmarks that any hypothesis gives it, and none. A
landmark is who most of its detections so far are, as the best hypothesis reads them. None is right
for a false alarm and for the first detection of a landmark that is really new. The drives are those
of one half of each set (drive_sets.py), the models those of the study of drives. Expected
calibration errors stand beside what a perfect forecaster of the same probabilities shows. Beside
the excess stand that of the hypotheses' own probabilities, without the doubts about the map
(mht_slam.incremental.doubts), and with them where a landmark is who its first detection is.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from drive_sets import HALVES, MODELS, drives_of, half_of
from rich.console import Console

import mht_slam as ms
from mht_slam.arrays import IntArray
from mht_slam.association import MISSED
from mht_slam.datasets import Drive
from mht_slam.errors import RecordingNotFoundError
from mht_slam.evaluation.calibration import (
    Forecast,
    expected_calibration_error_excess,
    top_forecast,
)
from mht_slam.incremental.branch import first_detection
from mht_slam.incremental.live import marginal_owners
from mht_slam.parallel import ordered_map
from mht_slam.plotting.reliability import draw_reliability_curve

SETS = ("dlr-windows", "victoria-park-windows", "loop", "smooth", "straight")
START = 10
"""Scans that count as the start: over them the estimator keeps a wide beam."""
FEWEST = 30
"""Events below which a point of a curve is not drawn."""


@dataclass
class Found:
    """Forecasts of a drive, read in three ways: as stated, without doubts, by first detections."""

    stated: list[Forecast] = field(default_factory=list)
    undoubted: list[Forecast] = field(default_factory=list)
    by_first: list[Forecast] = field(default_factory=list)


def main(arguments: Sequence[str] | None = None) -> int:
    """Drive, count, and write summary.md and live_calibration.png."""
    options = _parse(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    lines = [
        "| set | scans | detections | mean probability of the first answer | right | ECE "
        "| of chance | excess | without doubts | by first detections |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    later: dict[str, list[Forecast]] = {}
    with ProcessPoolExecutor(options.workers) as executor:
        for name in options.set:
            try:
                count = len(drives_of(name))
            except RecordingNotFoundError as error:
                print(f"live_calibration: {error}", file=sys.stderr)
                return 2
            places = [i for i in range(count) if half_of(name, i) == options.half]
            told = list(ordered_map(executor, forecasts_of, [(name, i) for i in places]))
            for part, chosen in (("first ten", 0), ("later", 1)):
                found = _together([drive[chosen] for drive in told])
                lines.append(_row(name, part, found))
            later[name] = found.stated
    table = "\n".join(lines) + "\n"
    (options.output / "summary.md").write_text(table)
    _draw(later, options.output / "live_calibration.png")
    Console().print(table, markup=False)
    return 0


def forecasts_of(place: tuple[str, int]) -> tuple[Found, Found]:
    """Return the forecasts for the first `START` scans of a drive, and for the others."""
    name, index = place
    drive = drives_of(name)[index]
    slam = ms.MultiHypothesisSlam(ms.SlamConfig(model=MODELS[name]))
    found = Found(), Found()
    met: set[int] = set()
    for k, (scan, who) in enumerate(zip(drive.scans, drive.identities, strict=True)):
        slam.update(scan)
        if k:
            majority = majorities(drive, slam._owners()[:-1])
            newest = len(slam._branches[0].owners) - 1
            undoubted = marginal_owners(slam._branches, newest)
            into = found[k >= START]
            for truth, owners, raw in zip(
                who.tolist(), slam.marginal_associations, undoubted, strict=True
            ):
                first = {number: _first(drive, number) for number in owners}
                most = {number: majority.get(number, first[number]) for number in owners}
                known = truth in met
                into.stated.append(_forecast(truth, known, owners, most))
                into.undoubted.append(_forecast(truth, known, raw, most))
                into.by_first.append(_forecast(truth, known, owners, first))
        met |= {identity for identity in who.tolist() if identity >= 0}
    return found


def majorities(drive: Drive, owners: Sequence[IntArray]) -> dict[int, int]:
    """Return who most detections of each landmark are, the first one where two are as many."""
    counts: dict[int, Counter[int]] = {}
    for owner, who in zip(owners, drive.identities, strict=False):
        for number, identity in zip(owner.tolist(), who.tolist(), strict=True):
            counts.setdefault(number, Counter())[identity] += 1
    return {number: count.most_common(1)[0][0] for number, count in counts.items()}


def _first(drive: Drive, number: int) -> int:
    if number == MISSED:
        return MISSED
    scan, detection = first_detection(number)
    return int(drive.identities[scan][detection])


def _forecast(truth: int, known: bool, owners: dict[int, float], who: dict[int, int]) -> Forecast:
    right = [
        truth < 0 or not known if number == MISSED else 0 <= truth == who[number]
        for number in owners
    ]
    # A landmark in two pieces is right under either name; probabilities add up.
    p = list(owners.values())
    true = sum(x for x, fine in zip(p, right, strict=True) if fine)
    wrong = [x for x, fine in zip(p, right, strict=True) if not fine]
    listed = any(right)
    return Forecast(np.minimum(([true] if listed else []) + wrong, 1.0), 0 if listed else None)


def _together(parts: Sequence[Found]) -> Found:
    return Found(
        [forecast for part in parts for forecast in part.stated],
        [forecast for part in parts for forecast in part.undoubted],
        [forecast for part in parts for forecast in part.by_first],
    )


def _row(name: str, part: str, found: Found) -> str:
    top = top_forecast(found.stated)
    error, *others = (
        expected_calibration_error_excess(some, rng=np.random.default_rng(0), n_draws=100)
        for some in (found.stated, found.undoubted, found.by_first)
    )
    figures = [top.mean_probability, top.accuracy, error.error, error.of_chance, error.excess]
    figures += [other.excess for other in others]
    cells = [name, part, str(len(found.stated)), *(f"{figure:.3f}" for figure in figures)]
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
    parser.add_argument("--half", choices=HALVES, default="scored")
    parser.add_argument("--workers", type=int, default=1)
    return parser.parse_args(arguments)


if __name__ == "__main__":
    raise SystemExit(main())
