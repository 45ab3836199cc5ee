"""What we assume: the observation model behind likelihoods, evidence and simulated scenes.

Formulas and the reasons for the defaults are in ``docs/method.md``.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from typing import Literal, TypeAlias, get_args

from mht_slam.arrays import finite_number, one_of
from mht_slam.errors import OptionError
from mht_slam.measurements import SMALLEST_SIGMA

Motion: TypeAlias = Literal["straight", "smooth", "odometry", "free"]

RUN_FRAME_CENTRE = (0.5, 0.0)
"""Midpoint of the first baseline, in the run's frame."""
ANGLES = ("sigma", "heading_sigma", "turn_sigma", "drift_sigma", "field_of_view")
"""The fields that are angles: radians in the model, degrees where it is printed."""


@dataclass(frozen=True)
class ObservationModel:
    """Everything assumed about a run: noise, motion, landmarks and detections.

    Lengths are in baselines (|O1 O2| = 1), angles in radians. Every result that rests on a model
    prints it, because the landmark prior's scale moves probabilities more than anything else.

    The joint density behind the evidence of an association A with steps r and landmarks x is

        p(Z, A, r, x) ~ p(r) p(headings) prod_landmarks w_l  prod_false false_alarm_rate,
        w_l = expected_landmarks p0(x) V(seen) prod_seen N(z; h(x), sigma).

    V is the chance of being detected in just these scans. With `stay_probability` 1, every landmark
    is there in every scan and V = prod_seen P_D prod_missed (1 - P_D). Below 1 a landmark comes
    into view and leaves it for good, hidden by something or too far away: it stays from one scan to
    the next with that probability, and as many come as leave, so that `expected_landmarks` are in
    view at any time (`mht_slam.evidence.visibility`). Outside `field_of_view` nothing is detected.

    The motion models, from strict to free, each with the fields that belong to it:

    - ``straight``: one line and one heading, unknown steps; `heading_sigma`, `lateral_sigma`,
      `log_step_mean`, `log_step_sigma`.
    - ``smooth``: each motion resembles the one before; `turn_sigma`, `drift_sigma`,
      `step_change_sigma`, `stops`.
    - ``odometry``: as the scans' odometry says, in metres.
    - ``free``: each pose lies somewhere about the one before, within `log_step_sigma` of the first
      baseline in length and with any direction and heading.

    `detection_probability`, `false_alarm_rate` and `expected_landmarks` are None unless the caller
    states them: without them associations of different size cannot be compared, and `refine`
    refuses to.

    Raises `OptionError` naming the field, for a value out of its range.

    >>> import numpy as np
    >>> ObservationModel(sigma=np.deg2rad(1.0)).landmark_sigma
    30.0
    """

    sigma: float
    """Standard deviation of a bearing, radians; a scan's own sigma goes before it."""
    bearing_dof: float | None = None
    """Degrees of freedom of Student's t of scale `sigma`, for heavy tails; None: Gaussian."""
    motion: Motion = "straight"
    """How poses follow each other."""
    heading_sigma: float = 0.0
    """Independent deviation of each heading from the direction of travel, radians."""
    lateral_sigma: float = 0.0
    """Deviation of scans 3 and later from the line through O1 and O2, baselines."""
    landmark_sigma: float = 30.0
    """Standard deviation per axis of the isotropic Gaussian landmark prior, baselines."""
    landmark_centre: tuple[float, float] = RUN_FRAME_CENTRE
    """Centre of the landmark prior in the run's frame, baselines."""
    log_step_mean: float = 0.0
    """Mean of ln(|O_k O_k+1| / |O1 O2|)."""
    log_step_sigma: float = 1.0
    """Standard deviation of ln(|O_k O_k+1| / |O1 O2|)."""
    turn_sigma: float = math.radians(3.0)
    """Change of heading from one scan to the next, radians (``smooth``)."""
    drift_sigma: float = math.radians(5.0)
    """Angle between a step and the heading at its start, radians (``smooth``)."""
    step_change_sigma: float = 0.2
    """Standard deviation of ln(next step / step) (``smooth``)."""
    stops: bool = False
    """Whether the robot may stand still: scans whose bearings did not change are taken at one place
    (``smooth``)."""
    detection_probability: float | None = None
    """P_D, the chance that a landmark in view is detected; None leaves misses out of the model."""
    false_alarm_rate: float | None = None
    """Expected false alarms per radian of view; None leaves them out of the model."""
    expected_landmarks: float | None = None
    """Expected number of landmarks in view (Poisson); None leaves it out of the model."""
    stay_probability: float = 1.0
    """Chance that a landmark in view of one scan is still in view of the next."""
    field_of_view: float = 2.0 * math.pi
    """Full angle, centred on the heading, that the sensor sees, radians."""

    def __post_init__(self) -> None:
        finite_number(self.sigma, "sigma", at_least=SMALLEST_SIGMA, below=math.pi)
        if self.bearing_dof is not None:
            finite_number(self.bearing_dof, "bearing_dof", above=0.0)
        one_of(self.motion, "motion", get_args(Motion))
        if not isinstance(self.stops, bool):
            raise OptionError(f"stops is {self.stops!r}: give True or False")
        finite_number(self.heading_sigma, "heading_sigma", at_least=0.0, below=math.pi)
        finite_number(self.lateral_sigma, "lateral_sigma", at_least=0.0)
        finite_number(self.landmark_sigma, "landmark_sigma", above=0.0)
        if not isinstance(self.landmark_centre, tuple) or len(self.landmark_centre) != 2:
            raise OptionError(f"landmark_centre is {self.landmark_centre!r}: give a tuple (x, y)")
        for axis, value in zip("xy", self.landmark_centre, strict=True):
            finite_number(value, f"landmark_centre {axis}")
        finite_number(self.log_step_mean, "log_step_mean")
        finite_number(self.log_step_sigma, "log_step_sigma", above=0.0)
        finite_number(self.turn_sigma, "turn_sigma", above=0.0, below=math.pi)
        finite_number(self.drift_sigma, "drift_sigma", above=0.0, below=math.pi)
        finite_number(self.step_change_sigma, "step_change_sigma", above=0.0)
        finite_number(self.stay_probability, "stay_probability", above=0.0, at_most=1.0)
        finite_number(self.field_of_view, "field_of_view", above=0.0, at_most=2.0 * math.pi)
        if self.detection_probability is not None:
            finite_number(
                self.detection_probability, "detection_probability", above=0.0, at_most=1.0
            )
        if self.false_alarm_rate is not None:
            finite_number(self.false_alarm_rate, "false_alarm_rate", at_least=0.0)
        if self.expected_landmarks is not None:
            finite_number(self.expected_landmarks, "expected_landmarks", above=0.0)

    @property
    def compares_sizes(self) -> bool:
        """Whether associations of different size are comparable under this model."""
        return None not in (
            self.detection_probability,
            self.false_alarm_rate,
            self.expected_landmarks,
        )

    def describe(self) -> str:
        """Return one line that names every assumption, angles in degrees."""
        parts = []
        for entry in fields(self):
            value = getattr(self, entry.name)
            if isinstance(value, str):
                parts.append(f"{entry.name}={value}")
            elif entry.name in ANGLES:
                parts.append(f"{entry.name}={math.degrees(value):g} deg")
            elif isinstance(value, tuple):
                parts.append(f"{entry.name}=({value[0]:g}, {value[1]:g})")
            else:
                parts.append(f"{entry.name}={value if value is None else f'{value:g}'}")
        return ", ".join(parts)

    def to_dict(self) -> dict[str, float | str | tuple[float, float] | None]:
        """Return the fields as they are, for a results file."""
        return asdict(self)
