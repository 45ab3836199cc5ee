"""What the robot sees: a bearing sensor with noise, limits, misses, false alarms and occlusion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray, finite_number, freeze
from mht_slam.association import MISSED
from mht_slam.errors import OptionError
from mht_slam.measurements import BearingScan, wrap_angle
from mht_slam.models import ObservationModel

NoiseKind: TypeAlias = Literal["uniform", "gaussian", "heavy_tailed"]

STUDENT_T_DOF = 3.0
"""Default degrees of freedom of heavy-tailed noise: finite variance, about 1.7 times its scale."""

_STRICTLY_INSIDE = 1.0 - 1e-9


@dataclass(frozen=True)
class Observation:
    """A scan, and which landmark each detection is.

    Attributes
    ----------
    scan : the detections, in random order.
    landmark_of_detection : (n_detections,) index of the landmark, -1 for a false alarm.
    """

    scan: BearingScan
    landmark_of_detection: IntArray


@dataclass(frozen=True)
class Sensor:
    """A bearing sensor. Angles are radians, lengths the unit of the world it looks at.

    Raises `OptionError` naming the field, for a value out of its range.
    """

    spread: float
    """Size of the noise, radians: the bound epsilon of uniform noise (never reached), the standard
    deviation of Gaussian noise, the scale of heavy-tailed noise."""
    noise: NoiseKind = "gaussian"
    """Uniform inside +-spread, Gaussian, or Student's t with `dof`."""
    field_of_view: float = 2.0 * math.pi
    """Full width of the view, centred on forward; a landmark's true bearing decides."""
    min_range: float = 0.0
    """Landmarks nearer than this are not seen."""
    max_range: float = math.inf
    """Landmarks farther than this are not seen."""
    detection_probability: float = 1.0
    """Chance that a landmark in view is detected."""
    false_alarm_rate: float = 0.0
    """Expected false alarms per radian of view: Poisson in number, uniform over the view."""
    landmark_radius: float = 0.0
    """A landmark hides the farther ones whose bearing its disc of this radius covers."""
    dof: float = STUDENT_T_DOF
    """Degrees of freedom of heavy-tailed noise."""

    def __post_init__(self) -> None:
        if self.noise not in get_args(NoiseKind):
            raise OptionError(f"noise is {self.noise!r}: give one of {get_args(NoiseKind)}")
        finite_number(self.spread, "spread", at_least=0.0, below=math.pi)
        finite_number(self.field_of_view, "field_of_view", above=0.0, at_most=2.0 * math.pi)
        finite_number(self.min_range, "min_range", at_least=0.0)
        if self.max_range != math.inf:
            finite_number(self.max_range, "max_range", above=self.min_range)
        finite_number(self.detection_probability, "detection_probability", at_least=0.0, at_most=1)
        finite_number(self.false_alarm_rate, "false_alarm_rate", at_least=0.0)
        finite_number(self.landmark_radius, "landmark_radius", at_least=0.0)
        finite_number(self.dof, "dof", above=0.0)

    @classmethod
    def of_model(cls, model: ObservationModel) -> Sensor:
        """Return the sensor that an `ObservationModel` assumes.

        Detection terms that the model leaves out become "always detected" and "no false alarms".
        Which landmarks are there at all (`stay_probability`) is not the sensor's.
        """
        stated = model.detection_probability
        return cls(
            spread=model.sigma,
            noise="gaussian" if model.bearing_dof is None else "heavy_tailed",
            dof=STUDENT_T_DOF if model.bearing_dof is None else model.bearing_dof,
            field_of_view=model.field_of_view,
            detection_probability=1.0 if stated is None else stated,
            false_alarm_rate=model.false_alarm_rate or 0.0,
        )

    def observe(
        self, pose: FloatArray, landmarks: FloatArray, rng: np.random.Generator
    ) -> Observation:
        """Look at `landmarks` (n, 2) from `pose` (x, y, theta), in one frame; theta in radians.

        A bearing is the angle of the landmark in the robot frame, counter-clockwise from forward,
        plus noise. The order of the detections is random and tells nothing.
        """
        bearings, ranges = bearings_and_ranges(pose, landmarks)
        seen = np.flatnonzero(
            self.visible(bearings, ranges)
            & (rng.random(len(landmarks)) < self.detection_probability)
        )
        # One draw per landmark, seen or not, keeps scenes of one seed comparable across sensors.
        noisy = (bearings + self._draw_noise(len(landmarks), rng))[seen]
        false = self._draw_false_alarms(rng)
        order = rng.permutation(len(noisy) + len(false))
        labels = np.concatenate([seen, np.full(len(false), MISSED)]).astype(np.int64)
        return Observation(
            scan=BearingScan(np.concatenate([noisy, false])[order]),
            landmark_of_detection=freeze(labels[order]),
        )

    def visible(self, bearings: FloatArray, ranges: FloatArray) -> BoolArray:
        """Which landmarks at these true bearings and ranges, (n,), are in view and not hidden."""
        return self._in_view(bearings, ranges) & ~self._hidden(bearings, ranges)

    def _in_view(self, bearings: FloatArray, ranges: FloatArray) -> BoolArray:
        in_angle = np.abs(bearings) <= 0.5 * self.field_of_view
        in_range = (ranges >= self.min_range) & (ranges <= self.max_range)
        return np.asarray(in_angle & in_range, dtype=np.bool_)

    def _hidden(self, bearings: FloatArray, ranges: FloatArray) -> BoolArray:
        """Which landmarks lie behind the disc of a nearer one."""
        if self.landmark_radius == 0.0:
            return np.zeros(len(ranges), dtype=np.bool_)
        # Seen from inside its disc, a landmark covers half of the circle.
        half_width = np.arcsin(self.landmark_radius / np.maximum(ranges, self.landmark_radius))
        apart = np.abs(wrap_angle(bearings[:, None] - bearings))
        covers = (ranges[:, None] > ranges) & (apart < half_width)
        return np.asarray(covers.any(axis=1), dtype=np.bool_)

    def _draw_noise(self, n: int, rng: np.random.Generator) -> FloatArray:
        if self.noise == "uniform":
            return self.spread * _STRICTLY_INSIDE * rng.uniform(-1.0, 1.0, n)
        if self.noise == "gaussian":
            return self.spread * rng.standard_normal(n)
        return self.spread * rng.standard_t(self.dof, n)

    def _draw_false_alarms(self, rng: np.random.Generator) -> FloatArray:
        count = rng.poisson(self.false_alarm_rate * self.field_of_view)
        return 0.5 * self.field_of_view * rng.uniform(-1.0, 1.0, count)


def bearings_and_ranges(pose: FloatArray, landmarks: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Noiseless bearings, radians in (-pi, pi] in the robot frame, and ranges, both (n,)."""
    away = landmarks - pose[:2]
    bearings = wrap_angle(np.arctan2(away[:, 1], away[:, 0]) - pose[2])
    return bearings, np.hypot(away[:, 0], away[:, 1])
