"""The study of all scans counts failures, keeps answers of one code, and goes on where it was."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import mht_slam as ms
from mht_slam.datasets import LabelledRun
from mht_slam.datasets.labelled_runs import assemble_run

STUDY = Path(__file__).parents[2] / "benchmarks" / "recordings"
LANDMARKS = {0: (3.0, 4.0), 1: (9.0, 5.0), 2: (6.0, -5.0)}
N_RUNS = 4

Answer = tuple[ms.Association, float]


def labelled_run(number: int) -> LabelledRun:
    poses = np.array([[0.3 * k + 0.1 * number, 0.0, 0.0] for k in range(4)])
    bearings = [
        np.array([np.arctan2(y, x - pose[0]) for x, y in LANDMARKS.values()]) for pose in poses
    ]
    identities = [np.array(list(LANDMARKS))] * 4
    indices = range(4 * number, 4 * number + 4)
    return assemble_run(
        f"run {number}", indices, bearings, identities, poses=poses, landmarks=LANDMARKS
    )


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The study with four tiny runs and threads for processes."""
    monkeypatch.syspath_prepend(str(STUDY))
    contenders = import_module("contenders")
    runs = [labelled_run(number) for number in range(N_RUNS)]
    monkeypatch.setitem(contenders.READERS, contenders.STRICT, lambda: runs)
    module = import_module("all_scans")
    monkeypatch.setattr(module, "ProcessPoolExecutor", ThreadPoolExecutor)
    return module


@pytest.fixture
def run_study(
    study: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., list[dict[str, str]]]:
    """Run it with an estimator; return the estimator's rows."""

    def call(estimate: Callable[[ms.StraightRun, Any], list[Answer]]) -> list[dict[str, str]]:
        monkeypatch.setattr(study, "estimate", estimate)
        arguments = ["--output", str(tmp_path), "--set", "dlr-strict", "--workers", "1"]
        assert study.main(arguments) == 0
        assert (tmp_path / "all_scans.png").stat().st_size > 0
        with (tmp_path / "rows.csv").open(newline="", encoding="utf-8") as file:
            return [row for row in csv.DictReader(file) if row["method"] == study.ESTIMATOR]

    return call


def by_order(run: ms.StraightRun, _model: object) -> list[Answer]:
    orders = [np.argsort(scan.bearings) for scan in run.scans]
    return [(ms.Association(np.stack(orders, axis=1), run.n_detections), 0.95)]


def test_right_answers_count_as_right_in_both_halves(
    run_study: Callable[..., list[dict[str, str]]], tmp_path: Path
) -> None:
    rows = run_study(by_order)
    assert [row["half"] for row in rows] == ["tuning", "tuning", "scored", "scored"]
    assert all(row["exact"] == row["forgiven"] == row["proposed"] == "True" for row in rows)
    assert all(row["truth_rank"] == "1" and row["top_probability"] == "0.95" for row in rows)
    assert all(row["common"] == row["answered"] == row["true"] == "18" for row in rows)
    summary = (tmp_path / "summary.md").read_text(encoding="utf-8")
    assert "Answers of probability above 0.9: 2, exact in" in summary


def test_a_run_that_fails_is_wrong_and_named(
    run_study: Callable[..., list[dict[str, str]]], tmp_path: Path
) -> None:
    def estimate(run: ms.StraightRun, model: object) -> list[Answer]:
        if run == labelled_run(1).run:
            raise ZeroDivisionError("no step")
        if run == labelled_run(2).run:
            return []
        return by_order(run, model)

    rows = {row["run"]: row for row in run_study(estimate)}
    assert [rows[f"run {k}"]["exact"] for k in range(N_RUNS)] == ["True", "False", "False", "True"]
    assert rows["run 1"]["error"] == "ZeroDivisionError: no step"
    assert rows["run 2"]["error"] == "no answer"
    assert (rows["run 2"]["answered"], rows["run 2"]["true"]) == ("0", "18")
    summary = (tmp_path / "summary.md").read_text(encoding="utf-8")
    assert "| run 1 | no | 0.000 | - | not proposed | - | ZeroDivisionError: no step |" in summary


def test_answers_are_kept_until_the_code_or_the_model_changes(
    run_study: Callable[..., list[dict[str, str]]],
    study: ModuleType,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[ms.StraightRun] = []

    def estimate(run: ms.StraightRun, model: object) -> list[Answer]:
        asked.append(run)
        return by_order(run, model)

    first = run_study(estimate)
    assert len(asked) == N_RUNS
    path = tmp_path / "answers.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    assert sorted(json.loads(line)["run"] for line in lines) == [f"run {k}" for k in range(N_RUNS)]
    path.write_text("".join(lines[:-1]) + lines[-1][:40], encoding="utf-8")  # killed while writing
    again = run_study(estimate)
    assert len(asked) == N_RUNS + 1
    for before, after in zip(first, again, strict=True):
        assert {**before, "seconds": ""} == {**after, "seconds": ""}
    monkeypatch.setitem(study.MODELS, "dlr-strict", ms.ObservationModel(sigma=0.01))
    run_study(estimate)
    assert len(asked) == 2 * N_RUNS + 1

    def other_code(run: ms.StraightRun, model: object) -> list[Answer]:
        return estimate(run, model)

    run_study(other_code)
    assert len(asked) == 3 * N_RUNS + 1
