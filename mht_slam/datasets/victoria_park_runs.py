"""Straight runs cut from the Victoria Park recording, with their true association."""

from __future__ import annotations

from mht_slam.datasets.labelled_runs import LabelledRun, assemble_run
from mht_slam.datasets.victoria_park import VictoriaParkRecording


def straight_window_runs(recording: VictoriaParkRecording) -> list[LabelledRun]:
    """Return every scan of every straight window with all its detections.

    The truth has the misses and false alarms of the recording: a detection in no track is a false
    alarm, though it may be a tree seen once or twice, since tracks have three detections or more.
    """
    laser = recording.laser
    return [
        assemble_run(
            f"victoria park window {tracked.window.number}",
            tracked.window.scans,
            [laser.scans[scan].bearings for scan in tracked.window.scans],
            tracked.identities,
            poses=tracked.reference_poses,
            landmarks=tracked.reference_landmarks,
        )
        for tracked in recording.windows
    ]
