"""A hypothesis whose window moves on, or whose landmarks turn out to be others."""

from __future__ import annotations

import math

import numpy as np
import pytest

import mht_slam as ms
from mht_slam.incremental.branch import Branch, carried_along, rearranged
from mht_slam.incremental.past import points_of

from .drives import along_a_row, fed


def sighted(branch: Branch) -> set[tuple[int, int, float]]:
    """What a branch says, by pose from the end, landmark's name and bearing."""
    return {
        (len(branch.poses) - pose, int(branch.ids[landmark]), bearing)
        for (pose, landmark), bearing in zip(
            branch.sightings.tolist(), branch.bearings.tolist(), strict=True
        )
    }


def test_a_window_that_moves_on_forgets_the_oldest_scan_only() -> None:
    slam = fed(ms.SlamConfig(lag=5), along_a_row(8))
    once_more = rearranged(slam._branches, slam._window, slam._past)  # as if the window moved
    for branch, moved in zip(slam._branches, once_more, strict=True):
        open_owners = branch.owners[1:]
        assert all(np.array_equal(a, b) for a, b in zip(moved.owners, open_owners, strict=True))
        still = {row for row in sighted(branch) if row[0] <= len(branch.poses) - 3}
        assert sighted(moved) == still
        for number in set(moved.ids.tolist()) & set(branch.ids.tolist()):
            old, new = branch.ids.tolist().index(number), moved.ids.tolist().index(number)
            np.testing.assert_allclose(
                points_of(moved.places, moved.centres)[new],
                points_of(branch.places, branch.centres)[old],
                atol=1e-6,
            )
            assert moved.visible[new] == branch.visible[old]


@pytest.mark.parametrize("turn", [0.0, 0.7, -3.0])
def test_carried_along_a_branch_sees_the_same_bearings(turn: float) -> None:
    slam = fed(ms.SlamConfig(lag=4), along_a_row(7))
    branch = slam._branches[0]
    before = branch.poses[1]
    after = before + np.array([2.0, -1.0, turn])
    moved = carried_along(branch, before, after, {})
    np.testing.assert_allclose(moved.poses[1], after)
    for one in (branch, moved):
        points = points_of(one.places, one.centres)
        away = points[one.sightings[:, 1]] - one.poses[one.sightings[:, 0], :2]
        seen = np.arctan2(away[:, 1], away[:, 0]) - one.poses[one.sightings[:, 0], 2]
        if one is branch:
            expected = seen
    np.testing.assert_allclose(np.cos(seen - expected), 1.0, atol=1e-12)
    steps = [np.hypot(*np.diff(one.poses[:, :2], axis=0).T) for one in (branch, moved)]
    np.testing.assert_allclose(steps[0], steps[1], atol=1e-9)
    assert math.isclose(moved.poses[-1, 2] - branch.poses[-1, 2], turn, abs_tol=1e-12)


def test_a_landmark_that_turns_out_to_be_another_keeps_its_sightings() -> None:
    """Both names may be in the window: the old one stood close by before the loop was closed."""
    slam = fed(ms.SlamConfig(lag=4), along_a_row(8))
    branch = slam._branches[0]
    settled = slam._window.settled.tolist()
    assert len(settled) >= 2
    new, old = settled[-1], settled[0]
    # A branch that uses the two names in turn for one landmark.
    rows = [i for i, n in enumerate(branch.ids.tolist()) if n in (new, old)]
    names = {pose: branch.ids[i] for pose, i in branch.sightings.tolist() if i == rows[0]}
    assert len(names) > 2
    renamed = carried_along(branch, branch.poses[1], branch.poses[1], {new: old})
    past = slam._past
    (moved,) = rearranged([renamed], slam._window, past)
    at_old = moved.ids.tolist().index(old)
    wanted = {row for row in sighted(renamed) if row[1] == old and row[0] <= len(branch.poses) - 3}
    found = {row for row in sighted(moved) if row[1] == moved.ids[at_old]}
    assert (moved.sightings >= 0).all(), "a sighting of no landmark"
    assert found == wanted
