"""The consistent set against a joint linear program, its guarantees and its limits."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import permutations, product
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.association import MISSED, Association, respects_labels
from mht_slam.consistency import three_scans
from mht_slam.consistency.consistent_set import ConsistentSet, consistent_associations
from mht_slam.errors import MeasurementError, OptionError, UnequalScansError
from mht_slam.measurements import BearingScan, RunPair, StraightRun
from mht_slam.simulation import simulate_scene

Floats = npt.NDArray[np.float64]
Explains: TypeAlias = Callable[..., bool]
StepRange: TypeAlias = Callable[..., tuple[float, float]]
SEEDS = st.integers(0, 2**32 - 1)
KINDS = st.sampled_from(["around", "near axis", "behind", "ties", "parallel", "on axis", "noise"])
EPSILONS = st.one_of(st.floats(0.1, 8.0), st.floats(8.0, 40.0), st.floats(40.0, 85.0))
"""Degrees."""

SAFE = (0.02, 50.0)
"""Steps within which the joint program's own tolerance is far below `MARGIN`."""
WIDE = (1e-3, 1e3)
MARGIN = 1e-7
"""Radians: nearer to its smallest epsilon an association is not held against the program."""


def bearings_of(kind: str, n: int, m: int, seed: int, epsilon: float) -> list[Floats]:
    """Bearings of one scene, detection i being landmark i unless the kind says noise."""
    rng = np.random.default_rng(seed)
    if kind == "noise":
        return [rng.uniform(-np.pi, np.pi, n) for _ in range(m)]
    if kind == "on axis":
        return [rng.choice([0.0, np.pi, -1e-9, 0.3, 3.0], n) for _ in range(m)]
    x = rng.uniform(-2.0, 5.0, n)
    y = rng.choice([-1.0, 1.0], n) * rng.uniform(0.5, 4.0, n)
    if kind == "near axis":
        y *= 0.03
    if kind == "behind":
        x -= 6.0
    if kind == "parallel":
        x, y = 1e4 * x, 1e4 * y
    at = np.concatenate([[0.0], np.cumsum(np.append(1.0, rng.uniform(0.3, 2.5, m - 2)))])
    noise = epsilon * rng.uniform(-1.3, 1.3, (m, n))
    seen = [np.arctan2(y, x - at[k]) + noise[k] for k in range(m)]
    if kind == "ties":
        for bearings in seen:
            bearings[-1] = bearings[0]
    return seen


def run_of(bearings: Sequence[npt.ArrayLike]) -> StraightRun:
    return StraightRun(BearingScan(b) for b in bearings)


def full_tables(n: int, m: int) -> Iterator[list[list[int]]]:
    for others in product(permutations(range(n)), repeat=m - 1):
        yield [[i, *(order[i] for order in others)] for i in range(n)]


def assert_program_agrees(
    explains: Explains,
    bearings: Sequence[Floats],
    epsilon: float,
    found: ConsistentSet,
    tables: Sequence[Sequence[Sequence[int]]],
) -> None:
    assert found.complete
    counts = [len(b) for b in bearings]
    listed = set(found.associations)
    for table in tables:
        association = Association(table, counts)
        if association in listed:
            interval = found.ratio_intervals[found.associations.index(association)]
            reachable = (interval[:, 0] < WIDE[1] / 2).all() and (
                interval[:, 1] > 2 * WIDE[0]
            ).all()
            explained = explains(bearings, table, epsilon + MARGIN, within=WIDE)
            assert explained or not reachable, association
        elif epsilon > MARGIN:
            assert not explains(bearings, table, epsilon - MARGIN, within=SAFE), association


@settings(max_examples=40, deadline=None)
@given(KINDS, SEEDS, EPSILONS)
def test_three_landmarks_in_three_scans_are_those_of_the_joint_program(
    explains: Explains, kind: str, seed: int, degrees: float
) -> None:
    epsilon = float(np.deg2rad(degrees))
    bearings = bearings_of(kind, 3, 3, seed, epsilon)
    found = consistent_associations(run_of(bearings), epsilon=epsilon)
    assert_program_agrees(explains, bearings, epsilon, found, list(full_tables(3, 3)))


@settings(max_examples=20, deadline=None)
@given(st.integers(4, 5), KINDS, SEEDS, st.floats(0.1, 15.0))
def test_more_landmarks_in_three_scans_are_those_of_the_joint_program(
    explains: Explains, n: int, kind: str, seed: int, degrees: float
) -> None:
    epsilon = float(np.deg2rad(degrees))
    bearings = bearings_of(kind, n, 3, seed, epsilon)
    found = consistent_associations(run_of(bearings), epsilon=epsilon, limit=20_000)
    rng = np.random.default_rng(seed)
    every = list(full_tables(n, 3))
    sampled = [every[i] for i in rng.choice(len(every), 20)]
    sampled += [[[i, i, i] for i in range(n)]]
    sampled += [a.table.tolist() for a in found.associations[:5]]
    # Neighbours of what is listed: two landmarks exchange their last detections.
    for association in found.associations[:3]:
        table = association.table.copy()
        table[:2, 2] = table[1::-1, 2]
        sampled.append(table.tolist())
    assert_program_agrees(explains, bearings, epsilon, found, sampled)


