"""Loops: a constellation recognised after drift, chance and regular patterns refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mht_slam.arrays import FloatArray
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.loops import Loop, find_loop, find_twins, spacing_of
from mht_slam.incremental.past import FAR_CENTRE, Committed, places_of, without

ODDS = SlamConfig().loop_odds
RECENT = 100
DRIFT = (1.5, -1.0, math.radians(6.0))


def past_of(old: FloatArray, new: FloatArray, drift_sigmas: FloatArray, noise: float) -> Committed:
    """Old landmarks well known, new ones off by one common drift and each by a little."""
    points = np.concatenate([old, new])
    n = len(points)
    middle = new.mean(axis=0) if len(new) else np.zeros(2)
    flat = np.zeros((n, 2, 3))
    flat[len(old) :, 0, 0] = flat[len(old) :, 1, 1] = 1.0
    flat[len(old) :, 0, 2] = -(new - middle)[:, 1]
    flat[len(old) :, 1, 2] = (new - middle)[:, 0]
    rows = flat.reshape(-1, 3)
    joint = rows @ np.diag(drift_sigmas**2) @ rows.T + noise**2 * np.eye(2 * n)
    # About centres far behind, direction and log range are the points, turned and to scale.
    centres = points - [FAR_CENTRE, 0.0]
    places = places_of(points, centres)
    swap = np.kron(np.eye(n), np.array([[0.0, 1.0], [1.0, 0.0]]) / FAR_CENTRE)
    covariance = np.zeros((6 + 2 * n, 6 + 2 * n))
    covariance[:6, :6] = 1e-6 * np.eye(6)
    covariance[6:, 6:] = swap @ joint @ swap.T
    scan = np.concatenate([np.arange(len(old)) % 40, RECENT + np.arange(len(new)) % 40])
    return Committed(
        mean=np.concatenate([np.zeros(6), places.ravel()]),
        covariance=covariance,
        ids=np.arange(n),
        centres=centres,
        visible=np.ones(n),
        first_seen=scan,
        last_seen=scan + 5,
        sightings=np.full(len(scan), 5),
    )


def scattered(rng: np.random.Generator, n: int, width: float) -> FloatArray:
    """Landmarks that keep a distance of 1.5 from each other."""
    points: list[FloatArray] = []
    while len(points) < n:
        point = rng.uniform(0.0, width, 2)
        if all(math.dist(point, other) > 1.5 for other in points):
            points.append(point)
    return np.array(points)


def drifted(points: FloatArray, drift: tuple[float, float, float]) -> FloatArray:
    c, s = math.cos(drift[2]), math.sin(drift[2])
    middle = points.mean(axis=0)
    return (points - middle) @ np.array([[c, s], [-s, c]]) + middle + drift[:2]


SIGMAS = np.array([1.0, 1.0, math.radians(4.0)])


def never_together(one: int, other: int) -> int | None:
    """What `SeenApart` says of landmarks that no scan saw together."""
    assert one != other
    return 0


def found_in(old: FloatArray, new: FloatArray) -> Loop | None:
    return find_loop(past_of(old, new, SIGMAS, 0.05), RECENT, ODDS, never_together)


@pytest.mark.parametrize("seed", range(10))
def test_a_constellation_that_drifted_is_recognised_with_all_its_pairs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    old = scattered(rng, 25, 16.0)
    again = rng.permutation(25)[:9]
    new = drifted(old[again], DRIFT) + 0.04 * rng.normal(size=(9, 2))
    loop = found_in(old, new)
    assert loop is not None
    assert loop.log_odds >= ODDS
    pairs = dict(zip((loop.new - 25).tolist(), loop.old.tolist(), strict=True))
    wrong = [i for i, j in pairs.items() if again[i] != j]
    assert not wrong
    assert len(pairs) >= 8


@pytest.mark.parametrize("seed", range(5))
def test_strangers_among_the_new_landmarks_are_left_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    old = scattered(rng, 25, 16.0)
    again = rng.permutation(25)[:9]
    strangers = np.array([30.0, 5.0]) + scattered(rng, 6, 10.0)
    new = np.concatenate([drifted(old[again], DRIFT), drifted(strangers, DRIFT)])
    loop = found_in(old, new)
    assert loop is not None
    pairs = dict(zip((loop.new - 25).tolist(), loop.old.tolist(), strict=True))
    assert [i for i, j in pairs.items() if i >= 9 or again[i] != j] == []


def test_random_landmarks_are_hardly_ever_a_loop() -> None:
    """At most one in a hundred of seeded scenes of new landmarks over an old map."""
    found = []
    for seed in range(200):
        rng = np.random.default_rng(1000 + seed)
        loop = found_in(scattered(rng, 25, 16.0), scattered(rng, 10, 10.0) + 3.0)
        if loop is not None:
            found.append((seed, len(loop.new), loop.log_odds))
    assert len(found) <= 2, found


def test_a_regular_grid_that_fits_in_several_ways_is_no_loop() -> None:
    x, y = np.meshgrid(np.arange(6.0), np.arange(6.0))
    old = 2.0 * np.column_stack([x.ravel(), y.ravel()])
    inner = (x.ravel() >= 1) & (x.ravel() <= 3) & (y.ravel() >= 1) & (y.ravel() <= 3)
    for shift in ((1.0, 1.0, 0.0), (0.9, 0.1, 0.0), (0.2, 0.1, 0.02)):
        loop = found_in(old, drifted(old[inner], shift))
        assert loop is None, shift


def test_landmarks_seen_at_the_same_time_are_two() -> None:
    rng = np.random.default_rng(2)
    old = scattered(rng, 15, 12.0)
    past = past_of(old, drifted(old[:8], DRIFT), SIGMAS, 0.05)
    together = past.last_seen.copy()
    together[:15] = RECENT + 50  # still in view when the new ones came
    at_once = Committed(**{**vars(past), "last_seen": together})
    assert find_loop(past, RECENT, ODDS, never_together) is not None
    assert find_loop(at_once, RECENT, ODDS, never_together) is None


def test_a_pair_that_an_open_scan_sees_together_is_left_out() -> None:
    rng = np.random.default_rng(2)
    old = scattered(rng, 15, 12.0)
    past = past_of(old, drifted(old[:8], DRIFT), SIGMAS, 0.05)

    def apart(one: int, other: int) -> int | None:
        return None if 3 in (one, other) else 0

    loop = find_loop(past, RECENT, ODDS, apart)
    assert loop is not None
    assert sorted(loop.old.tolist()) == [0, 1, 2, 4, 5, 6, 7]
    assert find_loop(past, RECENT, ODDS, lambda *_: None) is None


@pytest.mark.parametrize("seed", range(4))
def test_what_is_left_without_contradicted_pairs_has_to_earn_the_odds(seed: int) -> None:
    """As if the old landmarks of those pairs were not there."""
    rng = np.random.default_rng(seed)
    old = scattered(rng, 25, 16.0)
    again = rng.permutation(25)[:9]
    past = past_of(old, drifted(old[again], DRIFT), SIGMAS, 0.05)
    whole = find_loop(past, RECENT, ODDS, never_together)
    assert whole is not None
    for count in (1, 3, 4):
        together = set(again[:count].tolist())

        def apart(one: int, other: int, together: set[int] = together) -> int | None:
            return None if together & {one, other} else 0

        left = find_loop(past, RECENT, 0.1, apart)
        expected = find_loop(without(past, again[:count]), RECENT, 0.1, never_together)
        assert left is not None
        assert expected is not None
        assert sorted(past.ids[left.old].tolist()) == sorted(again[count:].tolist())
        assert left.log_odds == pytest.approx(expected.log_odds)
        assert left.log_odds < whole.log_odds - count
        assert find_loop(past, RECENT, left.log_odds - 1e-6, apart) is not None
        assert find_loop(past, RECENT, left.log_odds + 1e-6, apart) is None


@pytest.mark.parametrize("n", [0, 1, 3])
def test_few_landmarks_are_no_loop(n: int) -> None:
    old = scattered(np.random.default_rng(0), 10, 12.0)
    assert found_in(old, old[:n] + 0.1) is None
    assert found_in(old[:n], old + 0.1) is None


def test_turning_and_moving_the_world_changes_no_loop() -> None:
    rng = np.random.default_rng(5)
    old = scattered(rng, 25, 16.0)
    new = drifted(old[:9], DRIFT) + 0.04 * rng.normal(size=(9, 2))
    turn = np.array([[math.cos(2.0), math.sin(2.0)], [-math.sin(2.0), math.cos(2.0)]])
    one, two = found_in(old, new), found_in(old @ turn + 7.0, new @ turn + 7.0)
    assert one is not None
    assert two is not None
    assert (one.new.tolist(), one.old.tolist()) == (two.new.tolist(), two.old.tolist())
    assert one.log_odds == pytest.approx(two.log_odds, abs=0.01)


def test_the_spacing_is_the_median_distance_to_the_next_landmark() -> None:
    assert spacing_of(np.array([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0]])) == 1.0
    assert spacing_of(np.zeros((1, 2))) == 1.0
    assert spacing_of(np.zeros((0, 2))) == 1.0


def twins_in(points: FloatArray, apart: int | None, threshold: float = ODDS) -> Loop | None:
    """Two names may stand for one landmark; the map is sure to a tenth of a unit."""
    past = past_of(points, np.empty((0, 2)), SIGMAS, 0.1)
    return find_twins(past, np.arange(len(points)), lambda *_: apart, 0.9, threshold)


def test_a_landmark_under_two_names_is_one() -> None:
    points = scattered(np.random.default_rng(0), 12, 12.0)
    twice = np.concatenate([points, points[4:5] + 0.1])
    loop = twins_in(twice, 6)
    assert loop is not None
    assert {int(loop.new[0]), int(loop.old[0])} == {4, 12}
    assert twins_in(twice, None) is None, "some scan saw both"
    assert twins_in(points, 6) is None, "nobody stands so close"
    assert twins_in(points[:1], 6) is None


def test_every_scan_that_saw_just_one_of_two_speaks_for_one_landmark() -> None:
    points = scattered(np.random.default_rng(0), 12, 12.0)
    twice = np.concatenate([points, points[4:5] + 0.1])
    few, many = twins_in(twice, 1, 1e-9), twins_in(twice, 4, 1e-9)
    assert few is not None
    assert many is not None
    assert many.log_odds - few.log_odds == pytest.approx(3.0 * math.log(10.0))
    apart = np.concatenate([points, points[4:5] + 0.4])
    far = twins_in(apart, 4, 1e-9)
    assert far is None or far.log_odds < many.log_odds
