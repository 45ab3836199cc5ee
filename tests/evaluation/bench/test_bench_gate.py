"""The gate fails when a key figure gets worse, a method disappears, or a workload crashes."""

from __future__ import annotations

import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

from mht_slam.errors import OptionError
from mht_slam.evaluation.bench.compare import compare
from mht_slam.evaluation.bench.gate import (
    KeyFigure,
    key_figures,
    read_baseline,
    worse_figures,
    write_baseline,
)
from mht_slam.evaluation.bench.summary import summarise
from mht_slam.evaluation.bench.sweep import Sweep

REPOSITORY = Path(__file__).parents[3]
FIGURES = {
    "a: exact": KeyFigure(0.9, "higher", 0.05),
    "a: failures": KeyFigure(0.0, "lower", 0.0),
    "a: log score": KeyFigure(-0.5, "higher", 0.1),
}


@pytest.fixture
def check(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(REPOSITORY / "benchmarks" / "gate"))
    sys.modules.pop("check", None)
    return import_module("check")


def test_the_same_figures_and_better_ones_pass() -> None:
    better = {name: replace(f, value=f.value + 0.05) for name, f in FIGURES.items()}
    better["a: failures"] = FIGURES["a: failures"]
    assert worse_figures(FIGURES, FIGURES) == []
    assert worse_figures(better, FIGURES) == []
    assert worse_figures({**FIGURES, "new: exact": FIGURES["a: exact"]}, FIGURES) == []


@pytest.mark.parametrize(
    ("name", "value"), [("a: exact", 0.84), ("a: failures", 1.0), ("a: log score", -0.61)]
)
def test_each_figure_fails_in_its_own_direction(name: str, value: float) -> None:
    now = {**FIGURES, name: replace(FIGURES[name], value=value)}
    (complaint,) = worse_figures(now, FIGURES)
    assert complaint.startswith(name)


def test_a_figure_inside_its_tolerance_passes() -> None:
    now = {**FIGURES, "a: exact": replace(FIGURES["a: exact"], value=0.86)}
    assert worse_figures(now, FIGURES) == []


def test_a_method_that_disappears_fails() -> None:
    now = {name: f for name, f in FIGURES.items() if name != "a: exact"}
    (complaint,) = worse_figures(now, FIGURES)
    assert "is gone" in complaint


def test_a_baseline_survives_being_written_and_read(tmp_path: Path) -> None:
    write_baseline(tmp_path / "b.json", FIGURES)
    assert read_baseline(tmp_path / "b.json") == FIGURES


@pytest.mark.parametrize(
    "content", ["{}", "[]", "no json", '{"a": 1}', '{"a": {"value": 1, "better": "up"}}']
)
def test_a_file_that_holds_no_figures_is_no_baseline(tmp_path: Path, content: str) -> None:
    (tmp_path / "b.json").write_text(content)
    with pytest.raises(OptionError):
        read_baseline(tmp_path / "b.json")


def test_key_figures_name_every_method_and_count_failures(
    own: ModuleType, small_sweep: Sweep, cheap: list[str]
) -> None:
    figures = key_figures(summarise(compare(small_sweep, {"raises": own.RAISES}, ours=cheap)))
    assert figures["raises: failures"].value == 6.0
    assert {f"{name}: exact" for name in cheap} <= set(figures)


def test_the_gate_holds_when_the_workload_crashes(
    check: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    def crashes(_workers: int) -> dict[str, KeyFigure]:
        raise ZeroDivisionError("in the workload")

    write_baseline(tmp_path / "b.json", FIGURES)
    monkeypatch.setattr(check, "measure", crashes)
    assert check.main(["--baseline", str(tmp_path / "b.json")]) == 1
    assert "in the workload" in capsys.readouterr().err


def test_the_gate_passes_and_fails_by_its_exit_code(
    check: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path = str(tmp_path / "b.json")
    monkeypatch.setattr(check, "measure", lambda _workers: FIGURES)
    assert check.main(["--baseline", path]) == 1  # there is no baseline yet
    assert check.main(["--baseline", path, "--write"]) == 0
    assert check.main(["--baseline", path]) == 0
    worse = {**FIGURES, "a: exact": replace(FIGURES["a: exact"], value=0.1)}
    monkeypatch.setattr(check, "measure", lambda _workers: worse)
    assert check.main(["--baseline", path]) == 1


def test_the_committed_baseline_has_figures_of_all_of_our_methods() -> None:
    from mht_slam.evaluation.bench.methods import CEILINGS, METHODS

    figures = read_baseline(REPOSITORY / "benchmarks" / "baseline.json")
    for name in (*METHODS, *CEILINGS):
        assert f"{name}: exact" in figures
        assert figures[f"{name}: failures"].better == "lower"
