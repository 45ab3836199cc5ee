"""What the labels of the tuning halves say of detections, visibility, noise and motion.

    python benchmarks/recordings/label_statistics.py

Counts for the models of the study of all scans, one line a set. A landmark is in view from its
first to its last detection in a run; its detection rate counts the scans between those two, which
are detections by definition, and is low where landmarks hide and come back.
"""

from __future__ import annotations

import sys

import numpy as np
from contenders import READERS, read_halves
from scipy.stats import t as students_t

from mht_slam.arrays import FloatArray
from mht_slam.association import MISSED
from mht_slam.datasets import LabelledRun
from mht_slam.errors import MhtSlamError
from mht_slam.evaluation.ceilings import seen_span
from mht_slam.measurements import wrap_angle

HEADER = (
    "set",
    "detection rate",
    "in view, a scan",
    "stay",
    "false, a scan",
    "widest bearing",
    "bearing MAD",
    "Student's t scale, dof",
    "turn MAD, rms",
    "sideways MAD, rms",
    "ln step change MAD, rms",
)
MOVING = 1e-3
"""Metres a scan below which the robot stands: a direction of motion means nothing there."""


def main() -> int:
    """Print a table with a row for each set."""
    print("| " + " | ".join(HEADER) + " |")
    print("|" + " --- |" * len(HEADER))
    for set_name in READERS:
        try:
            runs = read_halves(set_name)["tuning"]
        except MhtSlamError as error:
            print(f"label_statistics: {error}", file=sys.stderr)
            return 2
        cells = [set_name, *_visibility(runs), *_noise(runs), *_motion(runs)]
        print("| " + " | ".join(cells) + " |")
    return 0


def _visibility(runs: list[LabelledRun]) -> list[str]:
    seen = between = in_view = goes_on = last_seen = false = 0
    for labelled in runs:
        detected = labelled.truth.table != MISSED
        span = seen_span(labelled.truth)
        inner = span[:, 1:-1] & span[:, :-2] & span[:, 2:]
        seen += int((detected[:, 1:-1] & inner).sum())
        between += int(inner.sum())
        in_view += int(span.sum())
        goes_on += int((span[:, :-1] & span[:, 1:]).sum())
        last_seen += int(span[:, :-1].sum())
        false += len(labelled.truth.false_alarms)
    n_scans = sum(len(labelled.run) for labelled in runs)
    widest = max(np.abs(scan.bearings).max(initial=0) for r in runs for scan in r.run.scans)
    return [
        f"{seen / between:.3f}",
        f"{in_view / n_scans:.2f}",
        f"{goes_on / last_seen:.3f}",
        f"{false / n_scans:.3f}",
        f"{np.rad2deg(widest):.1f} deg",
    ]


def _noise(runs: list[LabelledRun]) -> list[str]:
    residuals = np.rad2deg(np.concatenate([_residuals(labelled) for labelled in runs]))
    dof, _, scale = students_t.fit(residuals, floc=0.0)
    return [f"{_mad(residuals):.3f} deg", f"{scale:.3f} deg, {dof:.1f}"]


def _residuals(labelled: LabelledRun) -> FloatArray:
    residuals = []
    for k, (x, y, theta) in enumerate(labelled.reference_poses):
        column = labelled.truth.table[:, k]
        seen = column != MISSED
        dx, dy = (labelled.reference_landmarks[seen] - (x, y)).T
        expected = np.arctan2(dy, dx) - theta
        residuals.append(wrap_angle(labelled.run.scans[k].bearings[column[seen]] - expected))
    return np.concatenate(residuals)


def _motion(runs: list[LabelledRun]) -> list[str]:
    turns, sideways, changes = [], [], []
    for labelled in runs:
        (x, y), theta = labelled.reference_poses[:, :2].T, labelled.reference_poses[:-1, 2]
        dx, dy = np.diff(x), np.diff(y)
        steps = np.hypot(dx, dy)
        moving = steps > MOVING
        turns.append(np.rad2deg(np.diff(np.unwrap(labelled.reference_poses[:, 2]))))
        leftward = dy * np.cos(theta) - dx * np.sin(theta)
        sideways.append(leftward[moving] / steps[moving])
        changes.append(np.diff(np.log(steps[moving])))
    return [
        f"{_mad(values):.3f}{unit}, {np.sqrt(np.mean(values**2)):.3f}{unit}"
        for values, unit in (
            (np.concatenate(turns), " deg"),
            (np.concatenate(sideways), ""),
            (np.concatenate(changes), ""),
        )
    ]


def _mad(values: FloatArray) -> float:
    return 1.4826 * float(np.median(np.abs(values)))


if __name__ == "__main__":
    sys.exit(main())
