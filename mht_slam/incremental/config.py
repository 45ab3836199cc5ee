"""What the incremental estimator assumes and how hard it tries: `SlamConfig`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import get_args

from mht_slam.arrays import finite_number, one_of, whole_number
from mht_slam.errors import OptionError
from mht_slam.models import Motion, ObservationModel
from mht_slam.presets import panoramic_robot


@dataclass(frozen=True)
class SlamConfig:
    """Model and effort of `MultiHypothesisSlam`.

    The model needs a detection probability, a false-alarm rate and an expected number of landmarks:
    associations of different size compete all the time. With motion ``odometry`` its lengths are
    metres, otherwise first baselines.

    Raises `OptionError`, naming the field, for a value out of its range.

    >>> SlamConfig(motion="odometry").observation_model.motion
    'odometry'
    """

    motion: Motion | None = None
    """How poses follow each other; None: as `model` says."""
    model: ObservationModel = field(default_factory=panoramic_robot)
    """Noise, motion, landmarks and detections."""
    hypotheses: int = 10
    """Global hypotheses kept from scan to scan, K."""
    start_hypotheses: int = 100
    """As many while the first `lag` scans are open: before there is a map, much is possible."""
    lag: int = 10
    """Scans whose associations are open; older ones are settled as the best hypothesis says."""
    drop: float = 12.0
    """Hypotheses this many nats below the best are dropped."""
    ranked: int = 3
    """Proposed poses, of each hypothesis, at which more than the best association is tried."""
    depth: int = 6
    """Associations tried there."""
    pair_within: int = 5
    """Scans from the first to the second detection of a landmark, at most."""
    return_probability: float = 0.02
    """Chance that a landmark out of view comes back from one scan to the next."""
    sight: float | None = None
    """Range beyond which no detection is expected, in the model's unit; None: any range."""
    settled: float = 0.3
    """Deviation of its log range below which a landmark enters the committed map."""
    active: int = 15
    """Landmarks of the committed map, besides those of the open scans, that the next scan may see:
    the nearest ones."""
    most_landmarks: int = 1000
    """Landmarks of the committed map; beyond, those unseen for longest are let go. Their detections
    stay in the association, and their places in the smoothed map."""
    familiar: float = 1.0
    """Deviation, in units of the landmarks' spacing and three times over, up to which the place of
    a landmark out of sight is sure enough for single detections to recognise it."""
    loop_odds: float = 6.0
    """Nats of evidence that close a loop, from several landmarks together."""
    twin_odds: float = 1.0
    """Nats of evidence that make one landmark of two in one place."""
    loop_scans: int = 50
    """Scans over which that evidence is gathered: how long a landmark counts as new."""
    loop_every: int = 10
    """Scans between two looks for loops."""
    remaps: int = 0
    """Maps drawn anew in hindsight, from all scans at once: for a yard so full that a start scan
    after scan fails. Each costs about what reading the run in hindsight does."""

    def __post_init__(self) -> None:
        if not isinstance(self.model, ObservationModel):
            raise OptionError(f"model is {self.model!r}: give an ObservationModel")
        if self.motion is not None:
            one_of(self.motion, "motion", get_args(Motion))
        if not self.model.compares_sizes:
            raise OptionError(
                "model leaves out detection_probability, false_alarm_rate or expected_landmarks: "
                "state all three, associations of different size compete here"
            )
        for name in ("hypotheses", "start_hypotheses", "lag", "ranked", "depth", "pair_within"):
            whole_number(getattr(self, name), name, at_least=1)
        for name in ("active", "most_landmarks", "loop_scans", "loop_every"):
            whole_number(getattr(self, name), name, at_least=1)
        whole_number(self.remaps, "remaps", at_least=0)
        finite_number(self.drop, "drop", above=0.0)
        finite_number(self.return_probability, "return_probability", above=0.0, below=1.0)
        for name in ("settled", "familiar", "loop_odds", "twin_odds"):
            finite_number(getattr(self, name), name, above=0.0)
        if self.sight is not None:
            finite_number(self.sight, "sight", above=0.0)

    @cached_property
    def observation_model(self) -> ObservationModel:
        """The model with the motion asked for."""
        return self.model if self.motion is None else replace(self.model, motion=self.motion)
