"""The smallest epsilon of an association against the joint program, and the tightest of all."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import permutations, product
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.association import Association
from mht_slam.consistency.consistent_set import consistent_associations
from mht_slam.consistency.tightest import RESOLUTION, smallest_epsilon, tightest_association
from mht_slam.errors import AssociationError, UnequalScansError
from mht_slam.measurements import BearingScan, StraightRun
from mht_slam.simulation import simulate_scene

Floats = npt.NDArray[np.float64]
Explains: TypeAlias = Callable[..., bool]
SEEDS = st.integers(0, 2**32 - 1)
RIGHT_ANGLE = math.pi / 2


def run_of(bearings: Sequence[npt.ArrayLike]) -> StraightRun:
    return StraightRun(BearingScan(b) for b in bearings)


def identity(n: int, m: int) -> Association:
    return Association([[i] * m for i in range(n)], [n] * m)


def scene_bearings(n: int, m: int, seed: int, noise: float) -> list[Floats]:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-2.0, 5.0, n), rng.choice([-1, 1], n) * rng.uniform(0.3, 4.0, n)
    at = np.cumsum([0.0, 1.0, *rng.uniform(0.4, 2.0, m - 2)])
    return [np.arctan2(y, x - at[k]) + noise * rng.uniform(-1.0, 1.0, n) for k in range(m)]


@settings(max_examples=40, deadline=None)
@given(st.sampled_from([(3, 3), (2, 4), (3, 5)]), SEEDS, st.floats(0.001, 0.5))
def test_the_joint_program_changes_its_answer_at_the_smallest_epsilon(
    explains: Explains, size: tuple[int, int], seed: int, noise: float
) -> None:
    n, m = size
    bearings = scene_bearings(n, m, seed, noise)
    table = np.tile(np.arange(n)[:, None], m)
    if seed % 3 == 0:
        table[0, 0] = -1  # not even seen in every scan
    association = Association(table, (n,) * m)
    epsilon = smallest_epsilon(run_of(bearings), association)
    if epsilon == math.inf:
        assert not explains(bearings, table.tolist(), RIGHT_ANGLE - 1e-6)
        return
    assert explains(bearings, table.tolist(), epsilon + 1e-6, within=(1e-7, 1e7))
    if epsilon > 1e-6:
        assert not explains(bearings, table.tolist(), epsilon - 1e-6)


@settings(max_examples=25, deadline=None)
@given(st.sampled_from([(2, 3), (4, 3), (2, 4)]), SEEDS, st.floats(0.001, 0.3))
def test_an_association_is_listed_at_its_smallest_epsilon_and_not_below(
    size: tuple[int, int], seed: int, noise: float
) -> None:
    run = run_of(scene_bearings(*size, seed, noise))
    association = identity(*size)
    epsilon = smallest_epsilon(run, association)
    assert 0.0 < epsilon <= noise + RESOLUTION
    assert association in consistent_associations(run, epsilon=epsilon).associations
    below = consistent_associations(run, epsilon=epsilon - 2 * RESOLUTION)
    assert association not in below.associations


@settings(max_examples=8, deadline=None)
@given(st.sampled_from([(3, 3), (2, 4)]), SEEDS, st.floats(0.001, 0.6))
def test_no_other_association_is_tighter(size: tuple[int, int], seed: int, noise: float) -> None:
    n, m = size
    run = run_of(scene_bearings(n, m, seed, noise))
    every = [
        Association([[i, *(order[i] for order in orders)] for i in range(n)], (n,) * m)
        for orders in product(permutations(range(n)), repeat=m - 1)
    ]
    needed = {a: smallest_epsilon(run, a) for a in every}
    best = tightest_association(run)
    assert best.proven
    assert best.association is not None
    assert best.epsilon == needed[best.association]
    assert best.epsilon <= min(needed.values()) + 2 * RESOLUTION


def test_the_tightest_of_a_noiseless_scene_is_the_truth() -> None:
    scene = simulate_scene("annulus", 8, np.random.default_rng(4), epsilon=0.0)
    best = tightest_association(scene.run)
    assert best.proven
    assert best.association == scene.truth
    assert best.epsilon < 1e-11


def test_equally_tight_associations_are_decided_by_their_tables() -> None:
    bearings = [0.5, 0.5, 2.0], [0.9, 0.9, 2.4], [1.3, 1.3, 2.6]
    best = tightest_association(run_of(bearings))
    assert best.association is not None
    assert best.association.table.tolist() == [[0, 0, 0], [1, 1, 1], [2, 2, 2]]
    backwards = tightest_association(run_of([b[::-1] for b in bearings]))
    assert backwards.association is not None
    assert backwards.association.table.tolist() == [[0, 0, 0], [1, 1, 1], [2, 2, 2]]


def test_labels_bind_the_tightest() -> None:
    scene = simulate_scene("annulus", 3, np.random.default_rng(2), epsilon=0.01)
    swapped = [["a", "b", None], ["b", "a", None], [None, None, None]]
    named = []
    for scan, column, names in zip(scene.scans, scene.truth.table.T, swapped, strict=True):
        labels = np.empty(3, dtype=object)
        labels[column] = names
        named.append(BearingScan(scan.bearings, labels=labels.tolist()))
    free, bound = tightest_association(scene.run), tightest_association(StraightRun(named))
    assert free.association == scene.truth
    assert bound.association is not None
    assert bound.association != scene.truth
    assert bound.epsilon > free.epsilon


def test_a_search_cut_short_proves_nothing() -> None:
    scene = simulate_scene("annulus", 5, np.random.default_rng(0), epsilon=np.deg2rad(1))
    assert not tightest_association(scene.run, max_nodes=3).proven


def test_a_landmark_seen_backwards_needs_more_than_a_right_angle() -> None:
    run = run_of([[math.pi], [0.0], [0.0]])
    assert smallest_epsilon(run, identity(1, 3)) == math.inf
    best = tightest_association(run)
    assert (best.association, best.epsilon, best.proven) == (None, math.inf, True)


def test_landmarks_seen_once_ask_for_nothing() -> None:
    run = run_of([[2.0], [1.0], [0.5]])
    apart = Association([[0, -1, -1], [-1, 0, -1], [-1, -1, 0]], (1, 1, 1))
    assert smallest_epsilon(run, apart) == 0.0
    # Seen twice, the order of the bearings counts: half of what they differ the wrong way.
    twice = Association([[0, 0, -1]], (1, 1, 1))
    assert smallest_epsilon(run, twice) == pytest.approx(0.5, abs=1e-9)


def test_associations_of_other_scans_are_refused() -> None:
    run = run_of([[0.5], [0.8], [1.3], [1.5]])
    with pytest.raises(AssociationError, match=r"\(1, 1, 1, 1\)"):
        smallest_epsilon(run, identity(1, 3))
    assert smallest_epsilon(run, identity(1, 3), scans=(0, 1, 3)) < 0.1
    with pytest.raises(UnequalScansError):
        tightest_association(run_of([[0.5], [0.6, 0.7], [0.8]]))
