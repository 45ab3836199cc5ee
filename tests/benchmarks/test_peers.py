"""Peers answer as what they claim to be, and what they fail at is counted against them."""

from __future__ import annotations

import importlib
import itertools
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mht_slam as ms
from mht_slam.consistency.tightest import tightest_association
from mht_slam.errors import OptionError
from mht_slam.evaluation.bench.case import Assumptions, Case
from mht_slam.evaluation.bench.judging import ordered_answers
from mht_slam.simulation import simulate_scene

FOLDER = Path(__file__).parents[2] / "benchmarks" / "peers"
PEERS = (
    "exhaustive LM over (n!)^2",
    "cone feasibility, linear program",
    "GTSAM hybrid, ten relinearisations",
    "GTSAM DCSAM, 1 start",
    "GTSAM DCSAM, best of 20",
    "EKF-SLAM, nearest neighbour, delayed initialisation",
    'delayed decisions, "in the manner of Costa et al."',
    'map graphs, "in the manner of Spero"',
    "Stone Soup GNN",
    "Stone Soup JPDA",
)
SIGMA = np.deg2rad(1.0)
AMBIGUOUS = 4
"""A scene in which several associations are believable."""
LANDMARKS = np.array([[1.0, 3.0], [2.0, -2.0], [3.5, 1.5]])
STEPS = (0.0, 1.0, 2.2)
Load = Callable[[str], ModuleType]


@pytest.fixture(scope="module")
def load() -> Iterator[Load]:
    """Import a module of the study, as its script does; other studies may have the same names."""
    ours = [path.stem for path in FOLDER.glob("*.py")]
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FOLDER))
        before = {name: sys.modules.pop(name) for name in ours if name in sys.modules}
        yield importlib.import_module
        for name in ours:
            sys.modules.pop(name, None)
        sys.modules.update(before)


def assumed(load: Load, poses: np.ndarray | None = None) -> Assumptions:
    model = ms.ObservationModel(sigma=SIGMA)
    if poses is None:
        return Assumptions(3.0 * SIGMA, model)
    made: Assumptions = load("posed_scenes").PosesGiven(3.0 * SIGMA, model, poses=poses)
    return made


def noiseless() -> tuple[ms.StraightRun, ms.Association, np.ndarray]:
    """A run past three landmarks that are easy to tell apart, detections in any order."""
    rng = np.random.default_rng(5)
    labels = [rng.permutation(3).tolist() for _ in STEPS]
    scans = [
        ms.BearingScan(np.arctan2(*(LANDMARKS[seen] - [x, 0.0]).T[::-1]))
        for x, seen in zip(STEPS, labels, strict=True)
    ]
    poses = np.array([[x, 0.0, 0.0] for x in STEPS])
    return ms.StraightRun(scans), ms.Association.from_labels(labels), poses


def noisy(seed: int, n: int = 3) -> ms.StraightRun:
    return simulate_scene("annulus", n, np.random.default_rng(seed), sigma=SIGMA).run


def test_every_peer_is_registered(load: Load) -> None:
    registry = load("peer_registry")
    assert tuple(registry.registered()) == PEERS
    with_peers = {p.stem for p in FOLDER.glob("*.py") if "\n@peer(" in p.read_text("utf-8")}
    assert with_peers == set(registry.FILES)


@pytest.mark.parametrize("name", PEERS)
def test_without_noise_a_peer_finds_the_truth(load: Load, name: str) -> None:
    peer = load("peer_registry").registered()[name]
    if peer.missing:
        pytest.skip(f"{peer.missing} not installed")
    run, truth, poses = noiseless()
    case = Case(run, truth, assumed(load, poses), poses, LANDMARKS)
    answers = ordered_answers(peer.function(run, case.assumptions), case)
    assert answers[0][0].exact(truth)


@pytest.mark.parametrize("seed", range(4))
def test_linear_programs_keep_the_consistent_set(load: Load, seed: int) -> None:
    run = noisy(seed)
    listed = {a for a, _ in load("cone_program").cone_program(run, assumed(load))}
    consistent = ms.consistent_associations(run, epsilon=3.0 * SIGMA)
    assert consistent.complete
    assert listed == set(consistent.associations)


