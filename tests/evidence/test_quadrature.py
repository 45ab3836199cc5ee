"""Evidence by quadrature is the dense integral, and the list of the best is that of all."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import logsumexp

from mht_slam import (
    Association,
    BearingScan,
    ObservationModel,
    RankedAssociation,
    Ranking,
    RunPair,
    StraightRun,
    compare,
    evidence_by_quadrature,
    rank_by_evidence,
    refine,
)
from mht_slam.errors import AssociationError, NoEstimateError, OptionError, UnequalScansError
from mht_slam.simulation import Scene, simulate_scene

KINDS = ("annulus", "one_sided", "corridor", "clusters")
SIGMAS_DEG = (0.1, 0.5, 1.0, 3.0, 7.0)
WITHIN = 15.0
LISTED = 40.0


def scene_of(kind: Any, n: int, sigma_deg: float, seed: int) -> tuple[Scene, ObservationModel]:
    sigma = math.radians(sigma_deg)
    scene = simulate_scene(kind, n, np.random.default_rng(seed), sigma=sigma)
    return scene, ObservationModel(sigma=sigma)


def sized(model: ObservationModel) -> ObservationModel:
    return replace(model, detection_probability=0.9, false_alarm_rate=0.05, expected_landmarks=3.0)


@pytest.mark.parametrize(
    ("kind", "n", "sigma_deg", "place", "half_width", "nodes"),
    [
        ("annulus", 3, 0.3, 0, 0.1, 13),
        ("one_sided", 3, 7.0, 5, 5.0, 19),
    ],
)
def test_evidence_is_the_dense_integral(
    kind: str,
    n: int,
    sigma_deg: float,
    place: int,
    half_width: float,
    nodes: int,
    full_associations: Callable[[int], list[Association]],
    association_by_dense_sum: Callable[..., float],
) -> None:
    scene, model = scene_of(kind, n, sigma_deg, 4)
    h = evidence_by_quadrature(scene.run, full_associations(n), model=model)[place]
    centre = refine(scene.run, [h.association], model=model)[0]
    assert centre.poses is not None
    middle = math.log(centre.poses[2, 0] - 1.0)
    grid = np.linspace(middle - half_width, middle + half_width, nodes)
    dense = association_by_dense_sum(scene.scans, h.association, model, grid)
    assert h.log_evidence == pytest.approx(dense, abs=2e-3)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sigma_deg", [0.1, 1.0, 3.0])
def test_evidence_is_what_the_graph_finds_with_landmarks_integrated_out(
    kind: str, sigma_deg: float, full_associations: Callable[[int], list[Association]]
) -> None:
    scene, model = scene_of(kind, 3, sigma_deg, 1)
    posterior = evidence_by_quadrature(scene.run, full_associations(3), model=model)
    near = [h for h in posterior if h.log_evidence > posterior[0].log_evidence - 8.0][:6]
    graph = {
        h.association: h.log_evidence
        for h in refine(scene.run, [h.association for h in near], model=model)
    }
    for h in near:
        assert h.log_evidence == pytest.approx(graph[h.association], abs=2e-3)


def test_misses_and_false_alarms_have_the_weights_of_refine() -> None:
    scene, model = scene_of("annulus", 3, 1.0, 6)
    model = sized(model)
    table = scene.truth.table
    partly = table.copy()
    partly[0, 2] = -1
    candidates = [
        scene.truth,
        Association(partly, (3, 3, 3)),
        Association(table[1:], (3, 3, 3)),
    ]
    graph = {h.association: h for h in refine(scene.run, candidates, model=model)}
    for h in evidence_by_quadrature(scene.run, candidates, model=model):
        assert h.log_evidence == pytest.approx(graph[h.association].log_evidence, abs=2e-3)


@settings(max_examples=5, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    kind=st.sampled_from(KINDS),
    sigma_deg=st.sampled_from(SIGMAS_DEG),
    n=st.sampled_from((3, 3, 4)),
    top_k=st.sampled_from((1, 5, 20)),
)
def test_the_best_are_those_of_all_full_tables(
    seed: int,
    kind: str,
    sigma_deg: float,
    n: int,
    top_k: int,
    full_associations: Callable[[int], list[Association]],
) -> None:
    scene, model = scene_of(kind, n, sigma_deg, seed)
    posterior = rank_by_evidence(scene.run, model=model, top_k=top_k)
    everything = evidence_by_quadrature(scene.run, full_associations(n), model=model)
    hold_against(posterior, everything, top_k)


@settings(max_examples=5, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    kind=st.sampled_from(KINDS),
    sigma_deg=st.sampled_from(SIGMAS_DEG),
    n=st.sampled_from((2, 2, 3)),
    limits=st.sampled_from(((1, 0), (0, 1), (2, 1), (1, 2), (3, 1))),
    with_clutter=st.booleans(),
)
def test_the_best_are_those_of_all_tables_with_misses_and_false_alarms(
    seed: int,
    kind: str,
    sigma_deg: float,
    n: int,
    limits: tuple[int, int],
    with_clutter: bool,
    associations_within: Callable[..., list[Association]],
) -> None:
    scene, model = scene_of(kind, n, sigma_deg, seed)
    scans = list(scene.scans)
    max_missed, max_false = limits if n == 2 else (1, 1)
    if with_clutter and max_false:
        clutter = np.random.default_rng(seed).uniform(-3.0, 3.0)
        scans[seed % 3] = BearingScan(np.append(scans[seed % 3].bearings, clutter))
    run = StraightRun(scans)
    posterior = rank_by_evidence(
        run, model=sized(model), max_missed=max_missed, max_false=max_false
    )
    candidates = associations_within(run.n_detections, max_missed, max_false)
    hold_against(posterior, evidence_by_quadrature(run, candidates, model=sized(model)), 10)


def hold_against(posterior: Any, everything: Any, top_k: int) -> None:
    """The list is the top of all associations, and what it says of the rest is true."""
    best = everything[0].log_evidence
    evidence = {h.association: h.log_evidence for h in everything}
    assert posterior.complete
    expected = [e for e in sorted(evidence.values(), reverse=True) if e > best - LISTED][:top_k]
    assert len(posterior) == len(expected) or abs(expected[-1] - best + LISTED) < 0.1
    for h, value in zip(posterior, expected, strict=False):
        tolerance = 1e-3 if value > best - WITHIN else 0.05
        assert h.log_evidence == pytest.approx(value, abs=tolerance)
        assert h.log_evidence == pytest.approx(evidence[h.association], abs=tolerance)
    listed = {h.association for h in posterior}
    total = logsumexp(list(evidence.values()))
    outside = math.fsum(math.exp(e - total) for a, e in evidence.items() if a not in listed)
    assert posterior.covered >= outside * (1.0 - 1e-3) - 1e-12
    inside = 1.0 - outside
    for h in posterior:
        assert h.probability == pytest.approx(
            math.exp(evidence[h.association] - total) / inside, abs=2e-3
        )


@settings(max_examples=3, deadline=None)
@given(
    seed=st.integers(0, 10_000), kind=st.sampled_from(KINDS), sigma_deg=st.sampled_from((0.5, 3.0))
)
def test_numbering_and_mirroring_mean_nothing(seed: int, kind: str, sigma_deg: float) -> None:
    scene, model = scene_of(kind, 4, sigma_deg, seed)
    rng = np.random.default_rng(seed)
    orders = [rng.permutation(4) for _ in range(3)]
    renumbered = StraightRun(
        BearingScan(scan.bearings[order]) for scan, order in zip(scene.scans, orders, strict=True)
    )
    mirrored = StraightRun(BearingScan(-scan.bearings) for scan in scene.scans)
    here = rank_by_evidence(scene.run, model=model)
    back = [
        Association(
            np.stack([order[h.association.table[:, k]] for k, order in enumerate(orders)], axis=1),
            (4, 4, 4),
        )
        for h in rank_by_evidence(renumbered, model=model)
    ]
    there = {h.association: h.log_evidence for h in rank_by_evidence(mirrored, model=model)}
    for h in here[:5]:
        if h.log_evidence > here[0].log_evidence - WITHIN:
            assert h.association in back
            assert there[h.association] == pytest.approx(h.log_evidence, abs=1e-4)


def run_with_a_double() -> tuple[StraightRun, ObservationModel]:
    """Two landmarks in one place: four associations of the same evidence."""
    scene, model = scene_of("annulus", 3, 1.0, 3)
    bearings = [scan.bearings[scene.truth.table[:, k]] for k, scan in enumerate(scene.scans)]
    return StraightRun(BearingScan(b[[0, 1, 2, 2]]) for b in bearings), model


def test_detections_that_are_equal_share_their_evidence_and_go_by_the_table() -> None:
    run, model = run_with_a_double()
    posterior = rank_by_evidence(run, model=model, top_k=4)
    assert len(posterior) == 4
    first = [h for h in posterior if h.log_evidence > posterior[0].log_evidence - 1e-6]
    assert len(first) == 4
    keys = [h.association.sort_key() for h in first]
    assert keys == sorted(keys)


def test_a_list_cut_within_a_tie_takes_the_first_tables() -> None:
    run, model = run_with_a_double()
    four = rank_by_evidence(run, model=model, top_k=4)
    two = rank_by_evidence(run, model=model, top_k=2)
    assert [h.association for h in two] == [h.association for h in four][:2]
    assert two.covered == pytest.approx(0.5, abs=1e-3)


def test_labels_are_hard_constraints() -> None:
    scene, model = scene_of("annulus", 3, 1.0, 0)
    free = rank_by_evidence(scene.run, model=model)
    i, m = scene.truth.table[0, :2]
    wrong = (m + 1) % 3
    scans = list(scene.scans)
    for scan, named in ((0, i), (1, wrong)):
        labels = [None] * 3
        labels[named] = "a"
        scans[scan] = BearingScan(scans[scan].bearings, labels=labels)
    forced = rank_by_evidence(StraightRun(scans), model=sized(model), max_missed=1, max_false=1)
    assert free[0].association == scene.truth
    assert len(forced)
    for h in forced:
        rows = h.association.landmark_of_detection()
        assert rows[0][i] == rows[1][wrong] != -1
    refused = evidence_by_quadrature(StraightRun(scans), [scene.truth], model=model)[0]
    assert refused.log_evidence == -math.inf and "labels" in str(refused.failure)


def test_labels_that_leave_nothing_leave_an_empty_list() -> None:
    scene, model = scene_of("annulus", 3, 1.0, 0)
    names = (("a", "b", "c"), ("a", "b", "d"), ("a", "b", "c"))
    run = StraightRun(
        BearingScan(scan.bearings, labels=labels)
        for scan, labels in zip(scene.scans, names, strict=True)
    )
    posterior = rank_by_evidence(run, model=model)
    assert len(posterior) == 0 and posterior.complete and posterior.covered == 0.0


def test_scans_that_contradict_each_other_still_have_a_best_association() -> None:
    rng = np.random.default_rng(2)
    run = StraightRun(BearingScan(rng.uniform(-3.0, 3.0, 4)) for _ in range(3))
    posterior = rank_by_evidence(run, sigma=math.radians(0.1))
    assert posterior.complete and len(posterior)
    assert posterior[0].log_evidence < -1000.0


def test_a_search_cut_short_says_so_and_bounds_the_rest() -> None:
    scene, model = scene_of("one_sided", 4, 7.0, 2)
    whole = rank_by_evidence(scene.run, model=model, top_k=5)
    short = rank_by_evidence(scene.run, model=model, top_k=5, work_limit=8)
    assert whole.complete and not short.complete
    assert short.covered is not None and 0.0 < short.covered <= 1.0
    listed = {h.association for h in short}
    missing = sum(h.probability for h in whole if h.association not in listed)
    assert short.covered >= 0.9 * missing * (1.0 - (whole.covered or 0.0))


def test_nothing_seen_is_one_empty_association() -> None:
    model = sized(ObservationModel(sigma=0.02))
    nothing = StraightRun([BearingScan([])] * 3)
    posterior = rank_by_evidence(nothing, model=model)
    assert [h.association.n_landmarks for h in posterior] == [0]
    clutter = StraightRun([BearingScan([0.3]), BearingScan([]), BearingScan([])])
    only_false = rank_by_evidence(clutter, model=model, max_false=1)
    assert only_false[0].association.false_alarms == ((0, 0),)
    assert only_false[0].log_evidence == pytest.approx(math.log(0.05), abs=1e-9)


def test_a_ranking_brings_its_scans_and_scores() -> None:
    scene = simulate_scene(
        "annulus", 3, np.random.default_rng(0), sigma=math.radians(1.0), n_scans=4
    )
    truth = scene.truth.restrict((0, 1, 3))
    ranking = Ranking(
        (RankedAssociation(truth, 0.7, (0, 1)),), (0, 1, 3), (0, 1), True, 0.0, math.radians(3.0)
    )
    posterior = evidence_by_quadrature(scene.run, ranking, sigma=math.radians(1.0))
    assert posterior.scans == (0, 1, 3)
    assert [h.score for h in posterior] == [0.7]
    comparison = compare(ranking, posterior, truth)
    assert comparison.truth_evidence_rank == 1
    assert all(row.log_likelihood is None for row in comparison.rows)
    with pytest.raises(NoEstimateError, match="refine makes estimates"):
        posterior[0].to_gtsam()


def test_refusals_name_the_remedy() -> None:
    scene, model = scene_of("annulus", 3, 1.0, 0)
    pair = RunPair(scene.scans[:2], scene.scans[:2])
    for call in (rank_by_evidence, lambda run, **o: evidence_by_quadrature(run, [], **o)):
        with pytest.raises(OptionError, match="refine"):
            call(pair, model=model)
        with pytest.raises(OptionError, match=r"heading_sigma.*refine"):
            call(scene.run, model=replace(model, heading_sigma=0.01))
        with pytest.raises(OptionError, match=r"lateral_sigma.*refine"):
            call(scene.run, model=replace(model, lateral_sigma=0.01))
        with pytest.raises(OptionError, match="sigma is not known"):
            call(scene.run)
    with pytest.raises(OptionError, match="detection_probability"):
        rank_by_evidence(scene.run, model=model, max_missed=1)
    with pytest.raises(OptionError, match="differ in their numbers"):
        partly = Association(scene.truth.table[1:], (3, 3, 3))
        evidence_by_quadrature(scene.run, [scene.truth, partly], model=model)
    with pytest.raises(AssociationError):
        evidence_by_quadrature(scene.run, [Association([], (1, 1, 1))], model=model)
    uneven = StraightRun([BearingScan([0.1, 0.2]), BearingScan([0.3]), BearingScan([0.4])])
    with pytest.raises(UnequalScansError, match="max_missed"):
        rank_by_evidence(uneven, model=sized(model), max_missed=1)
    assert len(rank_by_evidence(uneven, model=sized(model), max_missed=2))


@pytest.mark.parametrize("log_step_sigma", [2.0, 10.0])
def test_a_wide_step_prior_makes_no_evidence_up(log_step_sigma: float) -> None:
    """Far from the posterior the tables fall by thousands of nats from knot to knot."""
    model = ObservationModel(sigma=0.02, log_step_sigma=log_step_sigma)
    together = Association([[0, 0, 0], [1, 1, 1]], (2, 2, 2))
    for seed in range(12):
        rng = np.random.default_rng(seed)
        sides, distances = rng.choice([-1, 1], 2), 10.0 ** rng.uniform(-0.7, 1.0, 2)
        places = np.column_stack([rng.uniform(-2.0, 5.0, 2), sides * distances])
        run = StraightRun(
            BearingScan(np.arctan2(places[:, 1], places[:, 0] - x) + rng.normal(0.0, 0.02, 2))
            for x in (0.0, 1.0, 1.0 + rng.uniform(0.3, 3.0))
        )
        expected = refine(run, [together], model=model)[0].log_evidence
        found = evidence_by_quadrature(run, [together], model=model)[0].log_evidence
        assert found == pytest.approx(expected, abs=0.01), f"seed {seed}"
        best = rank_by_evidence(run, model=model)
        assert best.complete
        listed = {h.association: h.log_evidence for h in best}
        assert listed[together] == pytest.approx(expected, abs=0.01), f"seed {seed}"


def test_step_priors_wider_than_the_tables_are_refused() -> None:
    run = StraightRun([BearingScan([0.7]), BearingScan([0.8]), BearingScan([1.0])])
    with pytest.raises(OptionError, match="log_step_sigma is 100"):
        rank_by_evidence(run, model=ObservationModel(sigma=0.02, log_step_sigma=100.0))


def test_sigmas_that_the_tables_do_not_resolve_are_refused() -> None:
    run = StraightRun([BearingScan([0.7]), BearingScan([0.8], sigma=1e-4), BearingScan([1.0])])
    with pytest.raises(OptionError, match=r"sigma is 0\.0001: quadrature resolves"):
        rank_by_evidence(run, sigma=0.02)
    with pytest.raises(OptionError, match="use refine"):
        evidence_by_quadrature(run, [], sigma=0.02)


def test_scans_that_contradict_each_other_utterly_fit_into_memory() -> None:
    """Landmarks within a millionth of one point, and bearings that say otherwise."""
    bearings = [[1.83, 3.0, 1.83], [1.83, 1.83, 3.0], [1.83, 1.83, 3.0]]
    run = StraightRun(BearingScan(b) for b in bearings)
    model = ObservationModel(sigma=0.02, landmark_sigma=1e-6)
    best = rank_by_evidence(run, model=model, work_limit=10)
    assert best.complete or best.covered == 1.0
    assert all(np.isfinite(h.log_evidence) for h in best)


def test_clusters_in_contradiction_leave_the_list_as_it_is() -> None:
    bearings_deg = [
        [-101.4, 178.6],
        [-109.88, 29.53, 179.45],
        [-0.36, -177.64, -110.29, 28.56],
    ]
    run = StraightRun(BearingScan(np.deg2rad(b)) for b in bearings_deg)
    model = ObservationModel(
        sigma=np.deg2rad(3.0) / np.sqrt(3.0),
        landmark_sigma=5.0,
        detection_probability=0.9,
        false_alarm_rate=0.1,
        expected_landmarks=3.0,
    )
    few = rank_by_evidence(run, model=model, max_missed=1, max_false=1, top_k=3)
    many = rank_by_evidence(run, model=model, max_missed=4, max_false=3, top_k=3)
    assert few[0].association == many[0].association
    assert few[0].log_evidence == pytest.approx(many[0].log_evidence, abs=1e-3)
    given = evidence_by_quadrature(run, [h.association for h in many], model=model)
    for listed, direct in zip(many, given, strict=True):
        assert listed.log_evidence == pytest.approx(direct.log_evidence, abs=5e-3)


def test_probabilities_sum_to_one_where_evidences_are_coarser_than_nats() -> None:
    """Landmarks said to be a billion baselines from where they are seen."""
    run = StraightRun([BearingScan([-2.356] * 3, sigma=0.5)] * 3)
    model = replace(sized(ObservationModel(sigma=0.02)), landmark_centre=(1e9, -1e9))
    tables = ([[0, 0, 0], [1, 1, 1], [2, -1, 2]], [[0, 0, 0], [1, 1, 1], [2, 2, 2]])
    posterior = evidence_by_quadrature(
        run, [Association(t, (3, 3, 3)) for t in tables], model=model
    )
    assert sum(h.probability for h in posterior) == pytest.approx(1.0, abs=1e-12)
