"""The ranking study goes on where it was, and counts what it says it counts."""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import mht_slam as ms
from mht_slam.simulation import simulate_scene

STUDY = Path(__file__).parents[2] / "benchmarks" / "ranking"
EPSILON = np.deg2rad(1.0)
N_JOBS = 2


@pytest.fixture
def part_of_study(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """Import a module of the study, as its script does."""
    monkeypatch.syspath_prepend(str(STUDY))
    return import_module


def run_study(output: Path) -> str:
    """Run two tiny scenes; return what was said of the progress."""
    command = [sys.executable, str(STUDY / "exact_against_exhaustive.py"), "--quick"]
    command += ["--kinds", "one_sided", "--sizes", "3", "--epsilons-deg", "1"]
    command += ["--output", str(output), "--scenes", str(N_JOBS), "--workers", "1"]
    outcome = subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603 - ours
    assert (output / "exact_ranking.png").stat().st_size > 0
    assert "| n | scenes | one-sided, 1 deg |\n| --- | --- | --- |\n| 3 | 2 |" in outcome.stdout
    assert "| one_sided | 1.0 | 3 | 2 |" in (output / "details.md").read_text(encoding="utf-8")
    return outcome.stderr


def test_a_killed_study_loses_only_what_was_running(tmp_path: Path) -> None:
    rows = tmp_path / "rows.csv"
    assert f"0 of {N_JOBS} scenes are done" in run_study(tmp_path)
    finished = rows.read_text(encoding="utf-8")
    assert len(finished.splitlines()) == 1 + N_JOBS

    header, first, last = finished.splitlines(keepends=True)
    rows.write_text(header + first + last[: len(last) // 2], encoding="utf-8")
    assert f"1 of {N_JOBS} scenes are done" in run_study(tmp_path)
    again = rows.read_text(encoding="utf-8").splitlines(keepends=True)
    assert again[:2] == [header, first]
    assert again[2].split(",")[:6] == last.split(",")[:6]


@pytest.mark.parametrize("n", range(6))
def test_the_permanent_counts_perfect_matchings(
    n: int, part_of_study: Callable[[str], ModuleType]
) -> None:
    permanent = part_of_study("feasible_pairs").permanent
    rng = np.random.default_rng(n)
    for density in (0.3, 0.6, 1.0):
        matrix = rng.random((n, n)) < density
        matchings = sum(
            all(matrix[row, column] for row, column in enumerate(order))
            for order in itertools.permutations(range(n))
        )
        assert permanent(matrix) == matchings


def test_linear_programs_and_ratio_intervals_find_the_same_consistent_associations(
    part_of_study: Callable[[str], ModuleType],
) -> None:
    lp = part_of_study("lp_feasibility")
    rng = np.random.default_rng(2)
    run = simulate_scene("clusters", 3, rng, epsilon=EPSILON).run
    certified = ms.consistent_associations(run, epsilon=EPSILON)
    assert 0 < len(certified) < 36
    assert lp.count_consistent(run, epsilon=EPSILON) == len(certified)
    assert all(lp.is_consistent(run, each, epsilon=EPSILON) for each in certified.associations)
