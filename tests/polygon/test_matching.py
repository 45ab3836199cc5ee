"""Matchings and their prices against going through all of them."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.polygon.matching import DONE, find_matchings, new_matching, start_anew
from mht_slam.polygon.picks import SLACK
from mht_slam.polygon.relaxation import price_detections, reduced


class Instance(NamedTuple):
    """Picks of some landmarks, of which some may be without any."""

    start: IntArray
    value: FloatArray
    detections: IntArray
    n_detections: int
    all_taken: bool


def random_instance(seed: int) -> Instance:
    """Up to four landmarks and as many detections a scan, or one more; ties on every other seed."""
    rng = np.random.default_rng(seed)
    n_landmarks = int(rng.integers(1, 5))
    all_taken = bool(rng.integers(2))
    n, n_columns = n_landmarks + (not all_taken), int(rng.integers(2, 4))
    start, value, detections = [0], [], []
    for _ in range(n_landmarks):
        possible = list(product(range(n), repeat=n_columns))
        chosen = rng.permutation(len(possible))[: int(rng.integers(0, 7))]
        for pick in sorted(chosen.tolist()):
            detections.append([column * n + d for column, d in enumerate(possible[pick])])
            value.append(np.log(rng.uniform(0.05, 1.0)))
        start.append(len(value))
    values = np.array(value)
    if seed % 2:
        values = np.round(values)
    shaped = np.array(detections, dtype=np.int64).reshape(-1, n_columns)
    return Instance(np.array(start), values, shaped, n * n_columns, all_taken)


def all_matchings(instance: Instance) -> list[tuple[float, tuple[int, ...]]]:
    ranges = [range(a, b) for a, b in zip(instance.start[:-1], instance.start[1:], strict=True)]
    matchings = []
    for picks in product(*ranges):
        used = instance.detections[list(picks)].ravel()
        if len(set(used.tolist())) == len(used):
            matchings.append((float(instance.value[list(picks)].sum()), picks))
    return matchings


def best_first(instance: Instance, value: FloatArray) -> IntArray:
    """Order of the picks that `find_matchings` wants."""
    owner = np.repeat(np.arange(len(instance.start) - 1), np.diff(instance.start))
    return np.lexsort((-value, owner))


def found_by_search(
    instance: Instance, value: FloatArray, needed: float, *, room: int, steps: int
) -> set[tuple[int, ...]]:
    """Picks of all matchings, in the instance's own numbers, through many small calls."""
    order = best_first(instance, value)
    matching = new_matching(len(instance.start) - 1, instance.n_detections, room)
    start_anew(matching)
    found: list[tuple[int, ...]] = []
    limit = 0
    while True:
        limit += steps
        state = find_matchings(
            instance.start[:-1],
            instance.start[1:],
            value[order],
            instance.detections[order],
            matching,
            needed,
            limit,
        )
        found += [tuple(order[picks].tolist()) for picks in matching.found[: matching.place[1]]]
        matching.place[1] = 0
        if state == DONE:
            assert len(set(found)) == len(found), "a matching was found twice"
            return set(found)


@given(st.integers(0, 2**32 - 1), st.sampled_from([-np.inf, -3.0, -1.0]), st.integers(1, 7))
@settings(deadline=None)
def test_all_matchings_of_enough_value_are_found_once(seed: int, needed: float, room: int) -> None:
    instance = random_instance(seed)
    found = found_by_search(instance, instance.value, needed - 1e-9, room=room, steps=3)
    expected = {picks for total, picks in all_matchings(instance) if total >= needed - 1e-9}
    assert found == expected


@given(st.integers(0, 2**32 - 1), st.sampled_from([-np.inf, -3.0, -1.0]))
@example(73507891, -1.0)  # the best matching is worth exactly what is needed
@settings(deadline=None)
def test_prices_bound_every_matching_and_lose_none(seed: int, needed: float) -> None:
    instance = random_instance(seed)
    assume((np.diff(instance.start) > 0).all())
    price = np.zeros(instance.n_detections)
    is_open = np.ones(instance.n_detections, dtype=np.bool_)
    # Sums and bounds come from different roundings; every caller leaves them this slack.
    enough = needed - SLACK
    bound = price_detections(
        instance.start[:-1],
        instance.start[1:],
        instance.detections,
        instance.value,
        enough,
        is_open,
        instance.all_taken,
        price,
    )
    matchings = all_matchings(instance)
    best = max((total for total, _ in matchings), default=-np.inf)
    if bound < enough:
        assert best < needed
        return
    assert bound >= best - SLACK
    value = np.array(
        [reduced(v, d, price) for v, d in zip(instance.value, instance.detections, strict=True)]
    )
    found = found_by_search(instance, value, enough - price.sum(), room=64, steps=1000)
    assert {picks for total, picks in matchings if total >= needed} <= found


def test_prices_bound_better_than_each_landmarks_own_best() -> None:
    start = np.array([0, 2, 4])
    detections = np.array([[0, 2], [1, 3], [0, 2], [1, 3]])
    value = np.log([0.9, 0.1, 0.8, 0.2])
    price = np.zeros(4)
    bound = price_detections(
        start[:-1], start[1:], detections, value, -np.inf, np.ones(4, dtype=np.bool_), True, price
    )
    assert np.log(0.9) + np.log(0.8) == pytest.approx(-0.3285, abs=1e-4)
    assert bound == pytest.approx(np.log(0.9) + np.log(0.2), abs=0.05)
