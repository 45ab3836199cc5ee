"""What the committed past lets go of, what it keeps, and that what it keeps stays as it was."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mht_slam as ms
from mht_slam.arrays import FloatArray
from mht_slam.incremental.branch import Branch, empty_branch
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.past import Committed, nothing_committed, without
from mht_slam.incremental.upkeep import DOUBTFUL, tidied
from mht_slam.simulation import simulate_drive

from .drives import check_sound, config_for, fed

NOW = 200
CONFIG = SlamConfig(lag=10, loop_scans=50)
LONG_AGO, LATELY, JUST_NOW = NOW - 51, NOW - 49, NOW - 10
"""Out of the new landmarks' time, out of the open scans, and at their edge."""


def past_of(last_seen: list[int], sightings: list[int], seed: int = 0) -> Committed:
    """Landmarks that hang together, in any order of their numbers."""
    rng, n = np.random.default_rng(seed), len(last_seen)
    half = rng.normal(size=(6 + 2 * n, 6 + 2 * n))
    return Committed(
        mean=rng.normal(size=6 + 2 * n),
        covariance=half @ half.T / len(half) + 0.1 * np.eye(len(half)),
        ids=rng.permutation(n) + 10,
        centres=rng.normal(size=(n, 2)),
        visible=rng.uniform(size=n),
        first_seen=np.maximum(np.array(last_seen, np.int64) - 30, 0),
        last_seen=np.array(last_seen, np.int64),
        sightings=np.array(sightings, np.int64),
    )


def seeing(*scans: list[int]) -> Branch:
    """A hypothesis over open scans of these landmarks."""
    return replace(empty_branch(), owners=tuple(np.array(scan, np.int64) for scan in scans))


def place(past: Committed, number: int) -> tuple[FloatArray, ...]:
    """What a past says of a landmark and the poses."""
    i = past.ids.tolist().index(number)
    at = [*range(6), 6 + 2 * i, 7 + 2 * i]
    rest = (past.centres, past.visible, past.first_seen, past.last_seen, past.sightings)
    return past.mean[at], past.covariance[np.ix_(at, at)], *(entries[i] for entries in rest)


def check_kept(past: Committed, found: Committed) -> None:
    """Fail where a landmark that was kept is another than before."""
    n = len(found.ids)
    assert found.mean.shape == (6 + 2 * n,)
    for number in found.ids.tolist():
        for old, new in zip(place(past, number), place(found, number), strict=True):
            np.testing.assert_array_equal(new, old)
    order = [past.ids.tolist().index(number) for number in found.ids.tolist()]
    assert order == sorted(order)
    at = [*range(6), *(6 + 2 * i + k for i in order for k in (0, 1))]
    np.testing.assert_array_equal(found.covariance, past.covariance[np.ix_(at, at)])
    assert np.linalg.eigvalsh(found.covariance)[0] > 0.0


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 1000), n=st.integers(0, 6), data=st.data())
def test_letting_go_leaves_the_marginal_of_the_others(
    seed: int, n: int, data: st.DataObject
) -> None:
    past = past_of([NOW] * n, [5] * n, seed)
    gone = data.draw(st.lists(st.integers(0, n - 1), unique=True) if n else st.just([]))
    found = without(past, np.array(gone, np.int64))
    check_kept(past, found)
    assert set(found.ids.tolist()) == set(past.ids.tolist()) - set(past.ids[gone].tolist())


@pytest.mark.parametrize(
    ("last_seen", "sightings", "kept"),
    [
        (LONG_AGO, DOUBTFUL - 1, False),
        (LONG_AGO, 1, False),
        (LONG_AGO, DOUBTFUL, True),  # seen often enough to be a landmark
        (LATELY, 1, True),  # may yet be seen again, or close a loop
        (JUST_NOW, 1, True),
    ],
)
def test_landmarks_seldom_seen_are_let_go_once_they_are_out_of_sight_for_long(
    last_seen: int, sightings: int, kept: bool
) -> None:
    past = past_of([LONG_AGO, last_seen, NOW], [9, sightings, 9])
    found = tidied(past, [seeing([])], NOW, CONFIG)
    check_kept(past, found)
    assert (past.ids[1] in found.ids) == kept
    assert {past.ids[0], past.ids[2]} <= set(found.ids.tolist())


def test_landmarks_of_open_scans_stay_whichever_hypothesis_sees_them() -> None:
    past = past_of([LONG_AGO] * 4, [1] * 4)
    one, two, three, _ = past.ids.tolist()
    branches = [seeing([one, -1], [-1, -1]), seeing([two, -1], [-1, three])]
    config = replace(CONFIG, most_landmarks=1)
    found = tidied(past, branches, NOW, config)
    check_kept(past, found)
    assert sorted(found.ids.tolist()) == sorted([one, two, three])


@pytest.mark.parametrize("most", [1, 3, 4, 5, 6, 100])
def test_of_too_many_landmarks_those_unseen_for_longest_are_let_go(most: int) -> None:
    """As many as it takes; those that may be in sight stay, even where they are too many."""
    last_seen = [NOW - 60, NOW, NOW - 100, NOW - 12, NOW - 3, NOW - 30]
    past = past_of(last_seen, [9] * 6)
    found = tidied(past, [seeing([])], NOW, replace(CONFIG, most_landmarks=most))
    check_kept(past, found)
    newest_first = sorted(past.last_seen.tolist(), reverse=True)
    in_sight = 2
    assert sorted(found.last_seen.tolist(), reverse=True) == newest_first[: max(most, in_sight)]


def test_false_landmarks_go_first_and_leave_room() -> None:
    """Old ones that were seen often stay, where dropping the doubtful ones is enough."""
    past = past_of([NOW - 90, NOW - 60, NOW - 70, NOW], [9, 1, 2, 9])
    found = tidied(past, [seeing([])], NOW, replace(CONFIG, most_landmarks=2))
    assert found.ids.tolist() == past.ids[[0, 3]].tolist()


def test_a_past_with_nothing_to_let_go_is_left_alone() -> None:
    for past in (nothing_committed(), past_of([NOW, LATELY, LONG_AGO], [1, 1, 9])):
        assert tidied(past, [seeing([])], NOW, CONFIG) is past


def test_a_bounded_map_forgets_places_and_no_detections() -> None:
    """An explorer's map: the bound holds, and whole run and association have it all."""
    most = 12  # about eight are in sight
    drive = simulate_drive(
        "smooth", 30, 60, np.random.default_rng(7), sigma=math.radians(0.2), false_alarms=0.0
    )
    slam = ms.MultiHypothesisSlam(config_for("smooth", most_landmarks=most, hypotheses=3))
    for scan in drive.scans:
        slam.update(scan)
        past = slam.committed
        open_owners = [owner for branch in slam._branches for owner in branch.owners]
        in_sight = past.last_seen >= past.last_seen.max(initial=0) - slam.config.lag
        in_sight |= np.isin(past.ids, np.concatenate(open_owners))
        assert len(past.ids) <= max(most, in_sight.sum())
    check_sound(slam)
    free = fed(config_for("smooth", hypotheses=3), drive.scans)
    assert len(free.committed.ids) > 2 * most, "it would not tell"
    assert len(slam.map) == slam.association.n_landmarks > 2 * most
    assert np.isfinite(slam.map.points).all()
    assert slam.association.f1(drive.truth()) > free.association.f1(drive.truth()) - 0.05
