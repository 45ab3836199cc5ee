"""Exchanges of places are found whatever lies between the two scans that show them."""

from __future__ import annotations

import pytest

from mht_slam.association import MISSED, Association
from mht_slam.errors import AssociationError, MeasurementError
from mht_slam.measurements import BearingScan
from mht_slam.tracking.exchanges import Exchange, exchanges


def listed(bearings: list[list[float | None]]) -> list[tuple[int, int]]:
    """Scans before and after each exchange of two landmarks, None where one is missed."""
    scans, table = [], [[], []]
    for pair in bearings:
        seen = [k for k, bearing in enumerate(pair) if bearing is not None]
        scans.append(BearingScan([pair[k] for k in seen]))
        for k in range(2):
            table[k].append(seen.index(k) if k in seen else MISSED)
    association = Association(table, [len(scan) for scan in scans])
    found = exchanges(scans, association)
    assert all(exchange.pair == (0, 1) for exchange in found)
    return [(exchange.before, exchange.after) for exchange in found]


@pytest.mark.parametrize(
    ("bearings", "expected"),
    [
        ([[0.1, 0.2], [0.2, 0.1]], [(0, 1)]),
        ([[0.1, 0.2], [0.15, 0.16]], []),
        ([[0.1, 0.2], [0.15, 0.15], [0.2, 0.1]], [(0, 2)]),  # at one bearing between
        ([[0.1, 0.2], [0.15, 0.15], [0.1, 0.2]], []),  # touched
        ([[0.1, 0.2], [None, 0.1], [0.2, 0.1]], [(0, 2)]),  # one missed between
        ([[3.1, -3.1], [-3.1, 3.1]], [(0, 1)]),  # over the seam
        ([[3.0, 3.1], [3.1, -3.1]], []),  # both over the seam
        ([[0.1, 0.2], [0.2, 0.1], [0.1, 0.2]], [(0, 1), (1, 2)]),
        ([[0.0, 3.0], [0.0, -3.0]], []),  # behind the back, not in front of each other
    ],
)
def test_signs_of_the_angle_between_two_tracks_tell(
    bearings: list[list[float | None]], expected: list[tuple[int, int]]
) -> None:
    assert listed(bearings) == expected
    turned = [[None if b is None else b + 2.0 for b in pair] for pair in bearings]
    assert listed(turned) == expected


def test_exchanges_come_in_the_order_of_the_scans() -> None:
    scans = [
        BearingScan([0.1, 0.2, 0.3]),
        BearingScan([0.2, 0.1, 0.3]),
        BearingScan([0.3, 0.1, 0.2]),
    ]
    association = Association([[0, 0, 0], [1, 1, 1], [2, 2, 2]], (3, 3, 3))
    assert exchanges(scans, association) == (Exchange(0, 1, (0, 1)), Exchange(1, 2, (0, 2)))


def test_the_association_of_other_scans_is_refused() -> None:
    with pytest.raises(AssociationError, match="these scans"):
        exchanges([BearingScan([0.1])], Association([[0]], (2,)))
    with pytest.raises(AssociationError, match="give an Association"):
        exchanges([BearingScan([0.1])], [[0]])  # type: ignore[arg-type]
    with pytest.raises(MeasurementError, match="scan 0 is list"):
        exchanges([[0.1]], Association([[0]], (1,)))  # type: ignore[list-item]