@pytest.mark.parametrize("seed", range(2))
def test_the_most_slack_is_the_smallest_vision_error(load: Load, seed: int) -> None:
    run = noisy(seed)
    program = load("cone_program")
    best, slack = max(program.cone_program(run, assumed(load)), key=lambda answer: answer[1])
    tightest = tightest_association(run)
    assert best == tightest.association
    unit = 3.0 * SIGMA / 2**program.HALVINGS
    assert 3.0 * SIGMA - slack == pytest.approx(tightest.epsilon, abs=2.0 * unit)


def test_exhaustive_optima_are_those_of_our_graph(load: Load) -> None:
    run, graphs = noisy(AMBIGUOUS), load("peer_graphs")
    found = dict(load("exhaustive_lm").exhaustive_lm(run, assumed(load)))
    best = [a for a, density in found.items() if density > max(found.values()) - 40.0]
    assert len(best) > 1
    problem = graphs.problem_of(run, assumed(load))
    for hypothesis in ms.refine(run, best, sigma=SIGMA, evidence="laplace"):
        values = hypothesis.to_gtsam()[1]
        table = hypothesis.association.table
        ours = graphs.log_density(problem, table, values)
        assert found[hypothesis.association] == pytest.approx(ours, abs=1e-3)


def test_hybrid_answers_are_probabilities_over_all_associations(load: Load) -> None:
    run = noisy(2)
    answers = load("gtsam_hybrid").gtsam_hybrid(run, assumed(load))
    assert len({association for association, _ in answers}) == 36
    assert sum(p for _, p in answers) == pytest.approx(1.0)
    assert min(p for _, p in answers) >= 0.0


def test_hybrid_refuses_what_does_not_fit_in_memory(load: Load) -> None:
    with pytest.raises(OptionError, match="at most 4"):
        load("gtsam_hybrid").gtsam_hybrid(noisy(0, n=5), assumed(load))


def test_a_discrete_graph_with_its_choices_made_is_the_associations_graph(load: Load) -> None:
    """Its continuous error at a choice is that of the graph of that association."""
    run, graphs = noisy(3), load("peer_graphs")
    problem = graphs.problem_of(run, assumed(load))
    discrete = graphs.DiscreteGraph(graphs.FactorPool(problem), 3)
    values = discrete.start()
    hybrid = discrete.graph(values)
    for table in itertools.islice(graphs.full_tables(3), 0, None, 7):
        np.testing.assert_array_equal(discrete.table_of(discrete.values_of(table)), table)
        both = gtsam.HybridValues(discrete.values_of(table), values)
        own = graphs.build_graph(problem, table, graphs.extracted_poses(values))
        assert hybrid.error(both) == pytest.approx(own.error(values))


