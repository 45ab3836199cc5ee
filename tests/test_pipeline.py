"""The whole method finds the truth of the paper's scene, and its parts agree with each other."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from mht_slam import (
    Association,
    BearingScan,
    ObservationModel,
    Odometry,
    StraightRun,
    compare,
    rank,
    refine,
    solve,
)
from mht_slam.errors import (
    AssociationError,
    MhtSlamError,
    OptionError,
    UnequalScansError,
)
from mht_slam.models import Motion
from mht_slam.simulation import Scene, paper_scene, simulate_pair, simulate_scene

EPSILON = math.radians(2.0)
SIGMA = EPSILON / math.sqrt(3.0)


def test_the_papers_scene_is_solved() -> None:
    scene = paper_scene(np.random.default_rng(0), epsilon=EPSILON)
    solution = solve(scene.run, epsilon=EPSILON, sigma=SIGMA, truth=scene.truth)
    assert solution.posterior[0].association.exact(scene.truth)
    assert solution.comparison.truth_evidence_rank == 1
    assert solution.comparison.truth_polygon_rank is not None


def test_the_solution_is_what_its_parts_say() -> None:
    scene = paper_scene(np.random.default_rng(1), epsilon=EPSILON)
    calls: list[tuple[int, int]] = []
    solution = solve(
        scene.run,
        epsilon=EPSILON,
        sigma=SIGMA,
        top_k=5,
        truth=scene.truth,
        progress=lambda done, total: calls.append((done, total)),
    )
    ranking = rank(scene.run, epsilon=EPSILON, top_k=5)
    posterior = refine(scene.run, ranking, sigma=SIGMA)
    assert [h.association for h in solution.ranking] == [h.association for h in ranking]
    assert [h.probability for h in solution.posterior] == [h.probability for h in posterior]
    assert solution.comparison == compare(ranking, posterior, scene.truth)
    assert calls[-1] == (len(ranking), len(ranking))
    scores = {h.association: h.score for h in ranking}
    assert all(h.score == scores[h.association] for h in solution.posterior)


def test_an_executor_refines_and_changes_nothing() -> None:
    scene = paper_scene(np.random.default_rng(1), epsilon=EPSILON)
    serial = solve(scene.run, epsilon=EPSILON, sigma=SIGMA)
    with ThreadPoolExecutor(1) as executor:
        pooled = solve(scene.run, epsilon=EPSILON, sigma=SIGMA, executor=executor)
    assert pooled.posterior == serial.posterior


def test_a_known_baseline_gives_metres() -> None:
    scene = paper_scene(np.random.default_rng(2), epsilon=EPSILON)
    solution = solve(scene.run, epsilon=EPSILON, sigma=SIGMA, scale=12.0)
    assert solution.posterior.unit == "metre"
    best = solution.posterior[0]
    assert best.poses is not None
    assert abs(best.poses[1, 0] - 12.0) < 0.1


def test_a_pair_of_runs_is_solved() -> None:
    epsilon = math.radians(1.0)
    scene = simulate_pair("annulus", 3, np.random.default_rng(4), epsilon=epsilon)
    solution = solve(scene.pair, epsilon=epsilon, sigma=epsilon / 2.0, top_k=10)
    assert len(solution.posterior) == len(solution.ranking) <= 10


def long_scene(n_scans: int = 5) -> Scene:
    return simulate_scene(
        "corridor", 4, np.random.default_rng(2), sigma=math.radians(1.0), n_scans=n_scans
    )


def test_a_longer_run_is_solved_over_all_its_scans() -> None:
    scene = long_scene()
    calls: list[tuple[int, int]] = []
    solution = solve(
        scene.run,
        epsilon=EPSILON,
        sigma=SIGMA,
        truth=scene.truth,
        progress=lambda done, total: calls.append((done, total)),
    )
    assert solution.posterior.scans == (0, 1, 2, 3, 4)
    assert solution.posterior[0].association == scene.truth
    assert solution.ranking.scans == (0, 1, 2)
    assert solution.seeds is not None
    assert solution.comparison == compare(
        solution.ranking, solution.seeds, scene.truth.restrict((0, 1, 2))
    )
    assert sum(h.probability for h in solution.posterior) == pytest.approx(1.0)
    assert calls


def test_three_scans_named_are_solved_alone() -> None:
    scene = long_scene()
    alone = solve(scene.run, epsilon=EPSILON, sigma=SIGMA, scans=(0, 2, 4))
    assert alone.posterior.scans == (0, 2, 4)
    assert alone.seeds is None


def test_headings_that_wander_enlarge_the_rankings_epsilon() -> None:
    scene = long_scene(3)
    solution = solve(scene.run, epsilon=EPSILON, sigma=SIGMA, heading_sigma=0.01)
    assert solution.ranking.epsilon == pytest.approx(math.hypot(EPSILON, 0.02))


def test_scans_of_different_length_are_solved_without_polygons() -> None:
    scene = long_scene()
    scans = [
        BearingScan(scan.bearings[1:] if k == 1 else scan.bearings)
        for k, scan in enumerate(scene.scans)
    ]
    table = scene.truth.table.copy()
    table[table[:, 1] == 0, 1] = -1
    table[:, 1] -= table[:, 1] > 0
    model = ObservationModel(
        sigma=SIGMA, detection_probability=0.9, false_alarm_rate=0.01, expected_landmarks=4.0
    )
    solution = solve(StraightRun(scans), epsilon=EPSILON, model=model)
    assert len(solution.ranking) == 0
    assert "detections" in solution.ranking.options["not_ranked"]
    assert solution.posterior[0].association.exact(
        Association(table, [len(scan) for scan in scans])
    )


def test_scans_of_different_length_need_a_model_that_compares_sizes() -> None:
    scans = [BearingScan(b) for b in ([0.1, 0.5, 1.0], [0.2, 0.6], [0.3, 0.7], [0.4, 0.9])]
    with pytest.raises(UnequalScansError, match="detections"):
        solve(StraightRun(scans), epsilon=EPSILON, sigma=SIGMA)


def test_the_same_run_gives_the_same_solution() -> None:
    scene = long_scene()
    first, second = (solve(scene.run, epsilon=EPSILON, sigma=SIGMA) for _ in range(2))
    assert first.posterior == second.posterior


def test_free_motion_is_solved_over_three_scans_only() -> None:
    scene = long_scene(4)
    model = ObservationModel(sigma=SIGMA, motion="free")
    with pytest.raises(OptionError, match="name three"):
        solve(scene.run, epsilon=EPSILON, model=model)
    assert len(solve(scene.run, epsilon=EPSILON, model=model, scans=(0, 1, 2)).posterior)


def test_certain_detection_and_no_false_alarms_leave_the_truth() -> None:
    scene = long_scene(4)
    model = ObservationModel(
        sigma=SIGMA, detection_probability=1.0, false_alarm_rate=0.0, expected_landmarks=4.0
    )
    posterior = solve(scene.run, epsilon=EPSILON, model=model).posterior
    assert posterior[0].association == scene.truth
    assert posterior[0].failure is None


def test_wrong_types_are_named() -> None:
    run = long_scene(4).run
    with pytest.raises(OptionError, match="effort is int"):
        solve(run, epsilon=EPSILON, sigma=SIGMA, effort=5)  # type: ignore[arg-type]
    with pytest.raises(AssociationError, match="truth is list"):
        solve(run, epsilon=EPSILON, sigma=SIGMA, truth=[[0]])  # type: ignore[arg-type]
    with pytest.raises(MhtSlamError, match="scans"):
        solve(run, epsilon=EPSILON, sigma=SIGMA, scans=())  # type: ignore[arg-type]


@pytest.mark.parametrize("motion", ["straight", "smooth"])
def test_every_motion_model_solves_a_straight_run(motion: Motion) -> None:
    scene = long_scene(4)
    model = ObservationModel(sigma=SIGMA, motion=motion, step_change_sigma=1.0)
    solution = solve(scene.run, epsilon=EPSILON, model=model)
    assert solution.posterior[0].association == scene.truth


def test_odometry_gives_metres() -> None:
    scene = long_scene(5)
    scans = [
        BearingScan(
            scan.bearings,
            odometry=Odometry(2.0 * step, 0.0, 0.0, covariance=[1e-4, 1e-4, 1e-6]),
        )
        for scan, step in zip(scene.scans, [1.0, *np.diff(scene.poses[:, 0]).tolist()], strict=True)
    ]
    model = ObservationModel(sigma=SIGMA, motion="odometry")
    posterior = solve(StraightRun(scans), epsilon=EPSILON, model=model).posterior
    best = posterior[0]
    assert best.association == scene.truth
    assert posterior.unit == "metre"
    assert best.poses is not None
    assert best.poses[:, 0] == pytest.approx(2.0 * scene.poses[:, 0], abs=0.1)
