"""The car park recording as one drive: a car among a few identical reflectors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.association import MISSED
from mht_slam.datasets.drive import Drive, shuffled_drive
from mht_slam.datasets.drive_odometry import (
    UTILITY_VEHICLE,
    UTILITY_VEHICLE_NOISE,
    integrated_motions,
)
from mht_slam.datasets.location import data_folder, recording_file
from mht_slam.datasets.tables import read_table
from mht_slam.measurements import BearingScan

FOLDER = "sydney_carpark"
DETECTION_COLUMNS = (
    "scan",
    "t_s",
    "bearing_rad_ccw_from_forward",
    "range_m",
    "n_beams",
    "beacon_index0",
    "gps_x_m",
    "gps_y_m",
    "heading_ref_rad",
)
POSE_COLUMNS = (
    "scan",
    "t_s",
    "gps_x_m",
    "gps_y_m",
    "heading_ref_rad",
    "beacon_fit_x_m",
    "beacon_fit_y_m",
    "beacon_fit_theta_rad",
    "n_beacons_in_fit",
)


def car_park_drive(folder: Path | None = None) -> Drive:
    """Return the whole recording with odometry from speed and steering.

    Identities are the nearest surveyed beacons; the reference is the GPS position with the source's
    heading, and the survey. The source does not state the car's axle geometry. That of the same
    group's car in Victoria Park, `UTILITY_VEHICLE`, is taken: with it the reference headings turn
    as the steering says, which no wheelbase alone achieves.

    `folder` is the ``sydney_carpark`` folder; None looks in `data_folder()`. Raises
    `RecordingNotFoundError` where a file is missing and `RecordingError`, with file and line, where
    one is malformed.
    """
    source = data_folder() / FOLDER if folder is None else Path(folder)
    times, poses = _poses(recording_file(source, "poses.csv"))
    found = _detections(recording_file(source, "detections.csv"), len(times))
    driven = _columns(
        recording_file(source, "velocity_steering.csv"),
        ("t_s", "velocity_m_s", "steering_rad"),
    )
    twists = UTILITY_VEHICLE.twists(driven[:, 1], driven[:, 2])
    motions = integrated_motions(driven[:, 0], twists, np.array(times))
    steps = [None, *(UTILITY_VEHICLE_NOISE.odometry(motion) for motion in motions)]
    beacons = _columns(recording_file(source, "beacons.csv"), ("beacon", "x_m", "y_m"))
    return shuffled_drive(
        "car park",
        [
            BearingScan(np.array([bearing for bearing, _ in seen]), time=time, odometry=step)
            for seen, time, step in zip(found, times, steps, strict=True)
        ],
        [np.array([beacon for _, beacon in seen], dtype=np.int64) for seen in found],
        poses=np.array(poses),
        landmarks={int(beacon): (x, y) for beacon, x, y in beacons.tolist()},
    )


def _poses(path: Path) -> tuple[list[float], list[list[float]]]:
    times: list[float] = []
    poses: list[list[float]] = []
    for read, row in read_table(path, POSE_COLUMNS):
        if read.whole(row["scan"], "scan") != len(poses):
            raise read.error("scan", row["scan"], f"scan {len(poses)} comes here")
        time = read.number(row["t_s"], "t_s")
        if times and time <= times[-1]:
            raise read.error("t_s", row["t_s"], f"it runs backwards from {times[-1]}")
        times.append(time)
        poses.append([read.number(row[name], name) for name in POSE_COLUMNS[2:5]])
    return times, poses


def _detections(path: Path, n_scans: int) -> list[list[tuple[float, int]]]:
    """Bearing and beacon of the detections of each scan."""
    found: list[list[tuple[float, int]]] = [[] for _ in range(n_scans)]
    for read, row in read_table(path, DETECTION_COLUMNS):
        scan = read.whole(row["scan"], "scan")
        if not 0 <= scan < n_scans:
            raise read.error("scan", f"{scan}", "it is outside the recording")
        beacon = read.whole(row["beacon_index0"], "beacon_index0")
        if beacon < MISSED or beacon in [other for _, other in found[scan] if other != MISSED]:
            raise read.error("beacon_index0", f"{beacon}", "a scan sees a beacon at most once")
        bearing = read.number(row["bearing_rad_ccw_from_forward"], "bearing_rad_ccw_from_forward")
        found[scan].append((bearing, beacon))
    return found


def _columns(path: Path, columns: Sequence[str]) -> FloatArray:
    rows = [
        [read.number(row[name], name) for name in columns]
        for read, row in read_table(path, tuple(columns))
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, len(columns))
