"""The observation model on the command line: a preset, and every field as an option."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, TypeAlias

from mht_slam.arrays import finite_number
from mht_slam.models import ANGLES, Motion, ObservationModel
from mht_slam.presets import forward_camera, laser, panoramic_robot

Preset: TypeAlias = Literal["panoramic", "camera", "laser"]

PRESETS = {"panoramic": panoramic_robot, "camera": forward_camera, "laser": laser}
EPSILON_OVER_SIGMA = math.sqrt(3.0)
"""Uniform noise inside +-epsilon has the standard deviation epsilon / sqrt 3."""


@dataclass(frozen=True)
class ModelOptions:
    """What is assumed. Options left alone have the preset's value, or else the one named here."""

    preset: Preset | None = None
    """A model to start from: a slow robot that sees all around, a camera that looks ahead, a laser
    that sees the half circle ahead."""
    motion: Motion | None = None
    """How poses follow each other; straight."""
    sigma_deg: float | None = None
    """Standard deviation of a bearing, degrees; a scan's own sigma in the file goes before it;
    epsilon / sqrt(3), which is that of uniform noise inside epsilon."""
    bearing_dof: float | None = None
    """Degrees of freedom of Student's t, for heavy tails; Gaussian."""
    heading_sigma_deg: float | None = None
    """Independent deviation of each heading from the direction of travel, degrees; 0."""
    lateral_sigma: float | None = None
    """Deviation of the third and later scans from the line, first baselines; 0."""
    turn_sigma_deg: float | None = None
    """Change of heading from one scan to the next, degrees (motion smooth); 3."""
    drift_sigma_deg: float | None = None
    """Angle between a step and the heading at its start, degrees (motion smooth); 5."""
    step_change_sigma: float | None = None
    """Standard deviation of ln(next step / step) (motion smooth); .2."""
    stops: bool | None = None
    """Whether the robot may stand still for some scans (motion smooth); no."""
    landmark_sigma: float | None = None
    """Standard deviation of the landmark prior per axis, first baselines; 30. It moves
    probabilities more than anything else."""
    detection_probability: float | None = None
    """Chance that a landmark in view is detected; without it nothing may be missed."""
    false_alarm_rate: float | None = None
    """Expected false alarms per radian of view; goes with the other two of its kind."""
    expected_landmarks: float | None = None
    """Expected number of landmarks in view; goes with the other two of its kind."""
    stay_probability: float | None = None
    """Chance that a landmark in view of one scan is still in view of the next; 1."""
    field_of_view_deg: float | None = None
    """Full angle that the sensor sees, centred on the heading, degrees; 360."""

    def model(self, epsilon: float) -> ObservationModel:
        """Return the model, where the vision error is `epsilon` radians; raises `OptionError`."""
        if self.preset is None:
            start = ObservationModel(sigma=epsilon / EPSILON_OVER_SIGMA)
        else:
            start = PRESETS[self.preset]()
        changes: dict[str, Any] = {}
        for entry in fields(ObservationModel):
            is_angle = entry.name in ANGLES
            option = f"{entry.name}_deg" if is_angle else entry.name
            value = getattr(self, option, None)
            if value is not None:
                changes[entry.name] = _radians(value, option) if is_angle else value
        return replace(start, **changes)


def _radians(degrees: float, option: str) -> float:
    if option == "sigma_deg":
        return math.radians(finite_number(degrees, option, above=0.0, below=180.0))
    if option == "field_of_view_deg":
        return math.radians(finite_number(degrees, option, above=0.0, at_most=360.0))
    return math.radians(finite_number(degrees, option, at_least=0.0, below=180.0))
