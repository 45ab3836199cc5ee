"""Does the estimate still know where it is: detections that nothing explains, over recent scans."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mht_slam.arrays import IntArray
from mht_slam.association import MISSED
from mht_slam.incremental.motion_terms import ODOMETRY, STILL
from mht_slam.incremental.steps import Step

SCANS = 8
"""Scans judged together."""
FRESH = 2
"""Newest scans left out: a landmark seen once is nothing yet."""
FEWEST = 8
"""Detections in these scans below which nothing is said."""
LOST, FOUND = 0.6, 0.35
"""Share of unexplained detections above which the robot is lost, and below which it is found."""
OPENING = 4.0
"""By how much a lost robot's steps may deviate more."""


@dataclass(frozen=True)
class Monitor:
    """Whether recent scans agree with the map.

    False alarms and landmarks seen once stay unexplained in good times too, but they are few. A
    robot that has lost itself predicts every landmark elsewhere, so that nearly all detections
    match neither the map nor each other. Only open scans are judged: with a `SlamConfig.lag` of
    `FRESH` or less nobody is ever lost.
    """

    is_lost: bool = False
    unexplained: float = 0.0

    def after(self, owners: tuple[IntArray, ...]) -> Monitor:
        """Return the judgement with one scan more; `owners` are those of the open scans."""
        judged = owners[-SCANS - FRESH : -FRESH]
        everything = np.concatenate(judged) if judged else np.empty(0, np.int64)
        if len(everything) < FEWEST:
            return replace(self, unexplained=0.0)
        share = float((everything == MISSED).mean())
        return Monitor(share > (FOUND if self.is_lost else LOST), share)


def opened(step: Step) -> Step:
    """Return a step whose deviations are `OPENING` times as large."""
    parameters = step.parameters.copy()
    if step.kind == ODOMETRY:
        parameters[3:12] /= OPENING
    elif step.kind != STILL:
        parameters[:3] *= OPENING
    return Step(step.kind, parameters)
