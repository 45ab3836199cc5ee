"""Is the estimator a lottery: the whole DLR recording under parameters drawn about the default.

    python benchmarks/recordings/parameter_draws.py [--output DIR] [--draws N] [--workers N]

Draw 0 is the default. In every other draw each number of the model is multiplied by a factor of its
own, log-uniform between 1/1.3 and 1.3, and each chance p has its odds multiplied so. Reported are
F1 over same-landmark pairs, the position error after alignment with scale (smoothed and online),
and F1 within windows of 100 scans. Rows are added as they come; a second call goes on with those of
the same models and the same estimator.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from contenders import code_version
from drive_sets import MODELS, WINDOW

import mht_slam as ms
from mht_slam.datasets import dlr_drive
from mht_slam.errors import RecordingNotFoundError
from mht_slam.evaluation.agreement import pair_counts, pooled
from mht_slam.evaluation.trajectories import trajectory_errors
from mht_slam.models import ObservationModel

CAMERA = MODELS["dlr"]
SPREAD = 1.3
NUMBERS = ("sigma", "landmark_sigma", "false_alarm_rate", "expected_landmarks", "bearing_dof")
CHANCES = ("detection_probability", "stay_probability")
CODE = code_version(("mht_slam.incremental", "mht_slam.datasets"))
COLUMNS = (
    "code",
    "draw",
    "f1",
    "f1_in_windows",
    "least_window",
    "position_error",
    "online_error",
    "model",
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the draws that are missing, and print the table."""
    options = _parse(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    path = options.output / "rows.csv"
    rows = [row for row in _read(path) if row.get("code") == CODE and _is_of_its_draw(row)]
    done = {row["draw"] for row in rows}
    missing = [draw for draw in range(options.draws + 1) if str(draw) not in done]
    try:
        with ProcessPoolExecutor(options.workers) as pool:
            for row in pool.map(result_of, missing):
                rows.append(row)
                _write(path, rows)
    except RecordingNotFoundError as error:
        print(f"parameter_draws: {error}", file=sys.stderr)
        return 2
    wanted = [row for row in rows if int(row["draw"]) <= options.draws]
    lines = list(_table(sorted(wanted, key=lambda row: int(row["draw"]))))
    (options.output / "summary.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))
    return 0


def _is_of_its_draw(row: dict[str, str]) -> bool:
    return row["model"] == drawn(int(row["draw"])).describe()


def drawn(draw: int) -> ObservationModel:
    """Return the model of a draw; draw 0 is the default."""
    if draw == 0:
        return CAMERA
    rng = np.random.default_rng(draw)
    values = {}
    for name in (*NUMBERS, *CHANCES):
        factor = math.exp(rng.uniform(-math.log(SPREAD), math.log(SPREAD)))
        value = getattr(CAMERA, name)
        odds = value / (1.0 - value) * factor if name in CHANCES else 0.0
        values[name] = odds / (1.0 + odds) if name in CHANCES else value * factor
    return replace(CAMERA, **values)


def result_of(draw: int) -> dict[str, str]:
    """Run the whole recording under a draw."""
    drive = dlr_drive()
    model = drawn(draw)
    slam = ms.MultiHypothesisSlam(ms.SlamConfig(model=model))
    for scan in drive.scans:
        slam.update(scan)
    found, truth = slam.association, drive.truth()
    windows = [range(a, min(a + WINDOW, len(drive))) for a in range(0, len(drive), WINDOW)]
    parts = [pair_counts(found.restrict(w), truth.restrict(w)) for w in windows]
    reference = drive.reference_poses
    smoothed = trajectory_errors(slam.trajectory, reference, with_scale=True)
    online = trajectory_errors(slam.online_trajectory, reference, with_scale=True)
    figures = (
        pair_counts(found, truth).f1,
        pooled(parts).f1,
        min(part.f1 for part in parts),
        smoothed.position,
        online.position,
    )
    cells = [CODE, str(draw), *(f"{figure:.4f}" for figure in figures), model.describe()]
    return dict(zip(COLUMNS, cells, strict=True))


def _table(rows: Sequence[dict[str, str]]) -> Iterator[str]:
    yield "| draw | F1 | F1 in windows, pooled | least window | position error, m | online, m |"
    yield "|---|---|---|---|---|---|"
    for row in rows:
        name = "default" if row["draw"] == "0" else row["draw"]
        figures = [f"{float(row[column]):.3f}" for column in COLUMNS[2:7]]
        yield "| " + " | ".join([name, *figures]) + " |"
    columns = [[float(row[column]) for row in rows] for column in COLUMNS[2:7]]
    yield "| median | " + " | ".join(f"{np.median(column):.3f}" for column in columns) + " |"
    worst = [min(columns[0]), min(columns[1]), min(columns[2]), max(columns[3]), max(columns[4])]
    yield "| worst | " + " | ".join(f"{figure:.3f}" for figure in worst) + " |"


def _read(path: Path) -> list[dict[str, str]]:
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [dict(row) for row in csv.DictReader(file)]


def _write(path: Path, rows: Sequence[dict[str, str]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--output", type=Path, default=Path("runs/parameter-draws"))
    parser.add_argument("--draws", type=int, default=10, help="draws besides the default")
    parser.add_argument("--workers", type=int, default=2)
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
