"""The exact ranking is the exhaustive one, and proves it or says how far it may be off."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.arrays import FloatArray
from mht_slam.association import respects_labels
from mht_slam.errors import MhtSlamError
from mht_slam.hypotheses import Ranking
from mht_slam.measurements import BearingScan, RunPair, StraightRun
from mht_slam.polygon import exact
from mht_slam.polygon.ranking import rank
from mht_slam.simulation import simulate_pair, simulate_scene

SEEDS = st.integers(0, 2**32 - 1)
KINDS = ["annulus", "one_sided", "corridor", "clusters", "noise", "axis", "duplicates", "parallel"]


def bearings_of(kind: str, n: int, epsilon: float, rng: np.random.Generator) -> list[FloatArray]:
    """Three scans of a world, or of no world at all."""
    if kind == "noise":
        return [rng.uniform(-np.pi, np.pi, n) for _ in range(3)]
    if kind == "axis":  # landmarks straight ahead, behind, and one aside
        angles = [rng.choice([0.0, np.pi, 0.5 * np.pi], n) for _ in range(3)]
        return [a + rng.uniform(-epsilon, epsilon, n) for a in angles]
    if kind == "parallel":  # all far away
        angles = rng.uniform(-np.pi, np.pi, n)
        return [rng.permutation(angles) + rng.uniform(-epsilon, epsilon, n) for _ in range(3)]
    layout = "annulus" if kind == "duplicates" else kind
    scans = simulate_scene(layout, n, rng, epsilon=epsilon).scans  # type: ignore[arg-type]
    bearings = [scan.bearings.copy() for scan in scans]
    if kind == "duplicates":
        for bearing in bearings:
            bearing[-1] = bearing[0]
    return bearings


def assert_same(found: Ranking, expected: Ranking) -> None:
    assert found.complete
    assert found.gap == 0.0
    assert found.base == expected.base
    assert [h.association for h in found] == [h.association for h in expected]
    assert [h.score for h in found] == pytest.approx([h.score for h in expected], abs=1e-9)
    assert [h.zero_reason for h in found] == [h.zero_reason for h in expected]


def compare(run: StraightRun | RunPair, epsilon: float, **options: Any) -> None:
    assert_same(
        rank(run, epsilon=epsilon, method="exact", **options),
        rank(run, epsilon=epsilon, method="exhaustive", **options),
    )


@given(SEEDS, st.sampled_from(KINDS), st.integers(3, 5), st.floats(0.3, 12.0), st.data())
@settings(max_examples=250, deadline=None)
def test_exact_is_exhaustive(
    seed: int, kind: str, n: int, epsilon_deg: float, data: st.DataObject
) -> None:
    epsilon = np.deg2rad(epsilon_deg)
    bearings = bearings_of(kind, n, epsilon, np.random.default_rng(seed))
    compare(
        StraightRun(BearingScan(b) for b in bearings),
        epsilon,
        top_k=data.draw(st.sampled_from([1, 3, 10, None])),
        ratio=data.draw(st.sampled_from(["iou", "overlap"])),
        region=data.draw(st.sampled_from(["edges", "edges", "vertices"])),
        max_range=data.draw(st.sampled_from([8.0, 100.0])),
    )


@given(SEEDS, st.integers(3, 4), st.integers(0, 2), st.integers(0, 2), st.booleans())
@settings(max_examples=60, deadline=None)
def test_with_misses_and_false_alarms_too(
    seed: int, n: int, max_missed: int, max_false: int, include_zero: bool
) -> None:
    rng = np.random.default_rng(seed)
    epsilon = np.deg2rad(3)
    bearings = bearings_of("annulus", n, epsilon, rng)
    if max_missed:
        bearings[int(rng.integers(3))] = bearings[0][1:] if n > 3 else bearings[0]
    if max_false:
        place = int(rng.integers(3))
        bearings[place] = np.append(bearings[place], rng.uniform(-np.pi, np.pi))
    run = StraightRun(BearingScan(b) for b in bearings)
    options = {"max_missed": max_missed, "max_false": max_false, "include_zero": include_zero}
    try:
        expected = rank(run, epsilon=epsilon, method="exhaustive", **options)  # type: ignore[arg-type]
    except MhtSlamError as refusal:
        with pytest.raises(type(refusal)):
            rank(run, epsilon=epsilon, **options)  # type: ignore[arg-type]
        return
    assert_same(rank(run, epsilon=epsilon, **options), expected)  # type: ignore[arg-type]


@given(SEEDS, st.sampled_from([1, 10, None]), st.sampled_from(["iou", "overlap"]))
@settings(max_examples=25, deadline=None)
def test_for_pairs_of_runs_too(seed: int, top_k: int | None, ratio: str) -> None:
    scene = simulate_pair("annulus", 3, np.random.default_rng(seed), epsilon=np.deg2rad(3))
    compare(scene.pair, np.deg2rad(3), top_k=top_k, ratio=ratio)


@given(SEEDS, st.integers(3, 5), st.integers(0, 4))
@settings(max_examples=40, deadline=None)
def test_labels_are_hard_constraints_for_both(seed: int, n: int, n_labels: int) -> None:
    rng = np.random.default_rng(seed)
    epsilon = np.deg2rad(3)
    scans = []
    for b in bearings_of("one_sided", n, epsilon, rng):
        labels = [None] * n
        for name in range(n_labels):
            if rng.random() < 0.6:
                labels[int(rng.integers(n))] = f"cone {name}"  # type: ignore[call-overload]
        scans.append(BearingScan(b, labels=labels))
    run = StraightRun(scans)
    compare(run, epsilon)
    assert all(respects_labels(h.association, scans) for h in rank(run, epsilon=epsilon))


@pytest.mark.parametrize("seed", range(3))
def test_with_seven_landmarks_too(seed: int) -> None:
    scene = simulate_scene("one_sided", 7, np.random.default_rng(seed), epsilon=np.deg2rad(1))
    compare(scene.run, np.deg2rad(1), top_k=25)


@given(SEEDS, st.integers(1, 400))
@settings(max_examples=30, deadline=None)
def test_a_list_cut_short_bounds_what_it_missed(seed: int, work_limit: int) -> None:
    epsilon = np.deg2rad(3)
    run = simulate_scene("one_sided", 5, np.random.default_rng(seed), epsilon=epsilon).run
    whole = rank(run, epsilon=epsilon, method="exhaustive", top_k=10)
    cut = rank(run, epsilon=epsilon, top_k=10, work_limit=work_limit)
    # What was begun is ended: 20 base pairs bounded, or 3 landmarks x 3 x 3 ratios and a list.
    assert cut.n_steps <= work_limit + 60
    if cut.complete:
        assert_same(cut, whole)
        return
    listed = {h.association for h in cut}
    last = cut[-1].score if len(cut) else 0.0
    missed = [h.score for h in whole if h.association not in listed]
    assert max(missed, default=0.0) <= last + cut.gap + 1e-9


def test_base_pairs_that_take_long_are_taken_up_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exact, "_FIRST_PATIENCE", 1)
    monkeypatch.setattr(exact, "_MORE_PATIENCE", 2)
    monkeypatch.setattr(exact, "_FOUND_AT_ONCE", 2)
    scene = simulate_scene("one_sided", 6, np.random.default_rng(1), epsilon=np.deg2rad(2))
    compare(scene.run, np.deg2rad(2), top_k=40)


def test_twenty_landmarks_are_ranked_with_a_proof() -> None:
    scene = simulate_scene("annulus", 20, np.random.default_rng(1), epsilon=np.deg2rad(1))
    ranking = rank(scene.run, epsilon=np.deg2rad(1))
    assert ranking.complete
    assert len(ranking) == 10
    assert ranking.n_steps < 100_000


def test_progress_ends_with_everything_decided() -> None:
    scene = simulate_scene("annulus", 5, np.random.default_rng(1), epsilon=np.deg2rad(3))
    heard: list[tuple[int, int]] = []
    rank(scene.run, epsilon=np.deg2rad(3), progress=lambda done, total: heard.append((done, total)))
    assert heard[-1][0] == heard[-1][1] > 0
    assert all(0 <= done <= total for done, total in heard)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "noise"])
def test_the_scenes_that_are_compared_are_not_all_empty(kind: str) -> None:
    epsilon = np.deg2rad(6)
    n_listed = [
        len(rank(StraightRun(map(BearingScan, bearings)), epsilon=epsilon))
        for bearings in (
            bearings_of(kind, 4, epsilon, np.random.default_rng(seed)) for seed in range(12)
        )
    ]
    assert max(n_listed) > 0


def test_scores_that_round_to_zero_are_among_the_zeros() -> None:
    rng = np.random.default_rng(35)
    bearings = [rng.uniform(0.0, 1.2, 3) for _ in range(3)]
    epsilon = np.deg2rad(rng.uniform(0.2, 20.0))
    run = StraightRun(BearingScan(b) for b in bearings)
    max_range = float(10.0 ** rng.uniform(1.0, 6.0))
    for top_k in (1, 5, 9, 20, None):
        compare(run, epsilon, top_k=top_k, include_zero=True, max_range=max_range)


def test_work_is_limited_with_misses_and_false_alarms_too() -> None:
    rng = np.random.default_rng(3)
    epsilon = np.deg2rad(3)
    bearings = bearings_of("annulus", 6, epsilon, rng)
    bearings[2] = bearings[2][:-1]
    run = StraightRun(BearingScan(b) for b in bearings)
    for work_limit in (1, 100, 1000):
        cut = rank(run, epsilon=epsilon, max_missed=2, max_false=2, work_limit=work_limit)
        assert cut.complete or cut.gap >= 0.0
    assert not rank(run, epsilon=epsilon, max_missed=2, max_false=2, work_limit=1).complete
