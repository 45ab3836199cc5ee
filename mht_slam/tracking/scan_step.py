"""One scan against all tracks: predictions, what a match gains, and each outcome once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.association import MISSED
from mht_slam.measurements import BearingScan, wrap_angle
from mht_slam.tracking.options import TrackerConfig
from mht_slam.tracking.tracks import Prediction, Track, begin, carry_on, miss, see, turned
from mht_slam.tracking.turn import common_shift


class ScanStep:
    """The tracks of all readings, carried on to one scan.

    Readings share tracks, and a track with the same detection in two readings stays one object:
    that is how readings are seen to agree.

    Parameters
    ----------
    number : of the scan.
    tracks : every track of every reading; the `likeliest` of them tell the robot's turn.
    expected_shift : the shift of all bearings that the robot's last turn lets one expect.
    next_track : number of the first track that begins at this scan.
    """

    def __init__(
        self,
        number: int,
        scan: BearingScan,
        tracks: Sequence[Track],
        likeliest: Sequence[Track],
        expected_shift: float,
        next_track: int,
        config: TrackerConfig,
    ) -> None:
        self.number = number
        self.bearings = scan.bearings
        self.variances = (config.sigma if scan.sigma is None else scan.sigma) ** 2 * np.ones(
            len(scan)
        )
        self._config = config
        self._next_track = next_track
        self._outcomes: dict[tuple[int, int], Track] = {}
        self._begun: dict[int, Track] = {}
        straight = {id(track): carry_on(track, config) for track in tracks}
        self.shift = common_shift(
            [straight[id(track)] for track in likeliest],
            self.bearings,
            self.variances,
            expected_shift,
            config,
        )
        self._predictions = {key: turned(p, self.shift) for key, p in straight.items()}
        self._row = {key: row for row, key in enumerate(self._predictions)}
        self._gains, self._log_missed = self._weigh(list(self._predictions.values()))

    @property
    def next_track(self) -> int:
        """Number of the first track that begins after this scan."""
        return self._next_track

    def gains(self, tracks: Sequence[Track]) -> FloatArray:
        """(tracks, detections) log of a match over track and detection alone; none is below 0."""
        return self._gains[[self._row[id(track)] for track in tracks]]

    def log_missed(self, tracks: Sequence[Track]) -> float:
        """Log probability that none of the tracks is seen."""
        return float(self._log_missed[[self._row[id(track)] for track in tracks]].sum())

    def predicted_bearing(self, track: Track) -> float:
        """Bearing at which the track is expected."""
        return float(self._predictions[id(track)].mean[0])

    def after(self, track: Track, detection: int) -> Track:
        """Return the track with this detection, or without any for -1."""
        key = id(track), detection
        if key not in self._outcomes:
            prediction = self._predictions[id(track)]
            self._outcomes[key] = (
                miss(prediction, self.number, self._config)
                if detection == MISSED
                else see(
                    prediction,
                    self.number,
                    detection,
                    float(self.bearings[detection]),
                    float(self.variances[detection]),
                )
            )
        return self._outcomes[key]

    def begun(self, detection: int) -> Track:
        """Return the track that begins at this detection."""
        if detection not in self._begun:
            self._begun[detection] = begin(
                self._next_track,
                self.number,
                detection,
                float(self.bearings[detection]),
                float(self.variances[detection]),
                self._config,
            )
            self._next_track += 1
        return self._begun[detection]

    def _weigh(self, predictions: Sequence[Prediction]) -> tuple[FloatArray, FloatArray]:
        config = self._config
        chance = config.detection_probability * np.array([p.existence for p in predictions])
        bearings = np.array([p.mean[0] for p in predictions])
        spread = np.array([p.covariance[0, 0] for p in predictions])[:, None] + self.variances
        off = wrap_angle(self.bearings - bearings[:, None])
        log_density = -0.5 * off**2 / spread - 0.5 * np.log(2.0 * np.pi * spread)
        odds = np.log(chance / (1.0 - chance))[:, None] - np.log(config.unassigned_rate)
        return np.maximum(odds + log_density, 0.0), np.log1p(-chance)
