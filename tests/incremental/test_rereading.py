"""A scan read again is the best of all its assignments to the map."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.arrays import IntArray
from mht_slam.incremental.rereading import scans_reread
from mht_slam.incremental.sightings import Sightings, log_as_seen, sightings_of

from .rows import CONFIG, STRAY, Row, renamed


def reread(row: Row) -> list[IntArray] | None:
    return scans_reread(row.smoothed(), row.bearings, row.sigmas, CONFIG)


def best_of_all(row: Row, k: int) -> tuple[int, ...]:
    """Every assignment of a scan's detections to landmarks and none, one by one."""
    whole = row.smoothed()
    sightings, seen = Sightings(whole, CONFIG), sightings_of(whole.owners)
    z, sigmas = row.bearings[k], row.sigmas[k]
    dof = CONFIG.observation_model.bearing_dof
    densities = log_as_seen(whole.poses[k], whole.points, z, sigmas, dof)
    odds = [
        sightings.log_odds(n, [scan for scan, _ in seen[n] if scan != k], k)
        for n in whole.numbers.tolist()
    ]

    def weight(choice: tuple[int, ...]) -> float:
        given_to = [i for i in choice if i >= 0]
        if len(set(given_to)) < len(given_to):
            return -np.inf
        return sum(
            sightings.alone(k) if i < 0 else densities[d, i] + odds[i] for d, i in enumerate(choice)
        )

    best = max(product(range(-1, len(whole.numbers)), repeat=len(z)), key=weight)
    return tuple(-1 if i < 0 else int(whole.numbers[i]) for i in best)


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 1000), k=st.integers(0, 11))
def test_a_scan_is_assigned_as_the_best_of_all_assignments(seed: int, k: int) -> None:
    row = Row(None, range(0), seed)
    rng = np.random.default_rng(seed)
    row.bearings[k] = row.bearings[k] + rng.normal(size=5) * rng.choice([0.0, 0.02, 0.5], 5)
    row.owners[k] = np.where(rng.random(5) < 0.3, -1, rng.permutation(row.owners[k]))
    found = reread(row)
    owners = row.owners if found is None else found
    assert tuple(owners[k].tolist()) == best_of_all(row, k)


@pytest.mark.parametrize(("one", "other"), [(0, 4), (2, 4), (1, 3)])
def test_an_exchange_in_one_scan_is_undone(one: int, other: int) -> None:
    row = Row(None, range(0))
    row.owners[5][[one, other]] = row.owners[5][[other, one]]
    found = reread(row)
    assert found is not None
    assert all(owner.tolist() == [0, 1, 2, 3, 4] for owner in found)


def test_a_sighting_that_was_left_alone_is_one() -> None:
    row = Row(None, range(0))
    row.owners[7][2] = -1
    found = reread(row)
    assert found is not None
    assert found[7].tolist() == [0, 1, 2, 3, 4]
    assert row.owners[7][2] == -1, "the owners that were given have changed"


def test_a_false_alarm_is_given_back() -> None:
    row = Row(None, range(0))
    row.bearings[6][3] += 1.0
    found = reread(row)
    assert found is not None
    assert found[6].tolist() == [0, 1, 2, -1, 4]


def test_a_run_read_well_stays_as_it_is() -> None:
    assert reread(Row(None, range(0))) is None


def test_detections_of_strays_stay_theirs() -> None:
    row = renamed(Row(None, range(0)), 0, range(4))
    found = reread(row)
    assert found is None or all((owner == STRAY).any() for owner in found[:4])
