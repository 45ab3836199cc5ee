"""How well tracks keep identities: IDF1 over detections, and identity switches."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from mht_slam.arrays import whole_number
from mht_slam.association import MISSED, Association
from mht_slam.errors import AssociationError


class TrackCounts(NamedTuple):
    """Detections that tracks and landmarks have, those they share, and identity switches.

    Attributes
    ----------
    shared : detections that a landmark and its own track have, when every landmark owns at most
        one track and the other way round, so that the sum is greatest.
    tracked : detections in any track.
    true : detections of any landmark.
    switches : how often a landmark's detections go on in another track than before.
    """

    shared: int
    tracked: int
    true: int
    switches: int

    @property
    def idf1(self) -> float:
        """2 shared / (tracked + true); 1.0 where there is nothing to track and nothing tracked."""
        total = self.tracked + self.true
        return 2.0 * self.shared / total if total else 1.0


def track_counts(answer: Association, truth: Association, *, shortest: int = 1) -> TrackCounts:
    """Count what IDF1 and identity switches are made of.

    `shortest` leaves out rows of the answer with fewer detections, as tracks that were never
    confirmed; the truth is taken as it is. Detections of no landmark that are in a track count in
    `tracked`. A switch is counted at each detection of a landmark whose track is another than that
    of the landmark's last tracked detection. Raises `AssociationError` unless both are over the
    same detections. Source: Ristani et al., "Performance Measures and a Data Set for Multi-Target,
    Multi-Camera Tracking" (2016), over detections instead of boxes.

    >>> truth = Association([[0, 0, 0], [1, 1, 1]], (2, 2, 2))
    >>> counts = track_counts(Association([[0, 0, 1], [1, 1, 0]], (2, 2, 2)), truth)
    >>> counts.switches, round(counts.idf1, 3)
    (2, 0.667)
    """
    for name, value in (("answer", answer), ("truth", truth)):
        if not isinstance(value, Association):
            raise AssociationError(f"{name} is {type(value).__name__}: give an Association")
    if answer.n_detections != truth.n_detections:
        raise AssociationError(
            f"the associations are over {answer.n_detections} and {truth.n_detections} detections: "
            "compare associations of the same scans"
        )
    whole_number(shortest, "shortest", at_least=1)
    lengths = (answer.table != MISSED).sum(axis=1)
    mine, theirs = answer.flat_labels(), truth.flat_labels()
    tracked = (mine != MISSED) & np.append(lengths >= shortest, False)[mine]
    both = tracked & (theirs != MISSED)
    common = np.zeros((answer.n_landmarks, truth.n_landmarks), dtype=np.int64)
    np.add.at(common, (mine[both], theirs[both]), 1)
    rows, columns = linear_sum_assignment(common, maximize=True)
    # Scan-major labels: a landmark's tracks follow each other in the order of time.
    tracks_of = (mine[both & (theirs == row)] for row in range(truth.n_landmarks))
    return TrackCounts(
        shared=int(common[rows, columns].sum()),
        tracked=int(tracked.sum()),
        true=int((theirs != MISSED).sum()),
        switches=sum(int((np.diff(tracks) != 0).sum()) for tracks in tracks_of),
    )


def pooled_tracks(counts: Iterable[TrackCounts]) -> TrackCounts:
    """Sum the counts of several runs; their IDF1 is that of all detections together."""
    listed = list(counts)
    return (
        TrackCounts(*(sum(column) for column in zip(*listed, strict=True)))
        if listed
        else (TrackCounts(0, 0, 0, 0))
    )
