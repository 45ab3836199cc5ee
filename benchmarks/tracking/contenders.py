"""Who is compared on dense runs: the tracker in both modes, trivial trackers, and a ceiling."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

import mht_slam as ms
from mht_slam.arrays import FloatArray
from mht_slam.evaluation.trackers import nearest_bearing_tracker, order_keeping_tracker
from mht_slam.measurements import wrap_angle
from mht_slam.simulation.sensors import bearings_and_ranges

TRACKER, PAPER = "order tracker", "paper's rule"
BEARING, HUNGARIAN = "nearest bearing with rate", "Hungarian with gating"
KEPT_ORDER = "order kept"
CEILING = "given truth"
BASELINES = (PAPER, BEARING, HUNGARIAN, KEPT_ORDER)
"""What the tracker must not do worse than."""

GATES_DEG = (1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0)
MAX_GAPS = (1, 3, 6)
CONFIRM = 3
"""Shorter tracks are dropped, for all alike."""


@dataclass(frozen=True)
class Contender:
    """A method, with gate and gap where it has them."""

    method: str
    gate_deg: float | None = None
    max_gap: int | None = None

    def associate(
        self, scans: Sequence[ms.BearingScan], config: ms.TrackerConfig
    ) -> ms.Association:
        """Return what it makes of a run."""
        if self.method in (TRACKER, PAPER):
            tracker = ms.OrderTracker(config)
            for scan in scans:
                tracker.update(scan)
            return tracker.association
        assert self.gate_deg is not None  # noqa: S101 - the others have both
        assert self.max_gap is not None  # noqa: S101
        run, gate = ms.StraightRun(scans), np.deg2rad(self.gate_deg)
        if self.method == KEPT_ORDER:
            return order_keeping_tracker(run, gate, self.max_gap)
        return nearest_bearing_tracker(run, gate, self.max_gap, with_rate=self.method == BEARING)


def trivial_trackers() -> Iterator[Contender]:
    """Yield the trivial trackers with all the options that tuning chooses from."""
    for method in (BEARING, HUNGARIAN, KEPT_ORDER):
        for gate in GATES_DEG:
            for max_gap in MAX_GAPS:
                yield Contender(method, gate, max_gap)


def given_truth(
    scans: Sequence[ms.BearingScan],
    poses: FloatArray,
    landmarks: FloatArray,
    *,
    sigma: float,
    detection_probability: float,
    false_alarm_rate: float,
) -> ms.Association:
    """Assign each scan's detections to the true landmarks, seen from the true poses.

    Nobody who reads scans alone can do much better: the noise itself exchanges detections.
    """
    labels: list[list[int | None]] = []
    odds = np.log(detection_probability / (1.0 - detection_probability) / false_alarm_rate)
    for scan, pose in zip(scans, poses, strict=True):
        expected, _ = bearings_and_ranges(pose, landmarks)
        off = wrap_angle(scan.bearings - expected[:, None])
        density = -0.5 * (off / sigma) ** 2 - np.log(sigma * np.sqrt(2.0 * np.pi))
        gains = np.maximum(odds + density, 0.0)
        rows, columns = linear_sum_assignment(gains, maximize=True)
        owner = {
            j: i for i, j in zip(rows.tolist(), columns.tolist(), strict=True) if gains[i, j] > 0.0
        }
        labels.append([owner.get(j) for j in range(len(scan))])
    return ms.Association.from_labels(labels)
