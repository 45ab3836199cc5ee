"""What a run's folder holds of its results: JSON, CSV and the trajectory in TUM format."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mht_slam.arrays import FloatArray
from mht_slam.association import MISSED, Association
from mht_slam.cli.run_folder import write_json
from mht_slam.comparison import ComparisonRow
from mht_slam.hypotheses import Posterior
from mht_slam.measurements import BearingScan
from mht_slam.pipeline import Solution

RESULTS_FILE = "results.json"
TABLE_FILE = "table.csv"
SEEDS_FILE = "seeds.csv"
TRAJECTORY_FILE = "trajectory.tum"

RESULTS_FORMAT = 1
"""Goes up when a reader of older results.json would misread a newer one."""

TABLE_COLUMNS = (
    "association",
    "polygon_score",
    "polygon_rank",
    "log_likelihood",
    "log_evidence",
    "probability",
    "evidence_rank",
    "truth",
    "failure",
)


def write_results(
    folder: Path, solution: Solution, scans: Sequence[BearingScan], truth: Association | None
) -> list[Path]:
    """Write results.json, table.csv and, where there is an estimate, trajectory.tum.

    `scans` and `truth` are over the posterior's scans. Where these are more than were ranked, the
    hypotheses over the ranked scans are in seeds.csv. The same solution gives the same bytes.
    """
    write_json(folder / RESULTS_FILE, _results(solution, truth))
    _write_table(folder / TABLE_FILE, posterior_rows(solution), solution.posterior, truth)
    written = [folder / RESULTS_FILE, folder / TABLE_FILE]
    if solution.seeds is not None:
        of_ranked = truth_of(solution, truth)
        _write_table(folder / SEEDS_FILE, solution.comparison.rows, solution.seeds, of_ranked)
        written.append(folder / SEEDS_FILE)
    if len(solution.posterior) and solution.posterior[0].poses is not None:
        path = folder / TRAJECTORY_FILE
        poses, times = solution.posterior[0].poses, [scan.time for scan in scans]
        path.write_text(tum_trajectory(poses, times), encoding="utf-8")
        written.append(path)
    return written


def posterior_rows(solution: Solution) -> tuple[ComparisonRow, ...]:
    """One row for every hypothesis of the posterior; those over more scans have no polygons."""
    if solution.seeds is None:
        return solution.comparison.rows
    return tuple(
        ComparisonRow(h.association, None, None, h.log_likelihood, h.log_evidence, k, h.probability)
        for k, h in enumerate(solution.posterior, start=1)
    )


def truth_of(solution: Solution, truth: Association | None) -> Association | None:
    """Return what the truth over the posterior's scans says of the ranked ones."""
    if truth is None or solution.seeds is None:
        return truth
    return truth.restrict(solution.ranking.scans)


def describe_association(association: Association) -> str:
    """Write one landmark after the other, each as its detections scan by scan: "0-1-1 1-0-x".

    "x" is a scan that misses the landmark.
    """
    return " ".join(
        "-".join("x" if entry == MISSED else f"{entry}" for entry in row)
        for row in association.table.tolist()
    )


def tum_trajectory(poses: FloatArray, times: Sequence[float | None]) -> str:
    """Write (m, 3) poses as ``timestamp x y z qx qy qz qw``, one scan a line, in their unit.

    The timestamp is the scan's time where all scans have one, else its index.
    """
    lines = []
    for index, (x, y, theta) in enumerate(poses.tolist()):
        time = float(index) if None in times else times[index]
        qz, qw = math.sin(theta / 2.0), math.cos(theta / 2.0)
        lines.append(f"{time!r} {x!r} {y!r} 0.0 0.0 0.0 {qz!r} {qw!r}\n")
    return "".join(lines)


def _results(solution: Solution, truth: Association | None) -> dict[str, Any]:
    ranking, posterior, comparison = solution.ranking, solution.posterior, solution.comparison
    return {
        "format": RESULTS_FORMAT,
        "scans": posterior.scans,
        "n_detections": posterior[0].association.n_detections if len(posterior) else None,
        "unit": posterior.unit,
        "model": posterior.model.to_dict(),
        "ranking": {
            "scans": ranking.scans,
            "epsilon": ranking.epsilon,
            "base": ranking.base,
            "complete": ranking.complete,
            "gap": ranking.gap,
            "n_scored": ranking.n_scored,
            "options": ranking.options,
        },
        "truth": None if truth is None else truth.table,
        "comparison": {
            "kendall_tau": comparison.kendall_tau,
            "top1_agree": comparison.top1_agree,
            "truth_polygon_rank": comparison.truth_polygon_rank,
            "truth_evidence_rank": comparison.truth_evidence_rank,
        },
        "hypotheses": _hypotheses(posterior_rows(solution), posterior, truth),
        "seeds": None
        if solution.seeds is None
        else _hypotheses(comparison.rows, solution.seeds, truth_of(solution, truth)),
        "detections": posterior.detections,
        "marginal_same_landmark": posterior.marginal_same_landmark() if len(posterior) else [],
    }


def _hypotheses(
    rows: Sequence[ComparisonRow], posterior: Posterior, truth: Association | None
) -> list[dict[str, Any]]:
    return [
        {
            "association": row.association.table,
            "polygon_score": row.polygon_score,
            "polygon_rank": row.polygon_rank,
            "log_likelihood": row.log_likelihood,
            "log_evidence": row.log_evidence,
            "log_evidence_error": hypothesis.log_evidence_error,
            "probability": row.probability,
            "evidence_rank": row.evidence_rank,
            "truth": None if truth is None else row.association.exact(truth),
            "failure": hypothesis.failure,
            "poses": hypothesis.poses,
            "landmarks": hypothesis.landmarks,
            "pose_covariances": hypothesis.pose_covariances,
            "landmark_covariances": hypothesis.landmark_covariances,
            "ranged": hypothesis.ranged,
        }
        for row, hypothesis in zip(rows, posterior, strict=True)
    ]


def _write_table(
    path: Path, rows: Sequence[ComparisonRow], posterior: Posterior, truth: Association | None
) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(TABLE_COLUMNS)
        for row, hypothesis in zip(rows, posterior, strict=True):
            writer.writerow(
                [
                    describe_association(row.association),
                    row.polygon_score,
                    row.polygon_rank,
                    row.log_likelihood,
                    row.log_evidence,
                    row.probability,
                    row.evidence_rank,
                    "" if truth is None else int(row.association.exact(truth)),
                    hypothesis.failure,
                ]
            )
