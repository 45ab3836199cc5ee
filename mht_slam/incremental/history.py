"""What is settled for good: an append-only log of scans, steps, poses and decisions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED, Association
from mht_slam.incremental.branch import Branch, first_detection
from mht_slam.incremental.steps import Step


@dataclass(eq=False)
class History:
    """One entry per scan, the open ones included; owners and poses of committed scans only.

    Attributes
    ----------
    bearings, sigmas : (d,) of each scan.
    times : seconds, NaN where a scan has none.
    steps : before each scan.
    owners : for each committed scan the landmark of each detection, -1 for one on its own, with
        the names of the time; loops rename landmarks later.
    poses : (3,) of each committed scan, as its window had smoothed it when it was committed.
    renamed : landmarks that turned out to be others.
    loops : (scan, landmarks recognised, log odds) of every loop closed.
    tears : scans before which the estimate tore (`mht_slam.incremental.monitor`).
    """

    bearings: list[FloatArray] = field(default_factory=list)
    sigmas: list[FloatArray] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    owners: list[IntArray] = field(default_factory=list)
    poses: list[FloatArray] = field(default_factory=list)
    renamed: dict[int, int] = field(default_factory=dict)
    loops: list[tuple[int, int, float]] = field(default_factory=list)
    tears: list[int] = field(default_factory=list)

    def name(self, number: int) -> int:
        """Return what a landmark is called now."""
        while number in self.renamed:
            number = self.renamed[number]
        return number

    def owners_now(self, open_owners: Sequence[IntArray]) -> list[IntArray]:
        """Owners of all scans by today's names; `open_owners` are those of the window."""
        names = {number: self.name(number) for number in self.renamed}
        return [
            np.array([names.get(number, number) for number in owner.tolist()], np.int64)
            for owner in [*self.owners, *open_owners]
        ]


class SeenApart:
    """How often just one of two landmarks was seen while both were known.

    Parameters
    ----------
    history : the committed scans.
    branches : the hypotheses over the open ones, of which none may see both together.
    """

    def __init__(self, history: History, branches: Sequence[Branch]) -> None:
        self._history, self._branches = history, branches

    def __call__(self, one: int, other: int) -> int | None:
        """Return the number of scans; None where one scan saw both."""
        for branch in self._branches:
            for owner in branch.owners:
                if (owner == one).any() and (owner == other).any():
                    return None
        history = self._history
        first = max(first_detection(one)[0], first_detection(other)[0])
        apart, since, both = 0, 0, set()
        for owner in history.owners[first:]:
            seen = {history.name(number) for number in owner.tolist()} & {one, other}
            if len(seen) == 2:
                return None
            since += len(seen)
            both |= seen
            if len(both) == 2:  # neither has left for good before this scan
                apart, both = apart + since, set(seen)
                since = 0
        return apart


def association_of(owners: Sequence[IntArray]) -> tuple[Association, IntArray]:
    """Return the association that owners by scan stand for, and the landmark of each row.

    Landmarks with a single detection are left out, as are detections on their own: nothing tells
    them from false alarms.
    """
    counts: dict[int, int] = {}
    for owner in owners:
        for number in owner.tolist():
            counts[number] = counts.get(number, 0) + 1
    numbers = sorted(n for n, count in counts.items() if n != MISSED and count > 1)
    row = {number: i for i, number in enumerate(numbers)}
    table = np.full((len(numbers), len(owners)), MISSED, np.int64)
    for scan, owner in enumerate(owners):
        for detection, number in enumerate(owner.tolist()):
            if number in row:
                table[row[number], scan] = detection
    association = Association(table, [len(owner) for owner in owners])
    # `Association` sorts its rows; a row is known by its first detection.
    place = {row.tobytes(): i for i, row in enumerate(association.table)}
    order = np.array([place[table[i].tobytes()] for i in range(len(numbers))], np.int64)
    sorted_numbers = np.empty(len(numbers), np.int64)
    sorted_numbers[order] = numbers
    return association, sorted_numbers
