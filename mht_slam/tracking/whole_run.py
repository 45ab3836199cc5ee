"""The likeliest readings of a whole dense run, for graphs to weigh."""

from __future__ import annotations

from dataclasses import replace

from mht_slam.association import Association
from mht_slam.measurements import StraightRun
from mht_slam.models import ObservationModel
from mht_slam.tracking.options import TrackerConfig
from mht_slam.tracking.tracker import OrderTracker

SUREST = 0.998
"""A tracker has to miss and end tracks, whatever the model rules out."""
LEAST_RATE = 1e-4
"""And it has to take a detection for a false alarm."""


def tracked_alternatives(
    run: StraightRun, model: ObservationModel, most: int
) -> tuple[Association, ...]:
    """Return the most probable readings of a run by an `OrderTracker`, the best first.

    The tracker decides nothing for good before the last scan: its readings differ in who is who
    after the crossings and near misses that prediction left open. It takes from the model what both
    know: the bearings' noise, detections, and how steady the motion is. Raises `OptionError` for a
    run with known identities. Source: docs/method.md, section 6.
    """
    tracker = OrderTracker(_config(model, len(run), most))
    for scan in run.scans:
        tracker.update(scan)
    return tracker.alternatives(most)


def _config(model: ObservationModel, n_scans: int, most: int) -> TrackerConfig:
    config = TrackerConfig(sigma=model.sigma, window=n_scans, n_alternatives=most)
    if model.compares_sizes:
        config = replace(
            config,
            detection_probability=min(model.detection_probability or 0.0, SUREST),
            false_alarm_rate=max(model.false_alarm_rate or 0.0, LEAST_RATE),
            stay_probability=min(model.stay_probability, SUREST),
        )
    if model.motion == "smooth":
        config = replace(
            config,
            turn_sigma=model.turn_sigma,
            drift_sigma=model.drift_sigma,
            step_change_sigma=model.step_change_sigma,
        )
    return config
