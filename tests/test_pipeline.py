"""The whole method finds the truth of the paper's scene, and its parts agree with each other."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from mht_slam import compare, rank, refine, solve
from mht_slam.simulation import paper_scene, simulate_pair

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
