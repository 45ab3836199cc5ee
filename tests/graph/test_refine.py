"""`refine` keeps to what it says: labels mean nothing, failures have reasons, weights are right."""

from __future__ import annotations

import math
import pickle
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam import (
    Association,
    BearingScan,
    ObservationModel,
    Posterior,
    StraightRun,
    rank,
    refine,
)
from mht_slam.arrays import IntArray
from mht_slam.errors import AssociationError, NoEstimateError, OptionError
from mht_slam.hypotheses import RankedAssociation
from mht_slam.simulation import Scene, simulate_pair, simulate_scene

SIGMA = math.radians(1.0)
KEEP: IntArray = np.repeat(np.arange(3), 3).reshape(3, 3)
SWAP: IntArray = np.array([[0, 0, 0], [1, 1, 2], [2, 2, 1]])
COUNTS = (3, 3, 3)


def a_scene(seed: int = 0, n_scans: int = 3) -> Scene:
    return simulate_scene("annulus", 3, np.random.default_rng(seed), sigma=SIGMA, n_scans=n_scans)


def some_candidates(scene: Scene) -> list[Association]:
    """The truth and its single exchanges in the last scan."""
    tables = [scene.truth.table]
    for i, j in ((0, 1), (0, 2), (1, 2)):
        table = scene.truth.table.copy()
        table[[i, j], -1] = table[[j, i], -1]
        tables.append(table)
    return [Association(table, scene.truth.n_detections) for table in tables]


def evidence_of(posterior: Posterior) -> dict[Association, float]:
    return {h.association: h.log_evidence for h in posterior}


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 1000))
def test_permuting_the_detections_changes_labels_only(seed: int) -> None:
    scene = a_scene(seed)
    rng = np.random.default_rng(seed)
    orders = [rng.permutation(3) for _ in range(3)]
    run = StraightRun(
        BearingScan(scan.bearings[order]) for scan, order in zip(scene.scans, orders, strict=True)
    )
    candidates = some_candidates(scene)
    renamed = [
        Association(
            np.column_stack([np.argsort(o)[c.table[:, k]] for k, o in enumerate(orders)]), COUNTS
        )
        for c in candidates
    ]
    before = evidence_of(refine(scene.run, candidates, sigma=SIGMA))
    after = evidence_of(refine(run, renamed, sigma=SIGMA))
    for old, new in zip(candidates, renamed, strict=True):
        if before[old] > max(before.values()) - 30.0:  # hopeless ones stop where they stop
            assert after[new] == pytest.approx(before[old], abs=1e-6)


@pytest.mark.parametrize("heading_sigma", [0.0, 0.02])
@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 1000))
def test_mirroring_the_world_mirrors_the_map_and_keeps_the_evidence(
    seed: int, heading_sigma: float
) -> None:
    scene = a_scene(seed)
    mirrored = StraightRun(BearingScan(-scan.bearings) for scan in scene.scans)
    here, there = (
        refine(run, [scene.truth], sigma=SIGMA, heading_sigma=heading_sigma)[0]
        for run in (scene.run, mirrored)
    )
    assert there.log_evidence == pytest.approx(here.log_evidence, abs=1e-6)
    assert here.landmarks is not None and there.landmarks is not None
    assert there.landmarks * [1.0, -1.0] == pytest.approx(here.landmarks, rel=1e-4, abs=1e-4)


def test_the_order_of_candidates_and_their_repetition_mean_nothing() -> None:
    scene = a_scene()
    candidates = some_candidates(scene)
    once = refine(scene.run, candidates, sigma=SIGMA)
    again = refine(scene.run, candidates[::-1] + candidates, sigma=SIGMA)
    assert [h.association for h in once] == [h.association for h in again]
    assert [h.probability for h in once] == [h.probability for h in again]


def test_the_posterior_is_sorted_and_sums_to_one() -> None:
    scene = a_scene()
    posterior = refine(scene.run, some_candidates(scene), sigma=SIGMA)
    evidence = [h.log_evidence for h in posterior]
    assert evidence == sorted(evidence, reverse=True)
    assert sum(h.probability for h in posterior) == pytest.approx(1.0)
    ratio = math.exp(evidence[1] - evidence[0])
    assert posterior[1].probability == pytest.approx(ratio * posterior[0].probability)
    assert posterior[0].association == scene.truth
    marginal = posterior.marginal_same_landmark()
    assert marginal.shape == (9, 9)
    assert (marginal == marginal.T).all() and (np.diag(marginal) == 1.0).all()


def test_no_candidates_give_an_empty_posterior() -> None:
    assert len(refine(a_scene().run, [], sigma=SIGMA)) == 0