def test_a_start_of_dcsam_that_raises_is_left_out(
    load: Load, monkeypatch: pytest.MonkeyPatch
) -> None:
    dcsam = load("gtsam_dcsam")
    run = noisy(0)
    truth = ms.Association([[0, 0, 0], [1, 1, 1], [2, 2, 2]], run.n_detections)
    outcomes = itertools.cycle([RuntimeError("Product factor is 0.0"), None])

    def answer(*_: object) -> tuple[ms.Association, float]:
        if (raised := next(outcomes)) is not None:
            raise raised
        return truth, -1.0

    monkeypatch.setattr(dcsam, "_answer", answer)
    assert dcsam.dcsam_best(run, assumed(load)) == [(truth, -1.0)] * (dcsam.STARTS // 2)


def test_dcsam_starts_hang_on_nothing_but_the_run(load: Load) -> None:
    run, dcsam = noisy(4), load("gtsam_dcsam")
    assert dcsam.dcsam_best(run, assumed(load)) == dcsam.dcsam_best(run, assumed(load))


@settings(deadline=None)
@given(
    landmark=st.tuples(st.floats(-3.0, 5.0), st.floats(0.3, 6.0), st.sampled_from([-1.0, 1.0])),
    log_step=st.floats(-1.0, 1.0),
)
def test_three_exact_bearings_of_a_landmark_imply_the_step(
    load: Load, landmark: tuple[float, float, float], log_step: float
) -> None:
    decisions = load("delayed_decisions")
    x, y, side = landmark
    places = np.array([0.0, 1.0, 1.0 + np.exp(log_step)])
    angles = np.arctan2(side * y, x - places)
    assert decisions._meet(angles)
    assert decisions._log_step(angles) == pytest.approx(log_step, abs=1e-6)
    h = 1e-6
    numeric = [
        (decisions._log_step(angles + h * e) - decisions._log_step(angles - h * e)) / (2.0 * h)
        for e in np.eye(3)
    ]
    np.testing.assert_allclose(decisions._log_step_slopes(angles), numeric, rtol=1e-3)


@settings(deadline=None)
@given(
    state=st.tuples(st.floats(-1.0, 1.0), st.floats(-3.0, 5.0), st.floats(0.3, 6.0)),
    bearings=st.tuples(st.floats(0.2, 1.4), st.floats(0.2, 1.4)),
)
def test_the_filters_derivatives_are_derivatives(
    load: Load, state: tuple[float, float, float], bearings: tuple[float, float]
) -> None:
    ekf, h = load("ekf_slam"), 1e-6
    x = np.array(state)
    numeric = [(ekf._predicted(x + h * e, 0) - ekf._predicted(x - h * e, 0)) for e in np.eye(3)]
    np.testing.assert_allclose(
        ekf._jacobian(x, 0), np.column_stack(numeric) / (2.0 * h), rtol=1e-4, atol=1e-6
    )
    angles = np.cumsum(bearings)
    crossings = [(ekf._crossing(angles + h * e) - ekf._crossing(angles - h * e)) for e in np.eye(2)]
    np.testing.assert_allclose(
        ekf._crossing_jacobian(angles), np.column_stack(crossings) / (2.0 * h), rtol=1e-3, atol=1e-5
    )


def test_maps_of_the_true_pairings_match_without_noise(load: Load) -> None:
    run, truth, _ = noiseless()
    scores = dict(load("map_graphs").map_graphs(run, assumed(load)))
    assert scores[truth] == pytest.approx(0.0, abs=1e-9)
    others = [score for association, score in scores.items() if association != truth]
    assert max(others, default=-1.0) < -1e-3


@pytest.mark.parametrize("name", ["ekf_slam", "delayed_decisions", "map_graphs"])
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 100), order=st.permutations(range(3)))
def test_the_order_of_detections_means_nothing(
    load: Load, name: str, seed: int, order: list[int]
) -> None:
    run, function = noisy(seed), getattr(load(name), name)
    scans = list(run.scans)
    scans[1] = ms.BearingScan(run.scans[1].bearings[order])
    shuffled = ms.StraightRun(scans)

    def best(of: ms.StraightRun) -> np.ndarray:
        """Table of the first answer, without rows where there is none."""
        answers = list(function(of, assumed(load)))
        nothing = ms.Association(np.empty((0, 3), dtype=np.int64), of.n_detections), 0.0
        first: ms.Association = max(answers, key=lambda answer: answer[1], default=nothing)[0]
        return first.table

    before, after = best(run), best(shuffled)
    back = np.array([[i, order[j] if j >= 0 else j, k] for i, j, k in after.tolist()])
    assert sorted(back.tolist()) == sorted(before.tolist())


def test_poses_are_told_and_nothing_else_changes(load: Load) -> None:
    posed = load("posed_scenes")
    cell = load("compare").cell_of("annulus", 3, 1.0)
    plain, told = cell.case(7), posed.PosedScenes(cell).case(7)
    assert (told.run, told.truth) == (plain.run, plain.truth)
    assert told.assumptions.model == plain.assumptions.model
    np.testing.assert_array_equal(posed.given_poses(told.assumptions), plain.poses)
    with pytest.raises(OptionError, match="true poses"):
        posed.given_poses(plain.assumptions)
