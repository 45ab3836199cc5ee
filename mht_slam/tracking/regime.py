"""Track or hypothesise: how far bearings move between scans, against how far apart they are."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.optimize import linear_sum_assignment

from mht_slam.arrays import FloatArray
from mht_slam.measurements import StraightRun, wrap_angle
from mht_slam.tracking.order import TURN, apparent_angles

DENSE_RATIO = 0.1
"""Share of an apparent angle up to which a run counts as dense."""
DENSE_SCANS = 50
"""Scans from which on tracking pays: fewer are searched in less than a minute, and more widely."""
QUANTILE = 0.8
"""Of the pairs of scans: one fast stretch in five does not make a run sparse."""
FEWEST = 3
"""Bearings a scan needs to tell its turn from its landmarks' motion."""


def is_dense(run: StraightRun) -> bool:
    """Whether identities follow from tracking: many scans, and bearings that hardly move.

    At least `DENSE_SCANS` scans, and a `bearing_change_ratio` of at most `DENSE_RATIO`. Then a
    landmark takes ten scans or so to move as far as the next one is away: long enough to learn its
    rate before it meets another, and for a miss or two in between. Such runs are also those that
    three neighbouring scans say little of, for want of parallax.

    Source: docs/method.md, section 6.
    """
    return len(run) >= DENSE_SCANS and bearing_change_ratio(run) <= DENSE_RATIO


def bearing_change_ratio(run: StraightRun) -> float:
    """Bearing change from scan to scan as a share of the apparent angles, the larger ones of a run.

    For each two consecutive scans of three bearings or more: the median change of bearing, under
    the assignment of least squared change and without the turn that all have in common, over the
    median apparent angle. Of these the 80 % quantile; infinite where no two scans can be compared.
    Nothing is known of identities here, so changes beyond half an apparent angle are seen as
    smaller than they are: below a tenth or so the figure means what it says, above .3 only that
    tracking is out of the question.
    """
    ratios = [
        _change(one.bearings, other.bearings) / apparent
        for one, other in pairwise(run.scans)
        if min(len(one), len(other)) >= FEWEST
        and (apparent := float(np.median(apparent_angles(one.bearings)))) > 0.0
    ]
    return float(np.quantile(ratios, QUANTILE)) if ratios else float("inf")


def _change(before: FloatArray, after: FloatArray) -> float:
    """Median change of the bearings, the common turn aside.

    Of all differences between two bearings, the turn is the one after which the others have their
    nearest ones nearest.
    """
    change = wrap_angle(after - before[:, None])
    turns = change.ravel()
    around = np.sort(after)
    around = np.concatenate([around - TURN, around, around + TURN])
    turned = wrap_angle(before + turns[:, None])
    following = np.searchsorted(around, turned)
    nearest = np.minimum(turned - around[following - 1], around[following] - turned)
    left = nearest.sum(axis=1)
    moved = wrap_angle(change - turns[left.argmin()])
    matched = linear_sum_assignment(moved**2)
    change_of_each = moved[matched]
    return float(np.median(np.abs(change_of_each - np.median(change_of_each))))
