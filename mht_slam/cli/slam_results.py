"""What a run of `mht-slam slam` leaves: results, tables, trajectories, map and figures."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mht_slam.association import MISSED, Association
from mht_slam.cli.results import TABLE_FILE, TRAJECTORY_FILE, describe_association, tum_trajectory
from mht_slam.cli.run_folder import write_json

if TYPE_CHECKING:
    from mht_slam.datasets.scan_records import ScanRecord
    from mht_slam.incremental.estimator import MultiHypothesisSlam
    from mht_slam.incremental.slam_map import SlamMap

RESULTS_FILE, MAP_FILE, ASSOCIATIONS_FILE = "results.json", "map.csv", "associations.csv"
ONLINE_TRAJECTORY_FILE = "trajectory_online.tum"
RESULTS_FORMAT = 1
"""Goes up when a reader of older results.json would misread a newer one."""

TABLE_COLUMNS = ("association", "log_evidence", "probability")
MAP_COLUMNS = ("landmark", "x", "y", "sightings", "confirmed", "var_x", "cov_xy", "var_y")
ASSOCIATION_COLUMNS = ("scan", "time", "detection", "bearing_deg", "landmark")


def write_slam_results(
    folder: Path,
    slam: MultiHypothesisSlam,
    records: Sequence[ScanRecord],
    rejected: Mapping[str, int],
) -> None:
    """Write everything but figures. The same scans give the same bytes.

    Raises `OSError`, and `RuntimeError` where GTSAM finds no solution of the whole run; the online
    trajectory, the table and results.json stand by then.
    """
    times = [record.scan.time for record in records]
    truth = _truth(records)
    write_json(folder / RESULTS_FILE, _results(slam, rejected, truth))
    _write_rows(
        folder / TABLE_FILE,
        TABLE_COLUMNS,
        (
            [describe_association(h.association), h.log_evidence, h.probability]
            for h in slam.posterior
        ),
    )
    online = tum_trajectory(slam.online_trajectory, times)
    (folder / ONLINE_TRAJECTORY_FILE).write_text(online, encoding="utf-8")
    smoothed = tum_trajectory(slam.trajectory, times)
    (folder / TRAJECTORY_FILE).write_text(smoothed, encoding="utf-8")
    landmarks = slam.map
    _write_rows(folder / MAP_FILE, MAP_COLUMNS, _map_rows(landmarks))
    _write_rows(
        folder / ASSOCIATIONS_FILE,
        ASSOCIATION_COLUMNS,
        _association_rows(slam.association, landmarks, records),
    )


def _results(
    slam: MultiHypothesisSlam, rejected: Mapping[str, int], truth: Association | None
) -> dict[str, Any]:
    association, posterior = slam.association, slam.posterior
    return {
        "format": RESULTS_FORMAT,
        "n_scans": slam.n_scans,
        "status": slam.status,
        "unit": posterior.unit,
        "model": posterior.model.to_dict(),
        "rejected": dict(rejected),
        "landmarks": association.n_landmarks,
        "alone": len(association.false_alarms),
        "loops": [
            {"scan": scan, "landmarks": count, "log_odds": odds} for scan, count, odds in slam.loops
        ],
        "open_scans": posterior.scans,
        "hypotheses": [
            {
                "association": h.association.table,
                "log_evidence": h.log_evidence,
                "probability": h.probability,
                "poses": h.poses,
                "pose_covariances": h.pose_covariances,
            }
            for h in posterior
        ],
        "f1": None if truth is None else association.f1(truth),
    }


def _truth(records: Sequence[ScanRecord]) -> Association | None:
    """Return the true association, where every scan states it."""
    labels: list[list[int | None]] = []
    for record in records:
        if record.landmarks is None:
            return None
        labels.append([None if label == MISSED else label for label in record.landmarks])
    return Association.from_labels(labels)


def _map_rows(landmarks: SlamMap) -> Iterable[list[object]]:
    covariances = landmarks.covariances.tolist()
    points, sightings = landmarks.points.tolist(), landmarks.sightings.tolist()
    confirmed = landmarks.confirmed.tolist()
    for i, number in enumerate(landmarks.numbers.tolist()):
        (var_x, cov_xy), (_, var_y) = covariances[i]
        yield [number, *points[i], sightings[i], int(confirmed[i]), var_x, cov_xy, var_y]


def _association_rows(
    association: Association, landmarks: SlamMap, records: Sequence[ScanRecord]
) -> Iterable[list[object]]:
    names: list[object] = landmarks.numbers.tolist()
    rows_by_scan = association.landmark_of_detection()
    for k, (record, rows) in enumerate(zip(records, rows_by_scan, strict=True)):
        for detection, row in enumerate(rows.tolist()):
            bearing = math.degrees(float(record.scan.bearings[detection]))
            name = "" if row == MISSED else names[row]
            yield [k, record.scan.time, detection, bearing, name]


def _write_rows(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)