@settings(max_examples=14, deadline=None)
@given(st.sampled_from([(2, 4), (2, 5), (3, 4)]), KINDS, SEEDS, EPSILONS)
def test_more_scans_are_those_of_the_joint_program(
    explains: Explains, size: tuple[int, int], kind: str, seed: int, degrees: float
) -> None:
    epsilon = float(np.deg2rad(degrees))
    bearings = bearings_of(kind, *size, seed, epsilon)
    found = consistent_associations(run_of(bearings), epsilon=epsilon)
    tables = list(full_tables(*size))
    if len(tables) > 60:
        chosen = np.random.default_rng(seed).choice(len(tables), 60, replace=False)
        tables = [tables[0], *(tables[i] for i in chosen)]
        tables += [a.table.tolist() for a in found.associations[:10]]
    assert_program_agrees(explains, bearings, epsilon, found, tables)


def test_bounds_that_only_contradict_each_other_together_are_found_out(explains: Explains) -> None:
    # One association of this scene keeps every three scans' bounds, but no steps keep all of them.
    epsilon = float(np.deg2rad(3))
    scene = simulate_scene("one_sided", 3, np.random.default_rng(10), epsilon=epsilon, n_scans=4)
    bearings = [scan.bearings for scan in scene.scans]
    found = consistent_associations(scene.run, epsilon=epsilon)
    assert len(found) == 5
    assert_program_agrees(explains, bearings, epsilon, found, list(full_tables(3, 4)))


@settings(max_examples=25, deadline=None)
@given(st.sampled_from([(3, 3), (2, 4), (3, 5)]), SEEDS, st.floats(0.5, 10.0))
def test_ratio_intervals_are_the_ends_of_the_feasible_steps(
    step_range: StepRange, size: tuple[int, int], seed: int, degrees: float
) -> None:
    epsilon = float(np.deg2rad(degrees))
    bearings = bearings_of("around", *size, seed, epsilon)
    found = consistent_associations(run_of(bearings), epsilon=epsilon)
    assert found.ratio_intervals.shape == (len(found), size[1] - 2, 2)
    for association, intervals in list(zip(found.associations, found.ratio_intervals, strict=True))[
        :3
    ]:
        if (intervals[:, 0] < SAFE[0]).any() or (intervals[:, 1] > SAFE[1]).any():
            continue  # the program keeps inside that box
        for step, interval in enumerate(intervals):
            ends = step_range(bearings, association.table.tolist(), epsilon + 1e-9, step=step)
            assert interval == pytest.approx(ends, rel=1e-4)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 8), st.integers(3, 5), SEEDS, st.floats(0.01, 30.0))
def test_the_truth_is_listed_while_noise_stays_inside_epsilon(
    n: int, m: int, seed: int, degrees: float
) -> None:
    rng = np.random.default_rng(seed)
    epsilon = float(np.deg2rad(degrees))
    x, y = rng.uniform(-3.0, 6.0, n), rng.normal(0.0, 2.0, n)
    at = np.cumsum([0.0, 1.0, *np.exp(rng.normal(0.0, 1.0, m - 2))])
    # Nothing is left to spare: every error is as large as it may be.
    bearings = [np.arctan2(y, x - at[k]) + epsilon * rng.choice([-1, 1], n) for k in range(m)]
    scans = [
        BearingScan(b, labels=[str(i) if i >= 3 else None for i in range(n)]) for b in bearings
    ]
    found = consistent_associations(StraightRun(scans), epsilon=epsilon)
    truth = Association([[i] * m for i in range(n)], [n] * m)
    assert found.complete
    assert truth in found.associations
    interval = found.ratio_intervals[found.associations.index(truth)]
    steps = np.diff(at)[1:]
    assert (interval[:, 0] <= steps).all()
    assert (steps <= interval[:, 1]).all()


