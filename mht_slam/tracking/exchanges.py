"""Where tracks exchange places in the visual order, as the scans show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from mht_slam.association import MISSED, Association
from mht_slam.errors import AssociationError, MeasurementError
from mht_slam.measurements import BearingScan, wrap_angle

SIDE_BY_SIDE = np.deg2rad(90.0)
"""Neighbours farther apart than this have not crossed but turned round each other's back."""


@dataclass(frozen=True)
class Exchange:
    """Two landmarks have exchanged places between two scans that see both.

    Attributes
    ----------
    before, after : the scans; no scan between them sees both landmarks, at different bearings.
    pair : rows (i, j), i < j, of the association's table.
    """

    before: int
    after: int
    pair: tuple[int, int]


def exchanges(scans: Sequence[BearingScan], association: Association) -> tuple[Exchange, ...]:
    """List every exchange of two landmarks in the visual order, in the order of the scans.

    Two bearings have exchanged places where the one that was counter-clockwise of the other is
    clockwise of it at the next scan that sees both apart, less than 90 degrees away at both. Two
    landmarks alone can do so too, though two have but one cyclic order. Raises `MeasurementError`
    for anything but scans, and `AssociationError` unless the association is over them. Source:
    docs/method.md, section 6.
    """
    for number, scan in enumerate(scans):
        if not isinstance(scan, BearingScan):
            raise MeasurementError(f"scan {number} is {type(scan).__name__}: give a BearingScan")
    if not isinstance(association, Association):
        raise AssociationError(
            f"association is {type(association).__name__}: give an Association of these scans"
        )
    counts = tuple(len(scan) for scan in scans)
    if association.n_detections != counts:
        raise AssociationError(
            f"the association is over {association.n_detections} detections and the scans have "
            f"{counts}: give the association of these scans"
        )
    table = association.table
    bearings = np.full(table.shape, np.nan)
    for k, scan in enumerate(scans):
        seen = table[:, k] != MISSED
        bearings[seen, k] = scan.bearings[table[seen, k]]
    found = []
    for i, j in combinations(range(len(table)), 2):
        both = np.flatnonzero(np.isfinite(bearings[i]) & np.isfinite(bearings[j]))
        ahead = wrap_angle(bearings[j, both] - bearings[i, both])
        both, ahead = both[ahead != 0.0], ahead[ahead != 0.0]
        near = np.abs(ahead) < SIDE_BY_SIDE
        crossed = near[:-1] & near[1:] & (ahead[:-1] * ahead[1:] < 0.0)
        found += [Exchange(int(both[k]), int(both[k + 1]), (i, j)) for k in np.flatnonzero(crossed)]
    return tuple(sorted(found, key=lambda e: (e.after, e.before, e.pair)))
