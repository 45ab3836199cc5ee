"""Does the estimate still know where it is: what recent scans do not explain, and where it tore."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import IntArray
from mht_slam.association import MISSED
from mht_slam.incremental.motion_terms import ODOMETRY, STILL
from mht_slam.incremental.steps import Step

SCANS = 8
"""Scans judged together."""
FRESH = 2
"""Newest scans left out: a landmark seen once is nothing yet."""
FEWEST = 8
"""Detections in these scans below which nothing is said."""
KNOWN = 3
"""Detections that make a landmark: random bearings meet in pairs, seldom in threes."""
LOST, FOUND = 0.6, 0.35
"""Share of unexplained detections above which the robot is lost, and below which it is found."""
FEWEST_IN_SIGHT = 5
"""Landmarks in sight below which nothing can tear; as many detections of others have to follow."""
CONTINUES = 3 / 8
"""Share of the landmarks in sight that are seen again, at most, where the estimate tears."""
OPENING = 4.0
"""By how much a lost robot's steps may deviate more."""
TORN = 30.0
"""By how much the steps across a tear may have deviated more."""


@dataclass(frozen=True)
class Monitor:
    """Whether recent scans agree with the map.

    There are two signs that they do not.

    - Most detections belong to no landmark, which is a single one or one of a mere pair. False
      alarms and what is seen in passing stay unexplained in good times too, but they are few.
    - The estimate *tears*: of the landmarks in sight just before a scan, few are seen in it or in
      the next `FRESH` ones, which mostly see others instead. Landmarks leave one by one; all give
      way to others together when the robot was carried away, when its odometer lied, or behind a
      wall. A sensor that reads nothing for a while, or two landmarks of eight, tears nothing: what
      it still sees is where it was. Beyond the tear a new map grows, and its own scans alone say
      when the robot is found again.

    Only open scans are judged: with a `SlamConfig.lag` of `FRESH` or less nobody is ever lost.

    Attributes
    ----------
    is_lost : now.
    unexplained : share of the detections in recent scans.
    whole_for : scans judged since the last tear.
    """

    is_lost: bool = False
    unexplained: float = 0.0
    whole_for: int = SCANS

    @property
    def tears(self) -> bool:
        """Whether the estimate tore before the newest scan judged."""
        return self.whole_for == 0

    def after(self, owners: Sequence[IntArray], settled: IntArray) -> Monitor:
        """Return the judgement with one scan more.

        `owners` are those of the open scans, `settled` the numbers of landmarks that scans settled
        before have seen.
        """
        known = set(settled.tolist())
        counts = Counter(number for owner in owners for number in owner.tolist())
        known |= {number for number, count in counts.items() if count >= KNOWN}
        known.discard(MISSED)
        whole_for = min(self.whole_for + 1, SCANS)
        if whole_for > FRESH and _tears(owners, set(settled.tolist())):
            whole_for = 0
        judged = owners[-min(whole_for + 1, SCANS) - FRESH : -FRESH]
        everything = np.concatenate(judged) if judged else np.empty(0, np.int64)
        share, is_lost = 0.0, self.is_lost
        if len(everything) >= FEWEST:
            share = sum(number not in known for number in everything.tolist()) / len(everything)
            is_lost = share > (FOUND if self.is_lost else LOST)
        return Monitor(is_lost or whole_for == 0, share, whole_for)


def _tears(owners: Sequence[IntArray], settled: set[int]) -> bool:
    """Whether others took the place of the landmarks in sight before the newest scan judged."""
    before, after = owners[: -FRESH - 1], owners[-FRESH - 1 :]
    counts = Counter(number for owner in before for number in owner.tolist())
    known = settled | {number for number, count in counts.items() if count >= KNOWN}
    in_sight = {number for owner in before[-FRESH:] for number in owner.tolist()} & known
    in_sight.discard(MISSED)
    seen = [number for owner in after for number in owner.tolist()]
    again = [number for number in seen if number in in_sight]
    others = len(seen) - len(again)
    return (
        len(in_sight) >= FEWEST_IN_SIGHT
        and len(set(again)) <= CONTINUES * len(in_sight)
        and others >= FEWEST_IN_SIGHT
        and others > len(again)
    )


def opened(step: Step, factor: float = OPENING) -> Step:
    """Return a step whose deviations are `factor` times as large."""
    parameters = step.parameters.copy()
    if step.kind == ODOMETRY:
        parameters[3:12] /= factor
    elif step.kind != STILL:
        parameters[:3] *= factor
    return Step(step.kind, parameters)
