"""The search over all scans finds what trying every association finds."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

import mht_slam as ms
from mht_slam.errors import UnequalScansError
from mht_slam.graph.problem import make_problem
from mht_slam.simulation import simulate_scene
from mht_slam.tree.effort import Effort
from mht_slam.tree.search import search_all_scans

SIGMA = math.radians(1.0)
STRAIGHT = ms.ObservationModel(sigma=SIGMA)
SMOOTH = ms.ObservationModel(
    sigma=SIGMA, motion="smooth", turn_sigma=math.radians(2.0), step_change_sigma=0.6
)
MISSING = ms.ObservationModel(
    sigma=SIGMA, detection_probability=0.8, false_alarm_rate=0.05, expected_landmarks=3.0
)


def full_associations(n: int, m: int) -> list[ms.Association]:
    """Every association of m scans of n detections that are all seen."""
    orders = list(itertools.permutations(range(n)))
    return [
        ms.Association(np.column_stack([np.arange(n), *(np.array(o) for o in later)]), [n] * m)
        for later in itertools.product(orders, repeat=m - 1)
    ]


def partitions(counts: tuple[int, ...]) -> list[ms.Association]:
    """Every association: detections together, alone, or false alarms."""
    m = len(counts)
    rows = list(itertools.product(*(range(-1, count) for count in counts)))[1:]

    def extended(chosen: list[tuple[int, ...]], first: int) -> list[list[tuple[int, ...]]]:
        found = [chosen]
        for i in range(first, len(rows)):
            used = [{row[k] for row in chosen} - {-1} for k in range(m)]
            if all(d not in used[k] for k, d in enumerate(rows[i]) if d >= 0):
                found += extended([*chosen, rows[i]], i + 1)
        return found

    tables = extended([], 0)
    return [ms.Association(np.array(t, dtype=np.int64).reshape(-1, m), counts) for t in tables]


def pairs_of(association: ms.Association) -> ms.Association:
    """The association without landmarks seen once, so that readings of single detections agree."""
    table = association.table
    return ms.Association(table[(table >= 0).sum(axis=1) >= 2], association.n_detections)


@pytest.mark.parametrize("model", [STRAIGHT, SMOOTH], ids=["straight", "smooth"])
@pytest.mark.parametrize("seed", [3, 9])
def test_the_search_names_the_best_of_all_full_associations(
    model: ms.ObservationModel, seed: int
) -> None:
    scene = simulate_scene("corridor", 3, np.random.default_rng(seed), sigma=SIGMA)
    run = scene.run
    everything = ms.refine(run, full_associations(3, 3), model=model, evidence="laplace")
    found = [f.association for f in search_all_scans(_problem(run, model), Effort())]
    near = [h.association for h in everything if h.log_evidence > everything[0].log_evidence - 4.0]
    assert found[0] == everything[0].association
    assert set(near) <= set(found)


def test_the_search_sums_over_the_readings_of_single_detections() -> None:
    scene = simulate_scene("corridor", 2, np.random.default_rng(5), sigma=SIGMA)
    scans = [*scene.scans[:2], ms.BearingScan(scene.scans[2].bearings[:1])]
    run = ms.StraightRun(scans)
    sums: dict[ms.Association, float] = {}
    for h in ms.refine(run, partitions(run.n_detections), model=MISSING, evidence="laplace"):
        key = pairs_of(h.association)
        sums[key] = float(np.logaddexp(sums.get(key, -math.inf), h.log_evidence))
    problem = _problem(run, MISSING)
    found = search_all_scans(problem, Effort())
    chosen = ms.refine(run, [f.association for f in found], model=MISSING, evidence="laplace")
    evidence = {h.association: h.log_evidence for h in chosen}
    ordered = sorted(sums, key=lambda key: -sums[key])
    assert pairs_of(found[0].association) == ordered[0]
    for finalist in found[:3]:
        total = evidence[finalist.association] + finalist.log_other_readings
        # The estimate of the poses changes a little with a landmark seen once.
        assert total == pytest.approx(sums[pairs_of(finalist.association)], abs=0.02)


def test_known_identities_bind_the_search() -> None:
    scene = simulate_scene("corridor", 3, np.random.default_rng(9), sigma=SIGMA, n_scans=4)
    free = search_all_scans(_problem(scene.run, SMOOTH), Effort(drop=60.0))
    assert len(free) > 1
    other = free[1].association
    scans = [
        ms.BearingScan(scan.bearings, labels=[f"l{row}" for row in rows])
        for scan, rows in zip(scene.scans, other.landmark_of_detection(), strict=True)
    ]
    bound = search_all_scans(_problem(ms.StraightRun(scans), SMOOTH), Effort(drop=60.0))
    assert [f.association for f in bound] == [other]


def test_seeds_are_extended() -> None:
    scene = simulate_scene("corridor", 5, np.random.default_rng(2), sigma=SIGMA, n_scans=5)
    problem = _problem(scene.run, STRAIGHT)
    blind = Effort(keep=1, solve=1, early=1, ranked=0, finalists=0, moves=0, rounds=0)
    first = ms.StraightRun(scene.scans[:3])
    planted = list(ms.refine(first, [scene.truth.restrict((0, 1, 2))], model=STRAIGHT))
    alone = [f.association for f in search_all_scans(problem, blind)]
    assert scene.truth not in alone
    assert search_all_scans(problem, blind, planted)[0].association == scene.truth


def test_scans_of_different_length_need_a_model_that_compares_sizes() -> None:
    scans = [ms.BearingScan(b) for b in ([0.1, 0.5], [0.2, 0.6], [0.3])]
    with pytest.raises(UnequalScansError, match="detections"):
        search_all_scans(_problem(ms.StraightRun(scans), STRAIGHT), Effort())


def test_every_detection_is_in_the_answer_once() -> None:
    rng = np.random.default_rng(11)
    scans = [ms.BearingScan(rng.uniform(-3.0, 3.0, rng.integers(0, 5))) for _ in range(6)]
    run = ms.StraightRun(scans)
    for finalist in search_all_scans(_problem(run, MISSING), Effort(keep=3, solve=6)):
        assert finalist.association.n_detections == run.n_detections
        assert len(finalist.landmarks) == finalist.association.n_landmarks
        assert np.isfinite(finalist.poses).all()
        assert np.isfinite(finalist.landmarks).all()
        assert 0.0 <= finalist.log_other_readings < math.inf


def _problem(run: ms.StraightRun, model: ms.ObservationModel) -> object:
    return make_problem(run, tuple(range(len(run))), model)
