"""Drives of the Victoria Park recording: a car's speed and steering between laser scans."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.datasets.drive import Drive, shuffled_drive
from mht_slam.datasets.drive_odometry import (
    UTILITY_VEHICLE,
    UTILITY_VEHICLE_NOISE,
    integrated_motions,
)
from mht_slam.datasets.location import data_folder, recording_file
from mht_slam.datasets.tables import read_numbers
from mht_slam.datasets.victoria_park import (
    FOLDER,
    LaserScans,
    TrackedWindow,
    read_victoria_park,
)
from mht_slam.measurements import BearingScan

INPUTS_FILE, GPS_FILE = "inputs.dat", "gps.dat"
LONGEST_GAP = 3.0
"""Seconds between two GPS fixes across which a position is interpolated."""


def victoria_park_drive(folder: Path | None = None) -> Drive:
    """Return the whole recording with odometry from speed and steering.

    Identities are known in straight windows only, which are its `stretches`; windows that follow
    each other are one stretch, their tracks joined through the scan they share. The reference is
    the GPS position, which has no heading (NaN) and gaps (NaN), and there is no reference map; its
    antenna is not where the laser is.

    `folder` is the ``victoria_park`` folder; None looks in `data_folder()`. Raises
    `RecordingNotFoundError` and `RecordingError` as `read_victoria_park` does.
    """
    source = data_folder() / FOLDER if folder is None else Path(folder)
    recording = read_victoria_park(source)
    gps = read_numbers(recording_file(source, GPS_FILE), ("time", "x", "y"))
    identities, stretches = _joined(recording.laser, recording.windows)
    return shuffled_drive(
        "victoria park",
        _scans_with_odometry(recording.laser, source),
        identities,
        poses=_positions(gps, recording.laser.times),
        stretches=stretches,
    )


def victoria_park_windows(folder: Path | None = None) -> list[Drive]:
    """Return the straight windows of the recording as drives with odometry.

    A detection in no track has identity -1, though it may be a tree seen once or twice. References
    are those of the window, in its own frame. Raises as `victoria_park_drive` does.
    """
    source = data_folder() / FOLDER if folder is None else Path(folder)
    recording = read_victoria_park(source)
    scans = _scans_with_odometry(recording.laser, source)
    return [
        shuffled_drive(
            f"victoria park window {tracked.window.number}",
            [scans[k] for k in tracked.window.scans],
            tracked.identities,
            poses=tracked.reference_poses,
            landmarks=tracked.reference_landmarks,
        )
        for tracked in recording.windows
    ]


def _scans_with_odometry(laser: LaserScans, source: Path) -> list[BearingScan]:
    inputs = read_numbers(recording_file(source, INPUTS_FILE), ("time", "speed", "steering"))
    twists = UTILITY_VEHICLE.twists(inputs[:, 1], inputs[:, 2])
    motions = integrated_motions(inputs[:, 0], twists, laser.times)
    steps = [None, *(UTILITY_VEHICLE_NOISE.odometry(motion) for motion in motions)]
    return [
        BearingScan(scan.bearings, time=scan.time, odometry=step)
        for scan, step in zip(laser.scans, steps, strict=True)
    ]


def _joined(
    laser: LaserScans, windows: tuple[TrackedWindow, ...]
) -> tuple[list[IntArray], list[tuple[int, int]]]:
    """Identities of all scans, and the stretches in which they are known."""
    identities = [np.full(len(scan), MISSED, np.int64) for scan in laser.scans]
    stretches: list[tuple[int, int]] = []
    count = 0
    for tracked in windows:
        first, last = tracked.window.first_scan, tracked.window.last_scan
        known: dict[int, int] = {}
        if stretches and stretches[-1][1] == first:
            stretches[-1] = (stretches[-1][0], last)
            both = zip(tracked.identities[0].tolist(), identities[first].tolist(), strict=True)
            known = {track: i for track, i in both if MISSED not in (track, i)}
        else:
            stretches.append((first, last))
        for scan, of_scan in zip(tracked.window.scans, tracked.identities, strict=True):
            for detection in np.flatnonzero(of_scan != MISSED).tolist():
                track = int(of_scan[detection])
                if track not in known:
                    known[track] = count
                    count += 1
                identities[scan][detection] = known[track]
    return identities, stretches


def _positions(gps: FloatArray, times: FloatArray) -> FloatArray:
    """GPS positions at these times, (m, 3) with NaN for the heading, and in gaps."""
    poses = np.full((len(times), 3), np.nan)
    for axis in (0, 1):
        poses[:, axis] = np.interp(times, gps[:, 0], gps[:, 1 + axis])
    after = np.clip(np.searchsorted(gps[:, 0], times), 1, len(gps) - 1)
    outside = (times < gps[0, 0]) | (times > gps[-1, 0])
    poses[outside | (gps[after, 0] - gps[after - 1, 0] > LONGEST_GAP)] = np.nan
    return poses
