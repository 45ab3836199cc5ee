"""`mht-slam bench`: tables and a report from one command, which goes on where it was killed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mht_slam.cli.main import main

QUICK = [
    "bench", "compare", "--kinds", "annulus", "--landmarks", "3", "--epsilons-deg", "3",
    "--noises", "uniform", "--scenes", "2", "--ours", "order-keeping", "nearest bearing",
]  # fmt: skip
OWN = """
import mht_slam as ms

def by_bearing(run, assumptions):
    order = [scan.bearings.argsort() for scan in run.scans]
    table = [[int(o[k]) for o in order] for k in range(len(order[0]))]
    return [(ms.Association(table, run.n_detections), 1.0)]
"""
TABLES = ("rows.csv", "rows.parquet", "summary.csv", "summary.md")


def test_a_comparison_leaves_tables_times_configuration_and_a_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*QUICK, "--output", str(tmp_path / "out")]) == 0
    found = {path.name for path in (tmp_path / "out").iterdir()}
    expected = {"times.csv", "configuration.json", "report.html", "results.jsonl", "times.jsonl"}
    assert found >= {*expected, "rows.csv", "summary.csv", "summary.md"}
    configuration = json.loads((tmp_path / "out" / "configuration.json").read_text())
    assert configuration["options"]["seed"] == 0
    assert {"mht-slam", "gtsam", "numpy"} <= set(configuration["versions"])
    assert "order-keeping" in capsys.readouterr().out


def test_the_same_command_again_does_nothing_anew_and_gives_the_same_bytes(tmp_path: Path) -> None:
    assert main([*QUICK, "--output", str(tmp_path / "a")]) == 0
    names = [name for name in TABLES if (tmp_path / "a" / name).exists()]
    before = [(tmp_path / "a" / name).read_bytes() for name in names]
    times = (tmp_path / "a" / "times.jsonl").read_bytes()
    assert main([*QUICK, "--output", str(tmp_path / "a")]) == 0
    assert (tmp_path / "a" / "times.jsonl").read_bytes() == times
    assert main([*QUICK, "--output", str(tmp_path / "b")]) == 0
    for folder in ("a", "b"):
        assert [(tmp_path / folder / name).read_bytes() for name in names] == before


def test_a_method_of_ones_own_is_found_in_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "my_bench_module.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    own = ["--method", "my_bench_module:by_bearing"]
    assert main([*QUICK, *own, "--output", "out"]) == 0
    assert "my_bench_module:by_bearing" in (tmp_path / "out" / "summary.md").read_text()
    assert main([*QUICK, "--output", "out"]) == 2  # another set of methods


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--method", "no_such_module:f"], "no_such_module"),
        (["--ours", "guessing"], "guessing"),
        (["--quick", "--long"], "give one of them"),
        (["--epsilons-deg", "0"], "epsilons"),
        (["--sigmas-deg", "1"], "give one of them"),
        (["--scenes", "0"], "scenes"),
        (["--seed", "-1"], "seed"),
    ],
)
def test_an_option_that_makes_no_sense_is_one_line_and_exit_code_2(
    options: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*QUICK, *options, "--output", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("mht-slam: error: ")
    assert words in error
    assert error.count("\n") == 1


def test_recordings_that_are_not_there_are_one_line_and_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--data", str(tmp_path), "--output", str(tmp_path / "out")]
    assert main(["bench", "recordings", *options]) == 2
    assert "does not exist" in capsys.readouterr().err
