"""What an `OrderTracker` assumes of sensor and motion, and how hard it tries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from mht_slam.arrays import finite_number, one_of, whole_number
from mht_slam.measurements import SMALLEST_SIGMA

Mode: TypeAlias = Literal["general", "paper"]


@dataclass(frozen=True)
class TrackerConfig:
    """Assumptions and effort of an `OrderTracker`; angles in radians, lengths in steps of a scan.

    The fields that `ObservationModel` has too mean the same here. The *nearness* of a landmark is
    the length of a step over its range: what sets how fast its bearing changes. Raises
    `OptionError` for a value that makes no sense, naming the field.

    >>> TrackerConfig(sigma=0.01).detection_probability
    0.95
    """

    sigma: float = float(np.deg2rad(0.5))
    """Standard deviation of a bearing; a scan's own goes before it."""
    detection_probability: float = 0.95
    """Chance that a landmark in view is detected."""
    stay_probability: float = 0.998
    """Chance that a landmark in view is still in view at the next scan."""
    false_alarm_rate: float = 0.05
    """Expected false alarms per radian and scan."""
    new_rate: float = 0.01
    """Expected landmarks per radian and scan that come into view."""
    nearness: float = 0.03
    """Mean nearness of a landmark seen for the first time."""
    nearness_sigma: float = 0.05
    """Spread about it."""
    step_change_sigma: float = 0.03
    """Spread of the ratio of a step to the one before it."""
    drift_sigma: float = float(np.deg2rad(2.0))
    """Spread of the direction of travel about the heading."""
    turn_sigma: float = float(np.deg2rad(3.0))
    """Scale of the robot's turns from scan to scan, which may be far greater now and then."""
    turn_error_sigma: float = float(np.deg2rad(0.5))
    """Spread of the lasting error of the turns as they are estimated."""
    confirm: int = 3
    """Detections that make a track a landmark; fewer are taken for false alarms."""
    window: int = 20
    """Scans after which a decision is final."""
    n_alternatives: int = 10
    """Most readings that are kept of one ambiguity."""
    drop: float = 5.0
    """Readings this many nats below the best are dropped."""
    mode: Mode = "general"
    """``general``: predictions decide who is who; ``paper``: the paper's rule alone."""

    def __post_init__(self) -> None:
        finite_number(self.sigma, "sigma", at_least=SMALLEST_SIGMA, below=np.pi)
        for name in ("detection_probability", "stay_probability"):
            finite_number(getattr(self, name), name, above=0.0, below=1.0)
        for name in ("false_alarm_rate", "new_rate", "nearness_sigma", "turn_sigma", "drop"):
            finite_number(getattr(self, name), name, above=0.0)
        finite_number(self.nearness, "nearness", at_least=0.0, below=1.0)
        for name in ("step_change_sigma", "drift_sigma", "turn_error_sigma"):
            finite_number(getattr(self, name), name, at_least=0.0)
        for name in ("confirm", "window", "n_alternatives"):
            whole_number(getattr(self, name), name, at_least=1)
        one_of(self.mode, "mode", get_args(Mode))

    @property
    def unassigned_rate(self) -> float:
        """Detections per radian and scan that continue no track."""
        return self.false_alarm_rate + self.new_rate
