"""Baseline: the nearest bearing, with rate; it knows of the odometry no more than the headings."""

from __future__ import annotations

import numpy as np
from drive_scores import Answer

from mht_slam.datasets import Drive
from mht_slam.evaluation.trackers import nearest_bearing_tracker
from mht_slam.measurements import BearingScan, StraightRun
from mht_slam.models import ObservationModel

OPTIONS = tuple(
    f"gate {gate} deg, gap {gap}" for gate in (2, 4, 7, 10, 15, 20) for gap in (1, 2, 4, 8)
)


def answer(drive: Drive, model: ObservationModel, option: str) -> Answer:
    """Track the bearings, turned back by the odometer's heading where there is one."""
    del model
    words = option.replace(",", "").split()
    heading, turned = 0.0, []
    for scan in drive.scans:
        heading += 0.0 if scan.odometry is None else scan.odometry.dtheta
        turned.append(BearingScan(scan.bearings + heading))
    gate, gap = np.deg2rad(float(words[1])), int(words[4])
    return Answer(nearest_bearing_tracker(StraightRun(turned), gate, gap))
