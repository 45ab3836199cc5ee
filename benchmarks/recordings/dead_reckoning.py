"""Baseline: the odometry alone. It forms no association; no estimator may end up behind it."""

from __future__ import annotations

from drive_scores import Answer, NotApplicableError

from mht_slam.datasets import Drive
from mht_slam.graph.initial import dead_reckoning
from mht_slam.models import ObservationModel

OPTIONS = ("",)


def answer(drive: Drive, model: ObservationModel, option: str) -> Answer:
    """Add the motions up; `NotApplicableError` for a drive without odometry."""
    del model, option
    steps = [scan.odometry for scan in drive.scans[1:] if scan.odometry is not None]
    if len(steps) != len(drive) - 1:
        raise NotApplicableError(f"{drive.name} has no odometry: nothing to add up")
    return Answer(None, dead_reckoning(steps))
