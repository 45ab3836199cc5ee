"""What an estimator says of a drive, held against the truth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED, Association
from mht_slam.datasets import Drive
from mht_slam.evaluation.agreement import PairCounts, pair_counts, pooled
from mht_slam.evaluation.known_association import DriveEstimate
from mht_slam.evaluation.landmark_maps import matched_by_detections, matched_by_position
from mht_slam.evaluation.trajectories import trajectory_errors

CONFIRMED = 3
"""Detections from which a landmark counts as one."""
NEAR = 0.5
"""Metres, or first steps, within which an estimated landmark is at its place after alignment."""
PART = 100
"""Scans of the parts in which a longer drive is looked at."""


class NotApplicableError(Exception):
    """A drive without what the method rests on, such as odometry: no failure of the method."""


@dataclass(frozen=True)
class Answer:
    """What an estimator says of a drive.

    Attributes
    ----------
    association : over all scans of the drive; None where it forms none.
    poses : (m, 3), or None where it has none.
    landmarks, rows : (n, 2) positions in the frame of the poses, and the association's row of each;
        None without a map.
    """

    association: Association | None
    poses: FloatArray | None = None
    landmarks: FloatArray | None = None
    rows: IntArray | None = None


@dataclass(frozen=True)
class Row:
    """One method on one drive, or on a part of a long one.

    Attributes
    ----------
    part : "" for the whole drive, or "first-last" scans of it.
    common, answered, true : same-landmark pairs in both, of the answer, of the truth.
    answered_labelled : those of the answer but for pairs of two detections without a label.
    position_sim, position_se : trajectory errors after alignment with and without scale.
    heading_deg, scale : after alignment with scale.
    matched, confirmed, true_landmarks : one to one, by detections they share.
    placed, positioned : estimated landmarks at their place, and all that have a position.
    error : what the method raised.
    """

    set_name: str
    half: str
    drive: str
    part: str
    method: str
    option: str
    n_scans: int
    common: int
    answered: int
    true: int
    answered_labelled: int
    position_sim: float = math.nan
    position_se: float = math.nan
    heading_deg: float = math.nan
    scale: float = math.nan
    matched: int = 0
    confirmed: int = 0
    true_landmarks: int = 0
    placed: int = 0
    positioned: int = 0
    seconds: float = math.nan
    error: str = ""
    code: str = ""

    @property
    def counts(self) -> PairCounts:
        """Pairs, to pool."""
        return PairCounts(self.common, self.answered, self.true)

    @property
    def counts_labelled(self) -> PairCounts:
        """Pairs without those of two unlabelled detections."""
        return PairCounts(self.common, self.answered_labelled, self.true)

    @property
    def one_to_one(self) -> bool:
        """Whether confirmed and true landmarks are partners, all of them."""
        return self.matched == self.confirmed == self.true_landmarks

    def to_dict(self) -> dict[str, Any]:
        """Return the cells of a table."""
        return asdict(self)

    @classmethod
    def from_dict(cls, cells: dict[str, str]) -> Row:
        """Read them back; raises `KeyError` or `ValueError` for another table's."""
        types: dict[str, Any] = {"int": int, "float": float, "str": str}
        return cls(**{f.name: types[str(f.type)](cells[f.name]) for f in fields(cls)})


def score(drive: Drive, answer: Answer, **named: Any) -> Iterator[Row]:
    """Yield the row of the drive, and of its parts where it is longer than two of them."""
    truth = drive.truth()
    said = Association([], drive.n_detections) if answer.association is None else answer.association
    yield _row(drive, answer, said, truth, "", named)
    if len(drive) > 2 * PART:
        for first in range(0, len(drive) - PART // 2, PART):
            last = min(first + PART, len(drive)) - 1
            scans = range(first, last + 1)
            inside = Answer(
                said.restrict(scans),
                None if answer.poses is None else answer.poses[first : last + 1],
            )
            piece = drive.part(first, last)
            part = f"{first}-{last}"
            yield _row(piece, inside, said.restrict(scans), truth.restrict(scans), part, named)


def _row(
    drive: Drive,
    answer: Answer,
    said: Association,
    truth: Association,
    part: str,
    named: dict[str, Any],
) -> Row:
    counts, labelled = _pairs(drive, said, truth), _pairs(drive, said, truth, count_false=False)
    cells: dict[str, Any] = {}
    if answer.poses is not None and len(drive.reference_poses):
        sim = trajectory_errors(answer.poses, drive.reference_poses, with_scale=True)
        se = trajectory_errors(answer.poses, drive.reference_poses, with_scale=False)
        cells |= {
            "position_sim": sim.position,
            "position_se": se.position,
            "heading_deg": math.degrees(sim.heading),
            "scale": sim.alignment.scale,
        }
        if answer.landmarks is not None and answer.rows is not None and drive.reference_landmarks:
            seen = np.unique(np.concatenate(drive.identities))
            true = [drive.reference_landmarks[i] for i in seen.tolist() if i != MISSED]
            sizes = (said.table != MISSED).sum(axis=1)
            ours = answer.landmarks[sizes[answer.rows] >= CONFIRMED]
            near = matched_by_position(sim.alignment.points(ours), true, NEAR)
            cells |= {"placed": near.matched, "positioned": near.estimated}
    found = matched_by_detections(said, truth, shortest=CONFIRMED)
    return Row(
        part=part,
        n_scans=len(drive),
        common=counts.common,
        answered=counts.answered,
        true=counts.true,
        answered_labelled=labelled.answered,
        matched=found.matched,
        confirmed=found.estimated,
        true_landmarks=found.true,
        **cells,
        **named,
        drive=drive.name.partition(" scans ")[0] if part else drive.name,
    )


def _pairs(
    drive: Drive, said: Association, truth: Association, *, count_false: bool = True
) -> PairCounts:
    """Pairs within each stretch of the drive in which identities hold."""
    if drive.stretches == ((0, len(drive) - 1),):
        return pair_counts(said, truth, count_false=count_false)
    return pooled(
        pair_counts(
            said.restrict(range(first, last + 1)),
            truth.restrict(range(first, last + 1)),
            count_false=count_false,
        )
        for first, last in drive.stretches or ()
    )


def answer_of(association: Association, estimate: DriveEstimate) -> Answer:
    """Return an association with the graph's poses and landmarks of it."""
    return Answer(association, estimate.poses, estimate.landmarks, estimate.rows)
