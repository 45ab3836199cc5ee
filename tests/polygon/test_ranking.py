"""The ranking against a slow oracle, its order, its invariances and its maps."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from itertools import pairwise, permutations
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import shapely
import shapely.affinity
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mht_slam.association import MISSED, Association
from mht_slam.measurements import BearingScan, RunPair, StraightRun
from mht_slam.polygon.base import choose_base
from mht_slam.polygon.ranking import rank

from .conftest import (
    EPSILON,
    SEEDS,
    STEPS,
    Floats,
    as_pair,
    as_run,
    assert_same_scores,
    easy_run,
    landmarks_of,
    pair_bearings,
    scores_of,
    straight_bearings,
)


def identity(n: int, m: int) -> Association:
    return Association(np.tile(np.arange(n)[:, None], m), (n,) * m)


# --- a slow oracle -----------------------------------------------------------------------------


def oracle_cell(first: float, second: float, epsilon: float, max_range: float) -> Any:
    """Intersection of four half planes and a square cut to a 64-sided disc."""
    cell = shapely.Point(0.5, 0.0).buffer(max_range / np.cos(np.pi / 64), quad_segs=16)
    cell = shapely.affinity.rotate(cell, 180.0 / 64.0, origin=(0.5, 0.0))
    for apex, bearing in ((0.0, first), (1.0, second)):
        for edge, side in ((bearing - epsilon, 1.0), (bearing + epsilon, -1.0)):
            along = 1e4 * np.array([np.cos(edge), np.sin(edge)])
            left = side * np.array([-along[1], along[0]])
            origin = np.array([apex, 0.0])
            half_plane = shapely.Polygon(
                [origin - along, origin + along, origin + along + left, origin - along + left]
            ).convex_hull
            cell = cell.intersection(half_plane)
    return cell


def oracle_region(p1: Any, p2: Any, p3: Any, per_edge: int) -> Any:
    def boundary(cell: Any) -> npt.NDArray[np.complex128]:
        points = []
        xy = np.array(cell.exterior.coords)
        for start, end in pairwise(xy):
            places = np.linspace(0.0, 1.0, per_edge, endpoint=False)
            points += [complex(*(start + t * (end - start))) for t in places]
        return np.array(points)

    a, b = boundary(p1), boundary(p2)
    hulls = []
    for x, y in list(p3.exterior.coords)[:-1]:
        z = ((complex(x, y) - a[:, None]) / (b[None, :] - a[:, None])).ravel()
        hulls.append(shapely.MultiPoint(np.column_stack([z.real, z.imag])).convex_hull)
    return shapely.unary_union(hulls).convex_hull


def oracle_score(
    bearings: Sequence[Floats],
    rows: Sequence[Sequence[int]],
    pairs: Sequence[tuple[int, int]],
    base: tuple[int, int],
    *,
    ratio: str,
    max_range: float,
    per_edge: int = 40,
) -> float:
    """The score of one full hypothesis, straight from its definition."""
    by_middle = {row[1]: row for row in rows}
    cells = [
        {
            m: oracle_cell(bearings[a][row[a]], bearings[b][row[b]], EPSILON, max_range)
            for m, row in by_middle.items()
        }
        for a, b in pairs
    ]
    if any(cell.area == 0.0 for view in cells for cell in view.values()):
        return 0.0
    if any(view[base[0]].intersects(view[base[1]]) for view in cells):
        return 0.0
    ratios = []
    for m in by_middle:
        if m in base:
            continue
        one, other = (oracle_region(v[base[0]], v[base[1]], v[m], per_edge) for v in cells)
        shared = one.intersection(other).area
        whole = one.union(other).area if ratio == "iou" else min(one.area, other.area)
        ratios.append(shared / whole)
    return float(np.prod(ratios) ** (1.0 / len(ratios)))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("ratio", ["iou", "overlap"])
def test_scores_of_a_straight_run_follow_the_definition(seed: int, ratio: str) -> None:
    bearings = straight_bearings(seed, 3)
    run = as_run(bearings)
    base = choose_base(run.scans[1].bearings, range(3))
    found = scores_of(run, include_zero=True, ratio=ratio, max_range=8.0)
    for association, score in found.items():
        expected = oracle_score(
            bearings,
            association.table.tolist(),
            ((0, 1), (1, 2)),
            base,
            ratio=ratio,
            max_range=8.0,
        )
        assert score == pytest.approx(expected, abs=0.012)
        assert (score > 0.0) == (expected > 0.0) or max(score, expected) < 1e-3


@pytest.mark.parametrize("seed", range(2))
def test_scores_with_four_landmarks_are_geometric_means(seed: int) -> None:
    bearings = straight_bearings(seed + 50, 4)
    ranking = rank(as_run(bearings), epsilon=EPSILON, max_range=8.0)
    for h in ranking.hypotheses[:5]:
        expected = oracle_score(
            bearings,
            h.association.table.tolist(),
            ((0, 1), (1, 2)),
            ranking.base,
            ratio="iou",
            max_range=8.0,
            per_edge=25,
        )
        assert h.score == pytest.approx(expected, abs=0.015)


@pytest.mark.parametrize("seed", range(3))
def test_scores_of_a_pair_of_runs_follow_the_definition(seed: int) -> None:
    bearings = pair_bearings(seed, 3)
    pair = as_pair(bearings)
    base = choose_base(pair.scans[1].bearings, range(3))
    ranking = rank(pair, epsilon=EPSILON, top_k=None, max_range=8.0)
    for h in ranking.hypotheses[:12]:
        expected = oracle_score(
            bearings,
            h.association.table.tolist(),
            ((0, 1), (2, 3)),
            base,
            ratio="iou",
            max_range=8.0,
            per_edge=25,
        )
        assert h.score == pytest.approx(expected, abs=0.015)


# --- every association once, and the order ------------------------------------------------------


def sort_key(association: Association, score: float) -> tuple[Any, ...]:
    table = association.table
    full = int((table != MISSED).all(axis=1).sum())
    return -full, -round(score, 12), np.where(table == MISSED, 99, table).ravel().tolist()


@pytest.mark.parametrize("seed", range(3))
def test_all_full_associations_of_a_run_are_listed_once_and_in_order(seed: int) -> None:
    ranking = rank(
        as_run(straight_bearings(seed, 3)), epsilon=EPSILON, top_k=None, include_zero=True
    )
    expected = {
        Association(np.column_stack([p, range(3), q]), (3, 3, 3))
        for p in permutations(range(3))
        for q in permutations(range(3))
    }
    listed = [h.association for h in ranking]
    assert len(listed) == 36 == ranking.n_scored
    assert set(listed) == expected
    keys = [sort_key(h.association, h.score) for h in ranking]
    assert keys == sorted(keys)


def test_all_full_associations_of_a_pair_of_runs_are_listed_once() -> None:
    ranking = rank(as_pair(pair_bearings(1, 3)), epsilon=EPSILON, top_k=None, include_zero=True)
    assert len({h.association for h in ranking}) == len(ranking) == 6**3
    keys = [sort_key(h.association, h.score) for h in ranking]
    assert keys == sorted(keys)
    assert ranking.scans == (0, 1, 2, 3)


def all_associations(counts: Sequence[int], max_missed: int, max_false: int) -> set[Association]:
    """Every association within the budgets, by adding detections to rows one after another."""
    found: set[Association] = set()
    detections = [(scan, d) for scan, count in enumerate(counts) for d in range(count)]

    def grow(rest: list[tuple[int, int]], rows: list[list[int]], n_false: int) -> None:
        if not rest:
            a = Association(np.array(rows).reshape(-1, len(counts)), counts)
            if a.n_missed <= max_missed:
                found.add(a)
            return
        (scan, d), *later = rest
        if n_false < max_false:
            grow(later, rows, n_false + 1)
        for row in rows:
            if row[scan] == MISSED:
                more = [[*r[:scan], d, *r[scan + 1 :]] if r is row else r for r in rows]
                grow(later, more, n_false)
        grow(later, [*rows, [d if s == scan else MISSED for s in range(len(counts))]], n_false)

    grow(detections, [], 0)
    return found


@pytest.mark.parametrize(
    ("counts", "max_missed", "max_false"),
    [((3, 3, 3), 0, 1), ((3, 3, 3), 1, 1), ((4, 3, 3), 0, 1), ((4, 4, 3), 1, 0), ((3, 3, 3), 2, 0)],
)
def test_partial_associations_are_all_listed_once_and_in_order(
    counts: tuple[int, ...], max_missed: int, max_false: int
) -> None:
    bearings = [b[:c] for b, c in zip(straight_bearings(7, 4), counts, strict=True)]
    ranking = rank(
        as_run(bearings),
        epsilon=EPSILON,
        top_k=None,
        include_zero=True,
        max_missed=max_missed,
        max_false=max_false,
    )
    listed = [h.association for h in ranking]
    assert len(listed) == len(set(listed)) == ranking.n_scored
    assert set(listed) == all_associations(counts, max_missed, max_false)
    keys = [sort_key(h.association, h.score) for h in ranking]
    assert keys == sorted(keys)
    assert all((h.score == 0.0) == (h.zero_reason is not None) for h in ranking)


def test_partial_associations_of_a_pair_of_runs_are_all_listed_once() -> None:
    bearings = pair_bearings(3, 3)
    ranking = rank(as_pair(bearings), epsilon=EPSILON, top_k=None, include_zero=True, max_missed=1)
    listed = [h.association for h in ranking]
    assert len(listed) == len(set(listed)) == 6**3
    wide = rank(
        as_pair([np.append(bearings[0], 1.0), *bearings[1:]]),
        epsilon=EPSILON,
        top_k=None,
        include_zero=True,
        max_false=1,
    )
    assert len({h.association for h in wide}) == len(wide) == 4 * 6**3


def test_a_partial_hypothesis_scores_what_its_full_landmarks_score_alone() -> None:
    bearings = straight_bearings(11, 4)
    whole = as_run([bearings[0], bearings[1], bearings[2][:3]])
    alone = as_run([b[:3] for b in bearings])
    full = scores_of(alone)
    found = scores_of(whole, max_missed=1)
    truth = Association([[0, 0, 0], [1, 1, 1], [2, 2, 2], [3, 3, -1]], (4, 4, 3))
    assert found[truth] == pytest.approx(full[identity(3, 3)], abs=1e-12)


def test_a_partly_seen_landmark_without_a_cell_makes_the_score_zero() -> None:
    landmarks = np.array([[0.5, 2.0], [2.0, -2.0], [3.0, 1.5]])
    bearings = [np.arctan2(landmarks[:, 1], landmarks[:, 0] - x) for x in STEPS]
    diverging = [np.append(bearings[0], 2.5), np.append(bearings[1], 0.5), bearings[2]]
    zero = Association([[0, 0, 0], [1, 1, 1], [2, 2, 2], [3, 3, -1]], (4, 4, 3))
    ranking = rank(as_run(diverging), epsilon=EPSILON, top_k=None, include_zero=True, max_missed=1)
    found = next(h for h in ranking if h.association == zero)
    assert found.score == 0.0
    assert found.zero_reason == "a cell of landmark 3 is empty"


@given(SEEDS, st.integers(1, 12), st.booleans())
@settings(max_examples=20, deadline=None)
def test_top_k_is_the_head_of_the_full_list(seed: int, top_k: int, include_zero: bool) -> None:
    run = as_run(straight_bearings(seed, 3))
    options = {"include_zero": include_zero, "max_false": 1, "max_missed": 1}
    whole = rank(run, epsilon=EPSILON, top_k=None, **options)  # type: ignore[arg-type]
    head = rank(run, epsilon=EPSILON, top_k=top_k, **options)  # type: ignore[arg-type]
    assert [h.association for h in head] == [h.association for h in whole][:top_k]
    assert head.complete
    assert head.gap == 0.0


# --- invariances ---------------------------------------------------------------------------------


@given(SEEDS, st.integers(3, 4))
@settings(max_examples=20, deadline=None)
def test_permuting_detections_changes_nothing_but_labels(seed: int, n: int) -> None:
    bearings = straight_bearings(seed, n)
    rng = np.random.default_rng(seed)
    orders = [rng.permutation(n) for _ in bearings]
    permuted = scores_of(as_run([b[o] for b, o in zip(bearings, orders, strict=True)]))
    back = {
        Association(
            np.column_stack([o[a.table[:, s]] for s, o in enumerate(orders)]), a.n_detections
        ): score
        for a, score in permuted.items()
    }
    assert_same_scores(scores_of(as_run(bearings)), back)


@given(SEEDS, st.integers(3, 4))
@settings(max_examples=20, deadline=None)
def test_mirroring_the_world_changes_nothing(seed: int, n: int) -> None:
    bearings = straight_bearings(seed, n)
    assert_same_scores(scores_of(as_run(bearings)), scores_of(as_run([-b for b in bearings])))


@given(SEEDS, st.integers(3, 4))
@settings(max_examples=20, deadline=None)
def test_driving_the_run_backwards_changes_nothing_but_columns(seed: int, n: int) -> None:
    bearings = straight_bearings(seed, n)
    reversed_run = as_run([b + np.pi for b in bearings[::-1]])
    back = {
        Association(a.table[:, ::-1], a.n_detections): score
        for a, score in scores_of(reversed_run).items()
    }
    assert_same_scores(scores_of(as_run(bearings)), back)


@given(SEEDS)
@settings(max_examples=12, deadline=None)
def test_swapping_the_runs_of_a_pair_with_the_same_base_changes_nothing(seed: int) -> None:
    bearings = pair_bearings(seed, 3)
    swapped_bearings = [bearings[2], bearings[3], bearings[0], bearings[1]]
    for h in rank(as_pair(bearings), epsilon=EPSILON, top_k=3, base=(0, 2)):
        row_of = {row[1]: row for row in h.association.table.tolist()}
        same_base = (row_of[0][3], row_of[2][3])
        swapped = scores_of(as_pair(swapped_bearings), base=same_base)
        table = h.association.table[:, [2, 3, 0, 1]]
        assert swapped[Association(table, (3, 3, 3, 3))] == pytest.approx(h.score, abs=1e-9)


@given(SEEDS)
@settings(max_examples=10, deadline=None)
def test_permuting_mirroring_a_pair_of_runs_changes_nothing_but_labels(seed: int) -> None:
    bearings = pair_bearings(seed, 3)
    order = np.random.default_rng(seed).permutation(3)
    changed = scores_of(as_pair([-b[order] for b in bearings]))
    back = {Association(order[a.table], a.n_detections): s for a, s in changed.items()}
    assert_same_scores(scores_of(as_pair(bearings)), back)


@given(SEEDS, st.integers(3, 4), st.floats(0.01, 0.12), st.booleans())
@settings(max_examples=40, deadline=None)
def test_the_truth_has_a_positive_score_when_noise_stays_inside_epsilon(
    seed: int, n: int, epsilon: float, two_runs: bool
) -> None:
    if two_runs:
        n = 3
        run: StraightRun | RunPair = as_pair(pair_bearings(seed, n, epsilon))
    else:
        run = as_run(straight_bearings(seed, n, epsilon))
    m = 4 if two_runs else 3
    ranking = rank(run, epsilon=epsilon, top_k=None, include_zero=True)
    truth = [h for h in ranking if h.association == identity(n, m)]
    assert truth[0].score > 0.0 or "base cells" in str(truth[0].zero_reason)


# --- the map ------------------------------------------------------------------------------------


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_the_map_holds_true_landmarks_and_observation_points(seed: int) -> None:
    bearings = straight_bearings(seed, 4)
    ranking = rank(as_run(bearings), epsilon=EPSILON, top_k=None, refine_pair=(0, 2))
    truth = next((h for h in ranking if h.association == identity(4, 3)), None)
    assume(truth is not None)
    assert truth is not None
    drawn = truth.map_in_landmark_frame
    assert drawn is not None
    points = landmarks_of(seed, 4) @ [1.0, 1j]
    first, second = points[list(drawn.base)]
    for number, region in enumerate(drawn.landmarks):
        z = (points[number] - first) / (second - first)
        assert region.name == f"landmark {number}"
        assert [pair for pair, _ in region.by_pair][:2] == [(0, 1), (1, 2)]
        for _, geometry in region.by_pair:
            assert geometry.distance(shapely.Point(z.real, z.imag)) < 1e-9
        assert region.intersection.distance(shapely.Point(z.real, z.imag)) < 1e-9
    for x, region in zip(STEPS, drawn.observation_points, strict=True):
        z = (x - first) / (second - first)
        assert region.intersection.distance(shapely.Point(z.real, z.imag)) < 1e-9


def test_the_map_names_its_pairs_and_the_refining_pair_narrows_it() -> None:
    run = StraightRun([BearingScan([9.0]), *easy_run().scans])
    plain = rank(run, epsilon=EPSILON, scans=(1, 2, 3))
    refined = rank(run, epsilon=EPSILON, scans=(1, 2, 3), refine_pair=(1, 3))
    assert plain.scans == (1, 2, 3)
    assert [h.score for h in plain] == [h.score for h in refined]
    wide, narrow = plain[0].map_in_landmark_frame, refined[0].map_in_landmark_frame
    assert wide is not None
    assert narrow is not None
    seen_by = {
        region.name: [pair for pair, _ in region.by_pair] for region in wide.observation_points
    }
    assert seen_by == {"O1": [(1, 2)], "O2": [(1, 2), (2, 3)], "O3": [(2, 3)]}
    seen_by = {r.name: [pair for pair, _ in r.by_pair] for r in narrow.observation_points}
    assert seen_by == {"O1": [(1, 2), (1, 3)], "O2": [(1, 2), (2, 3)], "O3": [(2, 3), (1, 3)]}
    for before, after in zip(wide.landmarks, narrow.landmarks, strict=True):
        assert after.intersection.area <= before.intersection.area
    first, second = (wide.landmarks[row].intersection for row in wide.base)
    assert (first, second) == (shapely.Point(0.0, 0.0), shapely.Point(1.0, 0.0))
    assert not wide.cut


def test_the_map_of_a_pair_of_runs_has_each_observation_point_from_its_own_run() -> None:
    ranking = rank(as_pair(pair_bearings(0, 3)), epsilon=EPSILON)
    drawn = ranking[0].map_in_landmark_frame
    assert drawn is not None
    seen_by = {r.name: [pair for pair, _ in r.by_pair] for r in drawn.observation_points}
    assert seen_by == {"O1": [(0, 1)], "O2": [(0, 1)], "O3": [(2, 3)], "O4": [(2, 3)]}


def test_the_ratios_of_the_map_give_the_score() -> None:
    best = rank(easy_run(), epsilon=EPSILON)[0]
    drawn = best.map_in_landmark_frame
    assert drawn is not None
    ratios = [
        region.intersection.area / region.by_pair[0][1].union(region.by_pair[1][1]).area
        for row, region in enumerate(drawn.landmarks)
        if row not in drawn.base
    ]
    assert best.score == pytest.approx(float(np.prod(ratios) ** 0.5), abs=1e-9)


def test_ranked_hypotheses_survive_pickling_with_their_maps() -> None:
    best = rank(easy_run(), epsilon=EPSILON)[0]
    again = pickle.loads(pickle.dumps(best))  # noqa: S301
    assert again.map_in_landmark_frame == best.map_in_landmark_frame


def test_no_map_is_drawn_where_the_frame_does_not_exist() -> None:
    bearings = straight_bearings(2, 3)
    for h in rank(as_run(bearings), epsilon=EPSILON, top_k=None, include_zero=True):
        if h.zero_reason is not None and "base" in h.zero_reason:
            assert h.map_in_landmark_frame is None
        else:
            assert h.map_in_landmark_frame is not None
