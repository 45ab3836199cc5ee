"""What we assume: the observation model behind likelihoods, evidence and simulated scenes.

Formulas and the reasons for the defaults are in ``docs/method.md``.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields

from mht_slam.arrays import finite_number
from mht_slam.errors import OptionError

RUN_FRAME_CENTRE = (0.5, 0.0)
"""Midpoint of the first baseline, in the run's frame."""


@dataclass(frozen=True)
class ObservationModel:
    """Everything assumed about a straight run: noise, motion, landmarks and detections.

    Lengths are in baselines (|O1 O2| = 1), angles in radians. Every result that rests on a model
    prints it, because the landmark prior's scale moves probabilities more than anything else.

    The joint density behind the evidence of an association A with steps r and landmarks x is

        p(Z, A, r, x) ~ p(r) p(headings) prod_landmarks w_l  prod_false false_alarm_rate,
        w_l = expected_landmarks p0(x) prod_seen P_D N(z; h(x), sigma) prod_missed (1 - P_D).

    The last three fields are None unless the caller states them: without them associations of
    different size cannot be compared, and `refine` refuses to.

    Raises `OptionError` naming the field, for a value out of its range.

    >>> import numpy as np
    >>> ObservationModel(sigma=np.deg2rad(1.0)).landmark_sigma
    30.0
    """

    sigma: float
    """Standard deviation of a bearing, radians; a scan's own sigma goes before it."""
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
    detection_probability: float | None = None
    """P_D, the chance that a scan detects a landmark; None leaves misses out of the model."""
    false_alarm_rate: float | None = None
    """Expected false alarms per radian of view; None leaves them out of the model."""
    expected_landmarks: float | None = None
    """Expected number of landmarks under the prior (Poisson); None leaves it out of the model."""

    def __post_init__(self) -> None:
        finite_number(self.sigma, "sigma", above=0.0, below=math.pi)
        finite_number(self.heading_sigma, "heading_sigma", at_least=0.0, below=math.pi)
        finite_number(self.lateral_sigma, "lateral_sigma", at_least=0.0)
        finite_number(self.landmark_sigma, "landmark_sigma", above=0.0)
        if not isinstance(self.landmark_centre, tuple) or len(self.landmark_centre) != 2:
            raise OptionError(f"landmark_centre is {self.landmark_centre!r}: give a tuple (x, y)")
        for axis, value in zip("xy", self.landmark_centre, strict=True):
            finite_number(value, f"landmark_centre {axis}")
        finite_number(self.log_step_mean, "log_step_mean")
        finite_number(self.log_step_sigma, "log_step_sigma", above=0.0)
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
            if entry.name in ("sigma", "heading_sigma"):
                parts.append(f"{entry.name}={math.degrees(value):g} deg")
            elif isinstance(value, tuple):
                parts.append(f"{entry.name}=({value[0]:g}, {value[1]:g})")
            else:
                parts.append(f"{entry.name}={value if value is None else f'{value:g}'}")
        return ", ".join(parts)

    def to_dict(self) -> dict[str, float | tuple[float, float] | None]:
        """Return the fields as they are, for a results file."""
        return asdict(self)
