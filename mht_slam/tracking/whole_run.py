"""The likeliest readings of a whole dense run, for graphs to weigh."""

from __future__ import annotations

from mht_slam.association import Association
from mht_slam.measurements import StraightRun
from mht_slam.models import ObservationModel
from mht_slam.tracking.options import TrackerConfig
from mht_slam.tracking.tracker import OrderTracker

LONGEST_STAY = 0.998
LEAST_RATE = 1e-4
"""A tracker has to begin and end tracks, whatever the model rules out."""


def tracked_alternatives(
    run: StraightRun, model: ObservationModel, most: int
) -> tuple[Association, ...]:
    """Return the most probable readings of a run by an `OrderTracker`, the best first.

    The tracker decides nothing for good before the last scan: its readings differ in who is who
    after the crossings and near misses that prediction left open. It takes from the model what both know: the
    bearings' noise, detections, and how steady the motion is. Raises `OptionError` for a run with
    known identities. Source: docs/method.md, section 6.
    """
    tracker = OrderTracker(_config(model, len(run), most))
    for scan in run.scans:
        tracker.update(scan)
    return tracker.alternatives(most)


def _config(model: ObservationModel, n_scans: int, most: int) -> TrackerConfig:
    common: dict[str, float] = {"sigma": model.sigma}
    if model.compares_sizes:
        chance, rate = model.detection_probability, model.false_alarm_rate
        common["detection_probability"] = min(chance or 0.0, LONGEST_STAY)
        common["false_alarm_rate"] = max(rate or 0.0, LEAST_RATE)
        common["stay_probability"] = min(model.stay_probability, LONGEST_STAY)
    if model.motion == "smooth":
        common["turn_sigma"] = model.turn_sigma
        common["drift_sigma"] = model.drift_sigma
        common["step_change_sigma"] = model.step_change_sigma
    return TrackerConfig(**common, window=n_scans, n_alternatives=most)
