"""Observation models fitted to recordings by evidence, without their labels.

    python benchmarks/recordings/fit_models.py [--output DIR] [--workers N] [--sets NAME ...]

Three sets of runs: DLR relaxed (forward camera, all detections), DLR strict (the labelled
detections common to all scans of a segment, so that only motion and noise are fitted) and the
straight windows of Victoria Park (laser). Only the half that tunes parameters is read
(`mht_slam.evaluation.splits.halves`), of it only runs of at most `MAX_SCANS` scans, and never a
label or a reference pose. Every set writes its model to the output folder when it is done, and a
set whose model is there is not fitted again.

Fields of view are data of the sensors: the camera's bearings on the tuning half end at -53 and
+55 degrees, the laser sees a half circle. Tails are not fitted (`mht_slam.fit_observation_model`
says why): four degrees of freedom, as good a guess as eight or none.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress

import mht_slam as ms
from mht_slam.datasets.dlr import read_dlr
from mht_slam.datasets.dlr_runs import all_scan_runs, relaxed_runs
from mht_slam.datasets.labelled_runs import LabelledRun
from mht_slam.datasets.victoria_park import read_victoria_park
from mht_slam.datasets.victoria_park_runs import straight_window_runs
from mht_slam.errors import MhtSlamError
from mht_slam.evaluation.splits import halves
from mht_slam.fitting import PARAMETERS, FittedModel

MAX_SCANS = 20
MOTION_AND_NOISE = ("sigma", "turn_sigma", "drift_sigma", "step_change_sigma")

CAMERA = ms.ObservationModel(
    sigma=np.deg2rad(0.35),
    bearing_dof=4.0,
    motion="smooth",
    turn_sigma=np.deg2rad(3.0),
    drift_sigma=np.deg2rad(6.0),
    step_change_sigma=0.15,
    landmark_sigma=20.0,
    detection_probability=0.8,
    stay_probability=0.93,
    false_alarm_rate=0.1,
    expected_landmarks=12.0,
    field_of_view=np.deg2rad(110.0),
)
COMPLETE = ms.ObservationModel(
    sigma=np.deg2rad(0.35),
    bearing_dof=4.0,
    motion="smooth",
    turn_sigma=np.deg2rad(3.0),
    drift_sigma=np.deg2rad(6.0),
    step_change_sigma=0.15,
    landmark_sigma=20.0,
    detection_probability=0.999,
    false_alarm_rate=1e-6,
    expected_landmarks=12.0,
)
LASER = ms.ObservationModel(
    sigma=np.deg2rad(0.15),
    bearing_dof=4.0,
    motion="smooth",
    turn_sigma=np.deg2rad(1.2),
    drift_sigma=np.deg2rad(5.0),
    step_change_sigma=0.15,
    landmark_sigma=40.0,
    detection_probability=0.85,
    stay_probability=0.95,
    false_alarm_rate=0.15,
    expected_landmarks=20.0,
    field_of_view=np.deg2rad(182.0),
)
"""Where the three searches start, chosen by eye."""

SETS: dict[str, tuple[Callable[[], list[LabelledRun]], ms.ObservationModel, tuple[str, ...]]] = {
    "dlr_relaxed": (lambda: relaxed_runs(read_dlr()), CAMERA, PARAMETERS),
    "dlr_strict": (
        lambda: all_scan_runs(read_dlr()),
        COMPLETE,
        (*MOTION_AND_NOISE, "landmark_sigma"),
    ),
    "victoria_park": (lambda: straight_window_runs(read_victoria_park()), LASER, PARAMETERS),
}
"""Runs, start and fitted parameters of each set."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Fit every set that has no result yet, and print all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("runs/fit_models"))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--sets", nargs="+", choices=list(SETS), default=list(SETS))
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    for name in options.sets:
        path = options.output / f"{name}.json"
        if not path.exists():
            try:
                result = fit_set(name, options.rounds, options.workers)
            except MhtSlamError as error:
                print(f"fit_models: {name}: {error}", file=sys.stderr)
                return 2
            path.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
        report(name, json.loads(path.read_text(encoding="utf-8")))
    return 0


def fit_set(name: str, rounds: int, workers: int) -> dict[str, Any]:
    """Fit one set; the result as it is saved."""
    read, start, parameters = SETS[name]
    tuning, _ = halves(read())
    runs = [labelled.run for labelled in tuning if len(labelled.run) <= MAX_SCANS]
    pool = nullcontext() if workers == 1 else ProcessPoolExecutor(workers)
    with pool as executor, Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task(name)
        fitted = ms.fit_observation_model(
            runs,
            start,
            parameters=parameters,
            rounds=rounds,
            executor=executor,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    return as_json(start, fitted)


def as_json(start: ms.ObservationModel, fitted: FittedModel) -> dict[str, Any]:
    """Models, evidence and standard errors, angles in radians."""
    return {
        "start": start.describe(),
        "fitted": fitted.model.describe(),
        "n_runs": fitted.n_runs,
        "rounds": [
            {
                "n_runs": entry.n_runs,
                "log_evidence_before": entry.log_evidence_before,
                "log_evidence": entry.log_evidence,
                "model": entry.model.describe(),
            }
            for entry in fitted.rounds
        ],
        "standard_errors": dict(fitted.standard_errors),
        "model": fitted.model.to_dict(),
    }


def report(name: str, result: dict[str, Any]) -> None:
    """Print one set's result."""
    print(f"\n{name}: {result['n_runs']} runs\n  start  {result['start']}")
    for k, entry in enumerate(result["rounds"], start=1):
        print(
            f"  round {k}: {entry['n_runs']} runs, log evidence "
            f"{entry['log_evidence_before']:.1f} -> {entry['log_evidence']:.1f}"
        )
    print(f"  fitted {result['fitted']}")
    errors = [f"{key} {value:.3g}" for key, value in result["standard_errors"].items()]
    print(f"  standard errors {', '.join(errors)}")


if __name__ == "__main__":
    sys.exit(main())