def test_a_scans_own_sigma_goes_before_the_argument() -> None:
    scene = a_scene()
    own = StraightRun(BearingScan(scan.bearings, sigma=0.05) for scan in scene.scans)
    candidates = some_candidates(scene)
    stated = refine(own, candidates, sigma=SIGMA)
    assert evidence_of(stated) == evidence_of(refine(scene.run, candidates, sigma=0.05))
    assert evidence_of(refine(own, candidates)) == evidence_of(stated)


def test_without_any_sigma_nothing_is_guessed() -> None:
    with pytest.raises(OptionError, match="sigma is not known"):
        refine(a_scene().run, [], sigma=None)


def test_a_candidate_that_contradicts_labels_fails_with_a_reason() -> None:
    scene = a_scene()
    labels = [[f"landmark {row}" for row in rows] for rows in scene.truth.landmark_of_detection()]
    run = StraightRun(
        BearingScan(scan.bearings, labels=names)
        for scan, names in zip(scene.scans, labels, strict=True)
    )
    posterior = refine(run, some_candidates(scene), sigma=SIGMA)
    assert posterior[0].probability == 1.0 and posterior[0].association == scene.truth
    for h in posterior[1:]:
        assert h.failure is not None and "labels" in h.failure
        assert h.log_evidence == -math.inf and h.probability == 0.0


def test_associations_of_different_size_need_a_model_that_compares_them() -> None:
    scene = a_scene()
    smaller = Association(scene.truth.table[:2], COUNTS)
    with pytest.raises(OptionError, match="detection_probability"):
        refine(scene.run, [scene.truth, smaller], sigma=SIGMA)


def test_weights_of_detections_misses_landmarks_and_false_alarms_are_those_of_the_model() -> None:
    scene = a_scene()
    model = ObservationModel(
        sigma=SIGMA, detection_probability=0.9, false_alarm_rate=0.2, expected_landmarks=4.0
    )
    missed = scene.truth.table.copy()
    missed[0, 2] = -1
    smaller = Association(missed, COUNTS)
    for association, seen, misses, false in ((scene.truth, 9, 0, 0), (smaller, 8, 1, 1)):
        bare = refine(scene.run, [association], sigma=SIGMA)[0]
        full = refine(scene.run, [association], model=model)[0]
        weight = 3 * math.log(4.0) + seen * math.log(0.9) + misses * math.log(0.1)
        weight += false * math.log(0.2)
        assert full.log_evidence - bare.log_evidence == pytest.approx(weight, abs=1e-9)
        gained = full.log_likelihood - bare.log_likelihood
        assert gained == pytest.approx(false * math.log(0.2), abs=1e-9)
    both = refine(scene.run, [scene.truth, smaller], model=model)
    assert both[0].association == scene.truth


def test_what_the_model_rules_out_fails_with_a_reason() -> None:
    scene = a_scene()
    model = ObservationModel(
        sigma=SIGMA, detection_probability=1.0, false_alarm_rate=0.0, expected_landmarks=4.0
    )
    smaller = Association(scene.truth.table[:2], COUNTS)
    posterior = refine(scene.run, [smaller, scene.truth], model=model)
    assert posterior[0].association == scene.truth
    assert posterior[1].failure is not None and "rules out" in posterior[1].failure


def test_a_landmark_seen_once_has_a_finite_estimate_and_says_that_it_has_no_range() -> None:
    scene = a_scene()
    table = np.vstack([scene.truth.table[:2], [[scene.truth.table[2, 0], -1, -1]]])
    h = refine(scene.run, [Association(table, COUNTS)], sigma=SIGMA)[0]
    assert h.failure is None
    assert h.ranged is not None and h.landmark_covariances is not None
    assert sorted(h.ranged.tolist()) == [False, True, True]
    single = int(np.flatnonzero(~h.ranged)[0])
    largest = np.linalg.eigvalsh(h.landmark_covariances[single])[-1]
    assert largest == pytest.approx(30.0**2, rel=0.01)  # along the ray only the prior speaks


IMPOSSIBLE = {
    "all on the axis ahead": [[0.0, 0.0, 0.0]] * 3,
    "all behind": [[math.pi] * 3] * 3,
    "parallel": [[0.5, 1.0, 2.0]] * 3,
    "moving backwards": [[0.9, 1.4, 2.4], [0.7, 1.2, 2.0], [0.5, 1.0, 1.6]],
    "duplicates": [[1.0, 1.0, 1.0], [1.5, 1.5, 1.5], [2.0, 2.0, 2.0]],
    "sides exchanged": [[0.5, 1.0, 2.0], [-0.7, -1.2, -2.2], [0.9, 1.4, 2.4]],
    "opposite": [[0.0, 0.1, -0.1], [math.pi, 3.0, -3.0], [0.0, 0.1, -0.1]],
}


