"""The comparison with peers: failures count, what is missing is said, nothing is done twice."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations, product
from pathlib import Path
from types import ModuleType

import pytest

import mht_slam as ms
from mht_slam.evaluation.bench.case import Assumptions
from mht_slam.evaluation.bench.methods import GRAPH_EVIDENCE, ORDER_KEEPING

FOLDER = Path(__file__).parents[2] / "benchmarks" / "peers"
DELAYED = 'delayed decisions, "in the manner of Costa et al."'


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The script, with two quick peers, of which one needs a package that nobody has."""
    ours = [path.stem for path in FOLDER.glob("*.py")]
    monkeypatch.syspath_prepend(str(FOLDER))
    before = {name: sys.modules.pop(name) for name in ours if name in sys.modules}
    registry = importlib.import_module("peer_registry")
    monkeypatch.setattr(registry, "FILES", ("delayed_decisions", "stone_soup"))
    monkeypatch.setattr(registry.importlib.util, "find_spec", lambda _: None)
    script = importlib.import_module("compare")
    monkeypatch.setattr(script, "OURS", (GRAPH_EVIDENCE, ORDER_KEEPING))
    monkeypatch.setattr("mht_slam.evaluation.bench.jobs.with_candidates", all_of_three)
    monkeypatch.setattr(script, "SETTINGS", (("annulus", 3, 1.0),))
    yield script
    for name in ours:
        sys.modules.pop(name, None)
    sys.modules.update(before)


def all_of_three(run: ms.StraightRun, assumptions: Assumptions) -> Assumptions:
    """All associations as candidates: to find the likely ones by exact evidence takes longer."""
    tables = product([range(3)], permutations(range(3)), permutations(range(3)))
    candidates = tuple(ms.Association(list(zip(*t, strict=True)), run.n_detections) for t in tables)
    return replace(assumptions, candidates=candidates)


def row_of(table: str, method: str) -> list[str]:
    (line,) = [line for line in table.splitlines() if line.startswith(f"| {method} |")]
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_a_missing_package_is_said_and_a_second_call_does_nothing_again(
    study: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ["--output", str(tmp_path), "--scenes", "2"]
    assert study.main(arguments) == 0
    table = (tmp_path / "summary.md").read_text("utf-8")
    assert row_of(table, "Stone Soup GNN")[2] == "not installed: stonesoup"
    assert row_of(table, DELAYED)[2:4] == ["2", "0"]
    assert row_of(table, GRAPH_EVIDENCE)[-1] == "1"
    assert float(row_of(table, study.OVER_ALL)[-1]) > 0.0
    assert (tmp_path / "exact_rates.png").stat().st_size > 0
    monkeypatch.setattr(
        "mht_slam.evaluation.bench.compare.run_job", lambda *_: pytest.fail("done again")
    )
    assert study.main(arguments) == 0
    assert (tmp_path / "summary.md").read_text("utf-8") == table


def test_an_exception_is_a_failure_and_a_miss(
    study: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def raises(*_: object) -> None:
        raise RuntimeError("Product factor is 0.0")

    peer = importlib.import_module("delayed_decisions")
    monkeypatch.setattr(peer, "_candidates", raises)
    assert study.main(["--output", str(tmp_path), "--scenes", "2"]) == 0
    cells = row_of((tmp_path / "summary.md").read_text("utf-8"), DELAYED)
    assert cells[2:4] == ["2", "2"]
    assert cells[4].startswith("0.00 [")
    assert cells[5].startswith("-1.00 [")
