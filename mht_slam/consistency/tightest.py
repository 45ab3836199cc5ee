"""How large errors an association needs, and the association that needs the smallest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mht_slam.arrays import IntArray, whole_number
from mht_slam.association import Association, refuse_unequal
from mht_slam.consistency.consistent_set import (
    MAX_NODES,
    RIGHT_ANGLE,
    consistent_associations,
    selected_scans,
)
from mht_slam.consistency.more_scans import ratio_bounds
from mht_slam.consistency.ratio_intervals import Cones
from mht_slam.errors import AssociationError
from mht_slam.measurements import BearingScan, StraightRun
from mht_slam.progress import Progress

RESOLUTION = 1e-12
"""Radians to which a smallest epsilon is found."""

MAX_TIED = 10_000
"""The most associations that are compared as equally tight."""

_FIRST_TRIED = 1e-3
_GROWTH = 2.0
_LARGEST = RIGHT_ANGLE - RESOLUTION


@dataclass(frozen=True)
class TightestAssociation:
    """The association that explains the scans with the smallest errors.

    Attributes
    ----------
    association : full tables only; None where no epsilon below a right angle explains the scans.
    epsilon : its smallest epsilon, radians; inf where there is none.
    proven : whether none of the others is tighter; false where `max_nodes` cut a search short.
    """

    association: Association | None
    epsilon: float
    proven: bool


def smallest_epsilon(
    run: StraightRun, association: Association, *, scans: Sequence[int] | None = None
) -> float:
    """Return the smallest vision error, radians, at which an association is consistent.

    That is the maximum norm of the bearings' residuals at its minimum over steps and landmarks, to
    1e-12 radians and never below: at what is returned `consistent_associations` lists it. For more
    than three scans it may be too small by about 1e-8, the violation allowed there. It is 0.0 where
    rounding alone could explain the residuals, and `inf` where no epsilon below pi/2 (less 1e-12)
    is enough. Misses and false alarms are fine, they ask for nothing; labels are not looked at.

    `association` has a column for each of `scans`, None meaning all of the run's. Raises
    `AssociationError` where it has not; `OptionError` and `MeasurementError` as
    `consistent_associations`. Source: docs/method.md, section 2.

    >>> import numpy as np
    >>> from mht_slam.measurements import BearingScan, StraightRun
    >>> run = StraightRun([BearingScan([0.5]), BearingScan([0.4]), BearingScan([0.9])])
    >>> round(smallest_epsilon(run, Association([[0, 0, 0]], (1, 1, 1))), 6)
    0.05
    """
    _, members = selected_scans(run, scans)
    counts = tuple(len(scan) for scan in members)
    if not isinstance(association, Association) or association.n_detections != counts:
        raise AssociationError(
            f"association is {association!r}: give an Association over {counts} detections"
        )
    return _smallest_epsilon(members, association.table)


def tightest_association(
    run: StraightRun,
    *,
    scans: Sequence[int] | None = None,
    max_nodes: int = MAX_NODES,
    progress: Progress | None = None,
) -> TightestAssociation:
    """Return the full association of the smallest `smallest_epsilon`.

    The epsilon is narrowed down between one that is certified to explain nothing and that of the
    tightest association found, until they are 1e-12 radians apart. Those as tight, to 1e-12, are
    decided by `Association.sort_key` (of the first 10,000 found, where there are more). Labels are
    hard constraints. Arguments and errors as for `consistent_associations`; `max_nodes` holds for
    each of a few dozen searches. Source: docs/method.md, section 2.

    >>> import numpy as np
    >>> from mht_slam.measurements import BearingScan, StraightRun
    >>> run = StraightRun(BearingScan(b) for b in ([0.5, 1.0], [1.2, 0.6], [0.7, 1.5]))
    >>> tightest_association(run).association.table.tolist()
    [[0, 1, 0], [1, 0, 1]]
    """
    chosen, members = selected_scans(run, scans)
    whole_number(max_nodes, "max_nodes", at_least=1)
    refuse_unequal([len(scan) for scan in members], 0, 0)
    proven = True

    def search(epsilon: float, limit: int) -> tuple[list[tuple[float, Association]], bool]:
        found = consistent_associations(
            run,
            epsilon=epsilon,
            limit=limit,
            scans=chosen,
            max_nodes=max_nodes,
            progress=progress,
        )
        needed = [(_smallest_epsilon(members, a.table), a) for a in found.associations]
        return needed, found.complete

    explains_nothing, tried = 0.0, _FIRST_TRIED
    best: float | None = None
    candidates: list[tuple[float, Association]] = []
    while best is None or best - explains_nothing > RESOLUTION:
        found, complete = search(tried, 1)
        if found:
            candidates += found
            best = min(tried, found[0][0])
        else:
            proven = proven and complete
            explains_nothing = tried
        if best is not None:
            tried = 0.5 * (explains_nothing + best)
        elif tried == _LARGEST:
            return TightestAssociation(None, math.inf, proven)
        else:
            tried = min(_GROWTH * tried, _LARGEST)
    tied, complete = search(max(best, RESOLUTION), MAX_TIED)
    candidates += tied
    proven = proven and (complete or len(tied) == MAX_TIED)
    least = min(epsilon for epsilon, _ in candidates)
    epsilon, association = min(
        (pair for pair in candidates if pair[0] <= least + RESOLUTION),
        key=lambda pair: pair[1].sort_key(),
    )
    return TightestAssociation(association, epsilon, proven)


def _smallest_epsilon(members: Sequence[BearingScan], rows: IntArray) -> float:
    def explained(epsilon: float) -> bool:
        cones = [Cones.of(scan.bearings, epsilon) for scan in members]
        bounds = ratio_bounds(rows, cones)
        return bounds is not None and bounds.steps_exist

    too_small, enough = 0.0, _LARGEST
    if explained(too_small):
        return too_small
    if not explained(enough):
        return math.inf
    while enough - too_small > RESOLUTION:
        middle = 0.5 * (too_small + enough)
        if explained(middle):
            enough = middle
        else:
            too_small = middle
    return enough