@pytest.mark.parametrize("case", IMPOSSIBLE)
@pytest.mark.parametrize("heading_sigma", [0.0, 0.02])
def test_impossible_scans_give_numbers_or_reasons_but_never_nan(
    case: str, heading_sigma: float
) -> None:
    run = StraightRun(BearingScan(bearings) for bearings in IMPOSSIBLE[case])
    candidates = [Association(KEEP, COUNTS), Association(SWAP, COUNTS)]
    for h in refine(run, candidates, sigma=SIGMA, heading_sigma=heading_sigma):
        assert not math.isnan(h.log_evidence) and not math.isnan(h.probability)
        if h.failure is None:
            for array in (h.poses, h.landmarks, h.landmark_covariances, h.pose_covariances):
                assert array is not None and np.isfinite(array).all()
        else:
            assert h.failure and h.log_evidence == -math.inf and h.probability == 0.0
            with pytest.raises(NoEstimateError, match="no estimate"):
                h.to_gtsam()


def test_metres_scale_lengths_and_leave_probabilities() -> None:
    scene = a_scene()
    candidates = some_candidates(scene)
    baselines = refine(scene.run, candidates, sigma=SIGMA)
    metres = refine(scene.run, candidates, sigma=SIGMA, scale=4.0)
    assert (baselines.unit, metres.unit) == ("baseline", "metre")
    for b, m in zip(baselines, metres, strict=True):
        assert m.association == b.association
        assert m.probability == pytest.approx(b.probability, abs=1e-5)
    b, m = baselines[0], metres[0]
    assert b.poses is not None and m.poses is not None
    assert m.poses == pytest.approx(b.poses * [4.0, 4.0, 1.0], abs=1e-3)
    assert b.landmarks is not None and b.landmark_covariances is not None
    assert m.landmarks == pytest.approx(4.0 * b.landmarks, rel=1e-3)
    assert m.landmark_covariances == pytest.approx(16.0 * b.landmark_covariances, rel=0.02)


@pytest.mark.parametrize("kind", ["threads", "processes"])
def test_an_executor_gives_the_same_bytes(kind: str) -> None:
    scene = a_scene()
    candidates = some_candidates(scene)
    serial = refine(scene.run, candidates, sigma=SIGMA)
    executor: Executor = (
        ThreadPoolExecutor(2)
        if kind == "threads"
        else ProcessPoolExecutor(1, mp_context=get_context("spawn"))
    )
    with executor:
        pooled = refine(scene.run, candidates, sigma=SIGMA, executor=executor)
    for s, p in zip(serial, pooled, strict=True):
        assert s == p
        assert s.poses is not None and p.poses is not None
        assert s.poses.tobytes() == p.poses.tobytes()
    graph, values, _ = pooled[0].to_gtsam()
    assert graph.error(values) == serial[0].to_gtsam()[0].error(values)
    assert pickle.loads(pickle.dumps(serial))[0] == serial[0]  # noqa: S301 - our own bytes


def test_progress_is_reported_to_the_end() -> None:
    scene = a_scene()
    calls: list[tuple[int, int]] = []
    refine(
        scene.run,
        some_candidates(scene),
        sigma=SIGMA,
        progress=lambda done, total: calls.append((done, total)),
    )
    assert calls == [(k, 4) for k in (1, 2, 3, 4)]


def test_a_ranked_candidate_keeps_its_score() -> None:
    scene = a_scene()
    ranked = RankedAssociation(scene.truth, 0.25, (0, 1))
    assert refine(scene.run, [ranked], sigma=SIGMA)[0].score == 0.25


def test_candidates_of_other_scans_or_types_are_refused() -> None:
    scene = a_scene()
    with pytest.raises(AssociationError, match="detections"):
        refine(scene.run, [Association([[0, 0]], (3, 3))], sigma=SIGMA)
    with pytest.raises(AssociationError, match="give a Ranking or associations"):
        refine(scene.run, [[0, 0, 0]], sigma=SIGMA)  # type: ignore[list-item]
    with pytest.raises(OptionError, match="evidence"):
        refine(scene.run, [scene.truth], sigma=SIGMA, evidence="guess")  # type: ignore[arg-type]
    with pytest.raises(AssociationError, match="list of associations"):
        refine(scene.run, scene.truth, sigma=SIGMA)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="run is tuple"):
        refine(scene.scans, [scene.truth], sigma=SIGMA)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="model is float"):
        refine(scene.run, [scene.truth], model=SIGMA)  # type: ignore[arg-type]


