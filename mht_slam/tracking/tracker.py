"""`OrderTracker`: scan by scan, which detections of a dense run are one landmark."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from mht_slam.arrays import FloatArray, IntArray, freeze, whole_number
from mht_slam.association import MISSED, Association
from mht_slam.errors import MeasurementError, OptionError
from mht_slam.measurements import BearingScan
from mht_slam.tracking.grouping import regrouped
from mht_slam.tracking.kept_order import next_order
from mht_slam.tracking.options import TrackerConfig
from mht_slam.tracking.readings import (
    Group,
    Reading,
    agreeing,
    extended,
    identity_risk,
    likely,
    merged,
    split,
    still_right,
)
from mht_slam.tracking.scan_step import ScanStep
from mht_slam.tracking.tracks import Track

TURN_MEMORY = 0.5
"""Share of the last turn that the next one is expected to have."""


class OrderTracker:
    """Keep the identities of landmarks through scans so dense that bearings change little.

    Parameters
    ----------
    config : assumptions and effort; the defaults suit a panoramic camera at .1 m a scan.

    Every track predicts its bearing from the last ones: the robot goes ahead by about the same step
    in every scan, and what all bearings do in common is its turn. The bearings of a scan are
    matched with all tracks at once. Where more than one matching is likely - landmarks that cross,
    or only come near each other - the best few readings are kept side by side, apart for every
    ambiguity, until later scans or the end of a window decide. With ``mode="paper"`` identities
    follow the visual order by the paper's rule alone. Source: the paper's section 2;
    docs/method.md, section 6.

    >>> tracker = OrderTracker()
    >>> for k in range(4):
    ...     _ = tracker.update(BearingScan([0.5 + 0.01 * k, 2.0 + 0.02 * k]))
    >>> tracker.association.table.tolist()
    [[0, 0, 0, 0], [1, 1, 1, 1]]
    """

    def __init__(self, config: TrackerConfig | None = None) -> None:
        if config is not None and not isinstance(config, TrackerConfig):
            raise OptionError(f"config is {type(config).__name__}: give a TrackerConfig")
        self._config = config or TrackerConfig()
        self._n_detections: list[int] = []
        self._groups: list[Group] = []
        self._order: list[Track] = []
        self._ended: list[Track] = []
        self._shift = 0.0
        self._next_track = 0
        self._certainty: dict[int, float] = {}

    @property
    def config(self) -> TrackerConfig:
        """What it assumes."""
        return self._config

    def update(self, scan: BearingScan) -> IntArray:
        """Read the next scan.

        Returns the (n_detections,) number of the track that each detection continues or begins, as
        far as can be told by now; later scans may tell better, so read `association` in the end.
        Raises `MeasurementError` for anything but a scan, and `OptionError` for a scan with known
        identities, of which the tracker knows nothing.
        """
        if not isinstance(scan, BearingScan):
            raise MeasurementError(f"scan is {type(scan).__name__}: give a BearingScan")
        number = len(self._n_detections)
        if any(label is not None for label in scan.labels or ()):
            raise OptionError(f"scan {number} has labels: give bearings alone")
        general = self._config.mode == "general"
        step = ScanStep(
            number,
            scan,
            [t for group in self._groups for r in group for t in r.tracks] + self._order,
            [t for group in self._groups for t in group[0].tracks] + self._order,
            TURN_MEMORY * self._shift,
            self._next_track,
            self._config,
        )
        if general:
            self._read(step)
        else:
            self._order, ended = next_order(self._order, step)
            self._ended += ended
        self._n_detections.append(len(scan))
        self._shift, self._next_track = step.shift, step.next_track
        numbers = np.full(len(scan), MISSED, dtype=np.int64)
        for track in self._likeliest():
            if track.scan == number and track.detection != MISSED:
                numbers[track.detection] = track.number
        return freeze(numbers)

    @property
    def association(self) -> Association:
        """What is one landmark, over all scans so far, in the most probable reading.

        Tracks of fewer than `confirm` detections are taken for false alarms.
        """
        return Association([row for row, _ in self._rows()], self._n_detections)

    @property
    def track_probabilities(self) -> FloatArray:
        """(n_landmarks,) for each row of `association` how probable its identity is.

        That is the probability that the track's latest detection and its first are one landmark,
        among the readings kept side by side: whenever a decision became final, the weight of the
        readings given up in which that detection belongs to another track counts against it. A
        detection lent to a neighbour in between does not. Two doubtful exchanges may undo each
        other, so that long doubt between two landmarks ends at one half. With ``mode="paper"``,
        which keeps one reading, all are 1.
        """
        certainty = {tuple(row): probability for row, probability in self._rows()}
        rows = self.association.table.tolist()
        return freeze(np.array([certainty[tuple(row)] for row in rows], dtype=np.float64))

    def alternatives(self, most: int) -> tuple[Association, ...]:
        """The most probable readings of all scans so far, the best first, at most `most`.

        They differ in who is who since the last decisions: within `window` scans, and there only by
        what is not `drop` nats worse than the best. Raises `OptionError` for less than one.
        """
        whole_number(most, "most", at_least=1)
        decided = [*self._ended, *self._order]
        joint = merged(self._groups, most) if self._groups else [Reading(0.0, ())]
        found = {
            Association(self._table([*decided, *reading.all_tracks]), self._n_detections): None
            for reading in joint
        }
        return tuple(found)

    def _read(self, step: ScanStep) -> None:
        groups: list[Group] = []
        for group, detections in regrouped(self._groups, step, self._config):
            readings = likely(extended(group, detections, step, self._config), self._config)
            after = agreeing(readings, step.number, self._config)
            for number, risk in identity_risk(readings, after).items():
                self._certainty[number] = still_right(self._certainty.get(number, 1.0), risk)
            parts, ended = split(after)
            groups += parts
            self._ended += ended
        self._groups = groups

    def _likeliest(self) -> Iterator[Track]:
        yield from self._ended
        yield from self._order
        for group in self._groups:
            yield from group[0].all_tracks

    def _rows(self) -> list[tuple[list[int], float]]:
        """Row of the table and probability of every confirmed track."""
        doubt: dict[int, float] = {}
        for group in self._groups:
            doubt.update(identity_risk(group, group[:1]))
        tracks = [t for t in self._likeliest() if t.n_seen >= self._config.confirm]
        sure = [
            still_right(self._certainty.get(t.number, 1.0), doubt.get(t.number, 0.0))
            for t in tracks
        ]
        return list(zip(self._table(tracks), sure, strict=True))

    def _table(self, tracks: Iterable[Track]) -> list[list[int]]:
        """Detections of the confirmed tracks by scan."""
        table = []
        for track in tracks:
            if track.n_seen >= self._config.confirm:
                row = [MISSED] * len(self._n_detections)
                for scan, detection in track.detections().items():
                    row[scan] = detection
                table.append(row)
        return table