@settings(max_examples=12, deadline=None)
@given(st.integers(2, 4), st.integers(3, 4), KINDS, SEEDS, st.floats(0.5, 10.0))
def test_permuting_detections_and_mirroring_relabel_only(
    n: int, m: int, kind: str, seed: int, degrees: float
) -> None:
    epsilon = float(np.deg2rad(degrees))
    rng = np.random.default_rng(seed)
    bearings = bearings_of(kind, n, m, seed, epsilon)
    orders = [rng.permutation(n) for _ in range(m)]
    moved = [-b[order] for b, order in zip(bearings, orders, strict=True)]
    found = consistent_associations(run_of(bearings), epsilon=epsilon)
    other = consistent_associations(run_of(moved), epsilon=epsilon)
    back = {
        Association(
            np.column_stack([order[a.table[:, k]] for k, order in enumerate(orders)]), [n] * m
        ): interval
        for a, interval in zip(other.associations, other.ratio_intervals, strict=True)
    }
    assert set(found.associations) == set(back)
    for association, interval in zip(found.associations, found.ratio_intervals, strict=True):
        assert back[association] == pytest.approx(interval, rel=1e-6)


def every_association(
    counts: Sequence[int], max_missed: int, max_false: int
) -> Iterator[Association]:
    """All partitions of the detections, straight from the definition."""
    detections = [(scan, i) for scan, count in enumerate(counts) for i in range(count)]

    def grow(position: int, rows: list[list[int]]) -> Iterator[Association]:
        if position == len(detections):
            association = Association(np.array(rows).reshape(len(rows), len(counts)), counts)
            if association.n_missed <= max_missed and len(association.false_alarms) <= max_false:
                yield association
            return
        scan, detection = detections[position]
        yield from grow(position + 1, rows)
        for row in rows:
            if row[scan] == MISSED:
                row[scan] = detection
                yield from grow(position + 1, rows)
                row[scan] = MISSED
        alone = [MISSED] * len(counts)
        alone[scan] = detection
        yield from grow(position + 1, [*rows, alone])

    return grow(0, [])


@settings(max_examples=16, deadline=None)
@given(
    st.sampled_from([(2, 2, 2), (1, 2, 2), (3, 2, 1), (2, 0, 1), (1, 1, 2, 1), (2, 1, 1, 2)]),
    st.integers(0, 3),
    st.integers(0, 2),
    st.booleans(),
    SEEDS,
    st.floats(0.5, 20.0),
)
def test_misses_and_false_alarms_are_those_of_the_joint_program(
    explains: Explains,
    counts: tuple[int, ...],
    max_missed: int,
    max_false: int,
    labelled: bool,
    seed: int,
    degrees: float,
) -> None:
    rng = np.random.default_rng(seed)
    epsilon = float(np.deg2rad(degrees))
    n = max(counts)
    seen = bearings_of("around", n, len(counts), seed, epsilon)
    bearings = [b[rng.permutation(n)[:count]] for b, count in zip(seen, counts, strict=True)]
    names: list[Any] = ["a", "b", None]
    labels = [
        [names[i] for i in rng.permutation(3)[:count]] if labelled else [None] * count
        for count in counts
    ]
    scans = [BearingScan(b, labels=x) for b, x in zip(bearings, labels, strict=True)]
    every = [
        a for a in every_association(counts, max_missed, max_false) if respects_labels(a, scans)
    ]
    try:
        found = consistent_associations(
            StraightRun(scans), epsilon=epsilon, max_missed=max_missed, max_false=max_false
        )
    except UnequalScansError:
        assert not list(every_association(counts, max_missed, max_false))
        return
    assert set(found.associations) <= set(every)
    assert len(set(found.associations)) == len(found)
    if len(every) > 50:
        every = [every[i] for i in rng.choice(len(every), 50)] + list(found.associations[:10])
    assert_program_agrees(explains, bearings, epsilon, found, [a.table.tolist() for a in every])


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_a_search_that_starts_again_lists_nothing_twice(seed: int) -> None:
    # In these scenes runs that were given up had found associations that later runs find again.
    epsilon = float(np.deg2rad(1))
    run = simulate_scene("one_sided", 8, np.random.default_rng(seed), epsilon=epsilon).run
    patient = consistent_associations(run, epsilon=epsilon)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(three_scans, "PATIENCE", 8)
        hasty = consistent_associations(run, epsilon=epsilon)
    assert hasty.complete
    assert hasty.n_nodes > patient.n_nodes
    assert hasty.associations == patient.associations
    assert np.array_equal(hasty.ratio_intervals, patient.ratio_intervals)


def test_nothing_explains_scans_in_the_wrong_order() -> None:
    found = consistent_associations(
        run_of([[2.0, 2.1], [1.0, 1.1], [0.5, 0.6]]), epsilon=np.deg2rad(2)
    )
    assert (len(found), found.complete) == (0, True)
    assert found.ratio_intervals.shape == (0, 1, 2)


def test_a_single_complete_result_is_unique() -> None:
    scene = simulate_scene("annulus", 5, np.random.default_rng(0), epsilon=np.deg2rad(1))
    found = consistent_associations(scene.run, epsilon=np.deg2rad(1), limit=2)
    assert found.complete
    assert found.associations == (scene.truth,)


