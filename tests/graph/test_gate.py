"""The bound that gives hypotheses up holds, and giving them up changes no probability."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from mht_slam import Association, BearingScan, ObservationModel, StraightRun, refine
from mht_slam.graph import refine as refining
from mht_slam.graph.gate import _isotonic_cost, log_evidence_bound
from mht_slam.graph.problem import make_problem
from mht_slam.simulation import simulate_scene

SIGMA = math.radians(1.0)


def random_association(rng: np.random.Generator, n: int, n_scans: int) -> Association:
    columns = [np.arange(n), *(rng.permutation(n) for _ in range(n_scans - 1))]
    return Association(np.column_stack(columns), (n,) * n_scans)


def all_associations(n: int) -> list[Association]:
    orders = [np.array(order) for order in itertools.permutations(range(n))]
    return [
        Association(np.column_stack([np.arange(n), a, b]), (n, n, n))
        for a, b in itertools.product(orders, orders)
    ]


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), n_scans=st.integers(3, 6))
def test_no_association_has_more_evidence_than_its_bound(seed: int, n_scans: int) -> None:
    rng = np.random.default_rng(seed)
    scene = simulate_scene("annulus", 3, rng, sigma=SIGMA, n_scans=n_scans)
    candidates = [scene.truth, *(random_association(rng, 3, n_scans) for _ in range(3))]
    model = ObservationModel(sigma=SIGMA)
    problem = make_problem(scene.run, tuple(range(n_scans)), model)
    for h in refine(scene.run, candidates, model=model, evidence="laplace"):
        if h.failure is None:
            assert h.log_evidence <= log_evidence_bound(problem, h.association.table) + 1e-6


@settings(max_examples=60, deadline=None)
@given(
    values=st.lists(st.floats(0.0, 3.1), min_size=1, max_size=5),
    seed=st.integers(0, 1000),
)
def test_the_isotonic_cost_is_what_a_general_optimiser_finds(
    values: list[float], seed: int
) -> None:
    weights = np.random.default_rng(seed).uniform(0.5, 2.0, len(values))

    root = np.sqrt(weights)
    rises = root[:, None] * np.tri(len(values))  # of the first value, and from each to the next
    least = [-np.inf] + [0.0] * (len(values) - 1)
    found = lsq_linear(rises, root * values, (least, np.inf), method="bvls", tol=1e-12)
    assert _isotonic_cost(values, weights.tolist()) == pytest.approx(2.0 * found.cost, abs=1e-9)


def test_a_path_that_explains_everything_is_bounded_by_the_normalisers_alone() -> None:
    bearings = np.deg2rad([[45.0, 27.0, -34.0], [90.0, 45.0, -53.0], [153.0, 90.0, -90.0]])
    run = StraightRun(BearingScan(b) for b in bearings)
    problem = make_problem(run, (0, 1, 2), ObservationModel(sigma=SIGMA))
    bound = log_evidence_bound(problem, np.repeat(np.arange(3), 3).reshape(3, 3))
    assert bound == pytest.approx(-9.0 * math.log(SIGMA * math.sqrt(2.0 * math.pi)))


@pytest.mark.parametrize(
    "changes",
    [
        {"motion": "smooth"},
        {"heading_sigma": 0.01},
        {"lateral_sigma": 0.01},
        {"bearing_dof": 4.0},
    ],
)
def test_what_the_bound_does_not_know_it_does_not_bound(changes: dict[str, object]) -> None:
    scene = simulate_scene("annulus", 3, np.random.default_rng(1), sigma=SIGMA)
    model = ObservationModel(sigma=SIGMA, **changes)  # type: ignore[arg-type]
    assert log_evidence_bound(make_problem(scene.run, (0, 1, 2), model), scene.truth.table) == (
        math.inf
    )


@pytest.mark.parametrize("kind", ["annulus", "one_sided", "corridor"])
def test_without_the_gate_every_probability_is_the_same(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    n_gated = 0
    for seed in range(3):
        scene = simulate_scene(kind, 3, np.random.default_rng(seed), sigma=SIGMA)  # type: ignore[arg-type]
        gated = refine(scene.run, all_associations(3), sigma=SIGMA, evidence="laplace")
        with monkeypatch.context() as patch:
            patch.setattr(refining, "GATE", math.inf)
            full = refine(scene.run, all_associations(3), sigma=SIGMA, evidence="laplace")
        with_gate = {h.association: h for h in gated}
        assert len(with_gate) == len(full) == 36, "every candidate stays in the posterior"
        for h in full:
            assert with_gate[h.association].probability == pytest.approx(h.probability, abs=1e-6)
            if (with_gate[h.association].failure or "").startswith("gated"):
                n_gated += 1
                assert h.log_evidence < full[0].log_evidence - refining.GATE
    assert n_gated > 0 or kind == "one_sided"


def test_the_gate_hangs_neither_on_the_order_nor_on_the_chunks() -> None:
    scene = simulate_scene("annulus", 3, np.random.default_rng(0), sigma=SIGMA)
    candidates = all_associations(3)
    there = refine(scene.run, candidates, sigma=SIGMA, evidence="laplace")
    back = refine(scene.run, candidates[::-1], sigma=SIGMA, evidence="laplace")
    assert any((h.failure or "").startswith("gated") for h in there)
    assert there.hypotheses == back.hypotheses
