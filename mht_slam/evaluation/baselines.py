"""Trivial associations that every table carries: order keeping and nearest bearing.

Both know no geometry beyond "bearings change little between scans", read a run scan by scan, and
make full tables only: every landmark is seen in every scan. Known identities are hard constraints.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import TypeAlias

import numpy as np
from scipy.optimize import linear_sum_assignment

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.association import MISSED, Association, allowed_pairs
from mht_slam.errors import AssociationError, UnequalScansError
from mht_slam.measurements import BearingScan, StraightRun, wrap_angle

Cost: TypeAlias = Callable[[IntArray, FloatArray], FloatArray]
"""From the table so far, (n, k), and the bearings of scan k, (n,): (n, n), the cost of a match."""


def order_keeping(run: StraightRun) -> Association:
    """Associate as if the visual order never changed: the i-th bearing of each scan is landmark i.

    Bearings are ordered from -pi to pi. The cut at pi is the right one for a straight run, where
    landmarks on the left (bearing above zero) and on the right never exchange. Labels that
    contradict the order win: then the ranks change as little as labels allow, in the sum of
    squares. See docs/method.md, section 6, for where the order does change.

    Raises `UnequalScansError` for scans of different length, and `AssociationError` where the
    labels admit no full table.

    >>> scans = [BearingScan([0.2, 0.9]), BearingScan([1.1, 0.3]), BearingScan([0.5, 1.4])]
    >>> order_keeping(StraightRun(scans)).table.tolist()
    [[0, 1, 0], [1, 0, 1]]
    """
    ranks = [np.argsort(np.argsort(scan.bearings, kind="stable")) for scan in run.scans]

    def rank_change(table: IntArray, _bearings: FloatArray) -> FloatArray:
        scan = table.shape[1]
        before = ranks[scan - 1][table[:, -1]]
        change: FloatArray = (before[:, None] - ranks[scan]).astype(np.float64)
        return change**2

    return _associate(run, rank_change)


def nearest_bearing(run: StraightRun, *, with_rate: bool = True) -> Association:
    """Associate each scan with the one before by the least sum of absolute bearing differences.

    With `with_rate` a landmark is expected, from the third scan on, to have moved on by its last
    difference, as it would at equal small steps; without, to stand still.

    Raises what `order_keeping` raises.
    """

    def distance(table: IntArray, bearings: FloatArray) -> FloatArray:
        scan = table.shape[1]
        expected = run.scans[scan - 1].bearings[table[:, -1]]
        if with_rate and scan >= 2:
            before = run.scans[scan - 2].bearings[table[:, -2]]
            expected = expected + wrap_angle(expected - before)
        turn: FloatArray = np.abs(wrap_angle(expected[:, None] - bearings))
        return turn

    return _associate(run, distance)


def order_changes(run: StraightRun, truth: Association) -> bool:
    """Whether two landmarks exchange places in the visual order between two scans that see both.

    Where they do, order keeping is wrong, and results are worth reporting apart. The truth may
    have misses and false alarms. Raises `AssociationError` if it is over other detections.
    """
    if truth.n_detections != run.n_detections:
        raise AssociationError(
            f"the truth is over {truth.n_detections} detections and the run has "
            f"{run.n_detections}: give the association of these scans"
        )
    for first, second in combinations(range(len(run)), 2):
        seen = truth.table[(truth.table[:, [first, second]] != MISSED).all(axis=1)]
        before = run.scans[first].bearings[seen[:, first]]
        after = run.scans[second].bearings[seen[:, second]]
        if (np.diff(after[np.argsort(before)]) < 0.0).any():
            return True
    return False


def _associate(run: StraightRun, cost: Cost) -> Association:
    """Extend the table scan by scan with the cheapest match that labels allow."""
    n = run.n_detections[0]
    if set(run.n_detections) != {n}:
        raise UnequalScansError(
            f"the scans have {run.n_detections} detections: a baseline makes full tables, "
            "give scans of equal length"
        )
    table = np.arange(n)[:, None]
    label_of_row = list(run.scans[0].labels or (None,) * n)
    for k, scan in enumerate(run.scans[1:], start=1):
        allowed = _allowed(label_of_row, scan)
        try:
            _, matched = linear_sum_assignment(
                np.where(allowed, cost(table, scan.bearings), np.inf)
            )
        except ValueError:  # no finite assignment
            raise AssociationError(
                f"the labels up to scan {k} name more landmarks than the {n} detections of a "
                "scan: they admit no full table"
            ) from None
        table = np.column_stack([table, matched])
        labels = scan.labels or (None,) * n
        label_of_row = [
            labels[j] if row is None else row
            for row, j in zip(label_of_row, matched.tolist(), strict=True)
        ]
    return Association(table, run.n_detections)


def _allowed(label_of_row: list[str | None], scan: BearingScan) -> BoolArray:
    """Return the (n, n) mask of the rows and detections that known identities let match.

    Rows carry the label seen in any earlier scan, so identities hold across scans that do not
    show them.
    """
    rows_as_scan = BearingScan(np.zeros(len(label_of_row)), labels=label_of_row)
    return allowed_pairs(rows_as_scan, scan)
