"""The DLR recording as one long drive."""

from __future__ import annotations

from pathlib import Path

from mht_slam.datasets.dlr import read_dlr
from mht_slam.datasets.drive import Drive, shuffled_drive


def dlr_drive(folder: Path | None = None) -> Drive:
    """Return the whole recording with its odometry and the odometry's covariance.

    `folder` is the ``dlr`` folder; None looks in `data_folder()`. Ranges and identities are
    withheld from the scans. The reference rests on odometry, bearings, ranges and identities. The
    odometry runs some percent long against it. Raises as `read_dlr` does.
    """
    recording = read_dlr(folder)
    return shuffled_drive(
        "dlr",
        recording.scans,
        recording.identities,
        poses=recording.reference_poses,
        landmarks=recording.reference_landmarks,
    )
