"""One track: a Kalman filter on bearing, nearness and offset, its existence, and its history."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from filterpy.kalman import predict, update

from mht_slam.arrays import FloatArray
from mht_slam.association import MISSED
from mht_slam.tracking.options import TrackerConfig

OBSERVATION = np.array([[1.0, 0.0, 0.0]])

FIRST_EXISTENCE = 0.5
"""Chance that a detection which continues no track is a landmark.

Not ``new_rate / unassigned_rate``: that counts landmarks that come into view, and those of the
first scan, or found again after many misses, were in view. Dense runs cannot tell the two apart.
"""
GONE = 0.005
"""A track that is there with less than this chance has ended."""
SMALLEST_NOISE = 1e-3
"""What prediction adds at least to bearing and nearness, so that no filter freezes."""
CLOSEST = 1e-2
"""Predictions take no landmark for closer than this share of a step."""
HEAD_ON = 0.2
"""Predictions bring no landmark of unknown range nearer than this: five steps."""
UNKNOWN = 0.3
"""A range is unknown whose nearness has more than this share of itself as standard deviation."""


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """What is known of one track after one scan, and through `parent` after all before.

    Attributes
    ----------
    number : tracks are numbered as they begin.
    scan, detection : the scan, and the track's detection in it or -1.
    mean, covariance : (3,) bearing in the robot frame, nearness and offset, and (3, 3) of them. The
        rate of the bearing is nearness times its sine, besides the robot's turn; the offset is what
        the turn is estimated wrong by, scan after scan.
    existence : the chance that there is a landmark in view to be seen.
    n_seen : number of its detections.
    last_seen : (scan, detection) of its latest detection.
    parent : the track one scan earlier, or None.
    """

    number: int
    scan: int
    detection: int
    mean: FloatArray
    covariance: FloatArray
    existence: float
    n_seen: int
    last_seen: tuple[int, int]
    parent: Track | None

    @property
    def has_ended(self) -> bool:
        """Whether nothing is left to be seen of it."""
        return self.existence < GONE

    def detections(self) -> dict[int, int]:
        """Its detections by scan, the latest first."""
        found = {}
        at: Track | None = self
        while at is not None:
            if at.detection != MISSED:
                found[at.scan] = at.detection
            at = at.parent
        return found


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """A track carried on to the next scan, where it is seen or missed."""

    track: Track
    mean: FloatArray
    covariance: FloatArray
    existence: float


def begin(
    number: int, scan: int, detection: int, bearing: float, variance: float, config: TrackerConfig
) -> Track:
    """Start a track at a detection, which may be a new landmark or a false alarm."""
    return Track(
        number=number,
        scan=scan,
        detection=detection,
        mean=np.array([bearing, config.nearness, 0.0]),
        covariance=np.diag(
            [variance, config.nearness_sigma**2, config.turn_error_sigma**2],
        ),
        existence=FIRST_EXISTENCE,
        n_seen=1,
        last_seen=(scan, detection),
        parent=None,
    )


def carry_on(track: Track, config: TrackerConfig) -> Prediction:
    """Predict the track after one more step straight ahead, before the robot's turn.

    In units of the step, the landmark at range 1/w and bearing b moves back by one: the filter is
    that of the exact motion, linearised. The offset goes on as it is. Source: docs/method.md,
    sections 2 and 6.
    """
    bearing, nearness, offset = track.mean.tolist()
    cosine, sine = math.cos(bearing), math.sin(bearing)
    squared = max(1.0 - 2.0 * nearness * cosine + nearness**2, CLOSEST**2)
    closing = 1.0 / math.sqrt(squared)
    ahead = math.atan2(sine, cosine - nearness)
    moved = np.array([ahead + offset, nearness * closing, offset])
    jacobian = np.array(
        [
            [(1.0 - nearness * cosine) / squared, sine / squared, 1.0],
            [
                -(nearness**2) * sine * closing**3,
                closing + nearness * (cosine - nearness) * closing**3,
                0.0,
            ],
            [0.0, 0.0, 1.0],
        ]
    )
    spread = math.sqrt(float(track.covariance[1, 1]))
    if spread > UNKNOWN * abs(nearness) and moved[1] > max(nearness, HEAD_ON):
        # Straight ahead bearings tell no range: that a landmark has been passed must be seen.
        moved[1] = max(nearness, HEAD_ON)
        jacobian[1] = 0.0, 1.0, 0.0
    size = abs(nearness) + spread
    noise = np.diag(
        [
            (config.drift_sigma * size) ** 2 + SMALLEST_NOISE**2,
            (config.step_change_sigma * size) ** 2 + SMALLEST_NOISE**2,
            0.0,
        ]
    )
    # The filter's prediction is linear; the control moves its mean onto the exact one.
    mean, covariance = predict(
        track.mean, track.covariance, F=jacobian, Q=noise, u=moved - jacobian @ track.mean
    )
    return Prediction(track, mean, covariance, config.stay_probability * track.existence)


def turned(prediction: Prediction, turn: float) -> Prediction:
    """Shift the predicted bearing, which stays within half a turn of zero."""
    mean = prediction.mean.copy()
    mean[0] = math.remainder(float(mean[0]) + turn, math.tau)
    return Prediction(prediction.track, mean, prediction.covariance, prediction.existence)


def see(
    prediction: Prediction, scan: int, detection: int, bearing: float, variance: float
) -> Track:
    """Update the track with a detection of a scan."""
    before = prediction.track
    predicted = float(prediction.mean[0])
    # Of all whole turns the nearest, so that the filter knows no seam.
    unwrapped = predicted + math.remainder(bearing - predicted, math.tau)
    mean, covariance = update(
        prediction.mean, prediction.covariance, unwrapped, np.array([[variance]]), OBSERVATION
    )
    return Track(
        number=before.number,
        scan=scan,
        detection=detection,
        mean=np.array([math.remainder(float(mean[0]), math.tau), mean[1], mean[2]]),
        covariance=covariance,
        existence=1.0,
        n_seen=before.n_seen + 1,
        last_seen=(scan, detection),
        parent=before,
    )


def miss(prediction: Prediction, scan: int, config: TrackerConfig) -> Track:
    """Carry the track through a scan that does not see it."""
    before = prediction.track
    unseen = prediction.existence * (1.0 - config.detection_probability)
    return Track(
        number=before.number,
        scan=scan,
        detection=MISSED,
        mean=prediction.mean,
        covariance=prediction.covariance,
        existence=unseen / (1.0 - prediction.existence + unseen),
        n_seen=before.n_seen,
        last_seen=before.last_seen,
        parent=before,
    )
