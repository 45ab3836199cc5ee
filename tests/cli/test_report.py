"""The table fits a narrow terminal, and the line under it says what agrees."""

from __future__ import annotations

import math
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from mht_slam import Comparison, Solution, compare, evidence_by_quadrature, solve
from mht_slam.cli.report import agreement, print_report
from mht_slam.simulation import simulate_scene


def test_eighty_columns_cut_no_number_short() -> None:
    epsilon = math.radians(2.0)
    scene = simulate_scene("annulus", 5, np.random.default_rng(1), epsilon=epsilon)
    solution = solve(scene.run, epsilon=epsilon, sigma=epsilon / 2.0, truth=scene.truth, top_k=3)
    out = StringIO()
    print_report(Console(file=out, width=80), solution, scene.truth, own_sigmas=True)
    text = out.getvalue()
    assert "\u2026" not in text, "an ellipsis marks what was cut"
    for row in solution.comparison.rows:
        assert f"{row.log_evidence:.2f}" in text
        assert f"{row.probability:.4f}" in text
    assert "own sigma" in text


@pytest.mark.parametrize(
    ("comparison", "said"),
    [
        (Comparison((), 0.5, True, 1, 2), "agree on"),
        (Comparison((), 0.5, True, 1, 2), "the truth ranks 1 by polygon, 2 by graph"),
        (Comparison((), None, False, None, None), "not among the candidates"),
    ],
)
def test_the_line_names_agreement_and_the_ranks_of_the_truth(
    comparison: Comparison, said: str
) -> None:
    scene = simulate_scene("annulus", 3, np.random.default_rng(1), epsilon=0.01)
    assert said in agreement(comparison, scene.truth)


def test_an_unknown_truth_is_said() -> None:
    assert "not known" in agreement(Comparison((), None, False, None, None), None)


def test_a_likelihood_that_nobody_estimated_is_said() -> None:
    epsilon = math.radians(2.0)
    scene = simulate_scene("annulus", 3, np.random.default_rng(1), epsilon=epsilon)
    solution = solve(scene.run, epsilon=epsilon, sigma=epsilon / 2.0, top_k=1)
    weighed = evidence_by_quadrature(scene.run, solution.ranking, sigma=epsilon / 2.0)
    without = Solution(solution.ranking, weighed, compare(solution.ranking, weighed))
    out = StringIO()
    print_report(Console(file=out, width=80), without, None, own_sigmas=False)
    assert "none" in out.getvalue()