def test_a_limit_that_is_reached_is_no_certificate() -> None:
    scene = simulate_scene("one_sided", 5, np.random.default_rng(0), epsilon=np.deg2rad(3))
    options = {"epsilon": np.deg2rad(3)}
    every = consistent_associations(scene.run, **options)
    some = consistent_associations(scene.run, limit=7, **options)
    assert every.complete
    assert len(every) > 7
    assert (len(some), some.complete) == (7, False)
    assert set(some.associations) < set(every.associations)
    keys = [a.sort_key() for a in every.associations]
    assert keys == sorted(keys)
    again = consistent_associations(scene.run, limit=7, **options)
    assert again.associations == some.associations


def test_a_search_cut_short_is_no_certificate_and_reports_its_progress() -> None:
    scene = simulate_scene("one_sided", 20, np.random.default_rng(2), epsilon=np.deg2rad(3))
    heard: list[tuple[int, int]] = []
    found = consistent_associations(
        scene.run,
        epsilon=np.deg2rad(3),
        max_nodes=3000,
        progress=lambda done, total: heard.append((done, total)),
    )
    assert not found.complete
    assert found.n_nodes == 3000
    assert heard == [(1024, 3000), (2048, 3000)]


def test_twelve_landmarks_around_the_robot_are_certified_within_a_few_nodes() -> None:
    scene = simulate_scene("annulus", 12, np.random.default_rng(1), epsilon=np.deg2rad(1))
    found = consistent_associations(scene.run, epsilon=np.deg2rad(1))
    assert found.complete
    assert scene.truth in found.associations
    assert found.n_nodes < 200  # of (12!)^2 associations


def test_labels_are_hard_constraints() -> None:
    run = run_of([[0.5, 0.5], [0.8, 0.8], [1.3, 1.3]])
    labelled = StraightRun(
        BearingScan(scan.bearings, labels=labels)
        for scan, labels in zip(run.scans, (["a", None], [None, "a"], [None, None]), strict=True)
    )
    assert len(consistent_associations(run, epsilon=0.05)) == 4
    found = consistent_associations(labelled, epsilon=0.05)
    assert [a.table.tolist() for a in found.associations] == [
        [[0, 1, 0], [1, 0, 1]],
        [[0, 1, 1], [1, 0, 0]],
    ]


def test_the_columns_are_the_scans_asked_for() -> None:
    scene = simulate_scene("annulus", 4, np.random.default_rng(3), epsilon=0.01, n_scans=5)
    found = consistent_associations(scene.run, epsilon=0.01, scans=(0, 2, 4))
    assert found.scans == (0, 2, 4)
    assert scene.truth.restrict((0, 2, 4)) in found.associations
    interval = found.ratio_intervals[found.associations.index(scene.truth.restrict((0, 2, 4)))]
    at = scene.poses[[0, 2, 4], 0]
    assert interval[0, 0] <= (at[2] - at[1]) / (at[1] - at[0]) <= interval[0, 1]


def test_scans_without_detections_are_explained_by_anything() -> None:
    found = consistent_associations(run_of([[], [], [], []]), epsilon=0.1)
    assert [a.table.shape for a in found.associations] == [(0, 4)]
    assert found.ratio_intervals.tolist() == [[[0.0, np.inf], [0.0, np.inf]]]


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"epsilon": 0.0}, OptionError, "epsilon"),
        ({"epsilon": np.pi / 2}, OptionError, "epsilon"),
        ({"limit": 0}, OptionError, "limit"),
        ({"max_missed": -1}, OptionError, "max_missed"),
        ({"max_false": 0.5}, OptionError, "max_false"),
        ({"max_nodes": 0}, OptionError, "max_nodes"),
        ({"scans": (0, 1)}, MeasurementError, "at least 3"),
        ({"scans": (0, 1, 9)}, MeasurementError, "scan 9"),
    ],
)
def test_options_that_make_no_sense_are_refused(
    options: dict[str, Any], error: type[Exception], words: str
) -> None:
    run = run_of([[0.5], [0.8], [1.3], [1.5]])
    with pytest.raises(error, match=words):
        consistent_associations(run, **{"epsilon": 0.1, **options})


def test_what_cannot_be_searched_is_refused() -> None:
    scan = BearingScan([0.5, 1.0])
    with pytest.raises(OptionError, match="no step in common"):
        consistent_associations(RunPair((scan, scan), (scan, scan)), epsilon=0.1)  # type: ignore[arg-type]
    with pytest.raises(UnequalScansError, match="max_missed"):
        consistent_associations(run_of([[0.5], [0.6, 0.7], [0.8]]), epsilon=0.1)
    with pytest.raises(OptionError, match="at most 100"):
        consistent_associations(run_of([np.linspace(0.1, 3, 101)] * 3), epsilon=0.1)