def test_a_posterior_is_refined_over_its_own_scans() -> None:
    scene = a_scene()
    longer = StraightRun([scene.scans[0], *scene.scans])
    posterior = refine(longer, rank(longer, epsilon=0.05, scans=(1, 2, 3)), sigma=SIGMA)
    again = refine(longer, posterior, sigma=SIGMA)
    assert again.scans == posterior.scans == (1, 2, 3)
    assert again.hypotheses == posterior.hypotheses
    with pytest.raises(AssociationError, match="candidates of this run"):
        refine(scene.run, posterior, sigma=SIGMA)


def test_a_scan_without_detections_needs_no_sigma() -> None:
    scans = [BearingScan(b, sigma=0.01) for b in ([0.5, 1.0, 2.0], [0.6, 1.2, 2.1])]
    run = StraightRun([*scans, BearingScan([])])
    candidate = Association([[0, 0, -1], [1, 1, -1], [2, 2, -1]], run.n_detections)
    assert refine(run, [candidate]).model.sigma == 0.01


def test_a_longer_run_is_solved_as_one() -> None:
    scene = a_scene(n_scans=5)
    posterior = refine(scene.run, some_candidates(scene), sigma=SIGMA)
    best = posterior[0]
    assert best.association == scene.truth
    assert best.poses is not None and best.poses.shape == (5, 3)
    assert best.poses[:, 0] == pytest.approx(scene.poses[:, 0], rel=0.1, abs=1e-3)


def test_two_runs_are_put_into_one_frame() -> None:
    scene = simulate_pair("annulus", 4, np.random.default_rng(3), sigma=math.radians(0.3))
    posterior = refine(scene.pair, some_candidates(scene), sigma=math.radians(0.3))
    best = posterior[0]
    assert best.association == scene.truth
    assert best.poses is not None and best.pose_covariances is not None
    error = best.poses[2:] - scene.poses[2:]
    sigmas = np.sqrt(best.pose_covariances[2:, [0, 1, 2], [0, 1, 2]])
    error[:, 2] = np.angle(np.exp(1j * error[:, 2]))
    assert (np.abs(error) < 5.0 * sigmas).all()


def test_rays_too_parallel_for_the_arithmetic_give_a_result_without_a_warning():
    run = StraightRun([BearingScan([0.5, 1.0, 2.0])] * 3)
    posterior = refine(run, [Association([[i] * 3 for i in range(3)], (3, 3, 3))], sigma=1e-12)
    assert posterior[0].failure or np.isfinite(posterior[0].log_evidence)


@pytest.mark.parametrize(
    "extreme", [{"landmark_sigma": 1e300}, {"landmark_sigma": 1e-300}, {"log_step_mean": 700.0}]
)
def test_a_model_beyond_double_precision_gives_failures_and_no_exception(extreme):
    run = StraightRun([BearingScan([0.5, 1.0, 2.0])] * 3)
    association = Association([[i] * 3 for i in range(3)], (3, 3, 3))
    posterior = refine(run, [association], model=ObservationModel(sigma=0.02, **extreme))
    assert posterior[0].failure or np.isfinite(posterior[0].log_evidence)


@pytest.mark.parametrize("scale", [1e-9, 1e6])
def test_a_scale_at_which_the_graph_would_break_down_is_refused(scale: float) -> None:
    scene = a_scene()
    with pytest.raises(OptionError, match="scale is"):
        refine(scene.run, [scene.truth], sigma=SIGMA, scale=scale)


@pytest.mark.parametrize("scale", [1e-3, 1e4])
def test_the_evidence_does_not_depend_on_the_scale(scale: float) -> None:
    scene = a_scene()
    for evidence in ("marginal", "laplace"):
        as_it_is = refine(scene.run, [scene.truth], sigma=SIGMA, evidence=evidence)
        in_metres = refine(scene.run, [scene.truth], sigma=SIGMA, evidence=evidence, scale=scale)
        assert in_metres[0].log_evidence == pytest.approx(as_it_is[0].log_evidence, abs=1e-3)


def test_a_sigma_too_small_for_the_solver_is_a_failure_that_says_so() -> None:
    scene = a_scene()
    model = ObservationModel(sigma=SIGMA, motion="smooth", turn_sigma=1e-12)
    posterior = refine(scene.run, [scene.truth], model=model)
    assert posterior[0].failure is not None and "below 1e-8" in posterior[0].failure
