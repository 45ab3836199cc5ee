"""The study of drives tunes on one half, counts failures, and goes on where it was."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from mht_slam.association import MISSED, Association
from mht_slam.datasets import Drive
from mht_slam.simulation import OdometryNoise, simulate_drive

STUDY = Path(__file__).parents[2] / "benchmarks" / "recordings"
SIGMA = math.radians(0.5)
N_DRIVES = 4


def loop(seed: int, n_scans: int = 40) -> Drive:
    rng = np.random.default_rng(seed)
    drive = simulate_drive("loop", 8, n_scans, rng, sigma=SIGMA, odometry=OdometryNoise())
    return replace(drive, name=f"loop {seed}")


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The study with four short loops and threads for processes."""
    monkeypatch.syspath_prepend(str(STUDY))
    module = import_module("drives")
    drives = tuple(loop(seed) for seed in range(N_DRIVES))
    sets = import_module("drive_sets")
    sets.drives_of.cache_clear()
    monkeypatch.setitem(sets.READERS, "loop", lambda: drives)
    monkeypatch.setattr(module, "ProcessPoolExecutor", ThreadPoolExecutor)
    return module


@pytest.fixture
def run_study(
    study: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., list[dict[str, str]]]:
    """Run it with a method under test; return its rows."""

    def call(
        answer: Callable[..., Any], options: tuple[str, ...] = ("",), *more: str
    ) -> list[dict[str, str]]:
        monkeypatch.setitem(study.METHODS, "tested", study.Method(answer, options, ()))
        arguments = ["--output", str(tmp_path), "--set", "loop", "--method", "tested", *more]
        assert study.main(arguments) == 0
        with (tmp_path / "rows.csv").open(newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))

    return call


def test_the_option_of_the_tuning_half_answers_the_scored_half(
    study: ModuleType, run_study: Callable[..., Any]
) -> None:
    def answer(drive: Drive, _model: object, option: str) -> Any:
        good = option == "good"
        return study.Answer(drive.truth() if good else None)

    rows = run_study(answer, ("bad", "good"))
    tuned = {(row["drive"], row["option"]) for row in rows if row["half"] == "tuning"}
    assert tuned == {(f"loop {i}", option) for i in (0, 2) for option in ("bad", "good")}
    scored = {(row["drive"], row["option"]) for row in rows if row["half"] == "scored"}
    assert scored == {("loop 1", "good"), ("loop 3", "good")}


def test_the_scored_half_alone_is_enough_where_there_is_nothing_to_tune(
    study: ModuleType, run_study: Callable[..., Any]
) -> None:
    def answer(_drive: Drive, _model: object, _option: str) -> Any:
        return study.Answer(None)

    rows = run_study(answer, ("",), "--half", "scored")
    assert {(row["drive"], row["half"]) for row in rows} == {
        (f"loop {i}", "scored") for i in (1, 3)
    }
    tuned = run_study(answer, ("one", "other"), "--half", "scored")
    assert sum(row["half"] == "tuning" for row in tuned) == 4


def test_a_method_that_throws_has_failed_the_drive_and_one_without_data_has_not(
    study: ModuleType, run_study: Callable[..., Any], tmp_path: Path
) -> None:
    def answer(drive: Drive, _model: object, _option: str) -> Any:
        if drive.name == "loop 1":
            raise ZeroDivisionError("nothing\nto divide")
        if drive.name == "loop 3":
            raise study.NotApplicableError("no odometry")
        return study.Answer(drive.truth(), drive.reference_poses)

    rows = {row["drive"]: row for row in run_study(answer)}
    assert rows["loop 1"]["error"] == "ZeroDivisionError: nothing to divide"
    assert (rows["loop 1"]["common"], rows["loop 1"]["true"] != "0") == ("0", True)
    assert float(rows["loop 0"]["position_sim"]) == pytest.approx(0.0, abs=1e-9)
    summary = (tmp_path / "summary.md").read_text(encoding="utf-8")
    assert "| tested |  | 1, 1 | 0.000" in summary  # loop 3 is no failure
    assert "tested failed on loop 1" in summary


def test_a_second_call_does_only_what_is_missing(
    study: ModuleType, run_study: Callable[..., Any], tmp_path: Path
) -> None:
    asked: list[str] = []

    def answer(drive: Drive, _model: object, _option: str) -> Any:
        asked.append(drive.name)
        return study.Answer(None)

    first = run_study(answer)
    assert sorted(asked) == [f"loop {i}" for i in range(N_DRIVES)]
    path = tmp_path / "rows.csv"
    path.write_text(path.read_text(encoding="utf-8")[:-20], encoding="utf-8")  # as if killed
    asked.clear()
    again = run_study(answer)
    assert len(asked) == 1
    without_time = [[{k: v for k, v in row.items() if k != "seconds"} for row in t]
                    for t in (first, again)]  # fmt: skip
    assert sorted(map(str, without_time[0])) == sorted(map(str, without_time[1]))


def test_a_long_drive_is_looked_at_in_parts(study: ModuleType) -> None:
    drive = loop(0, 260)
    scores = import_module("drive_scores")
    named = {"set_name": "loop", "half": "scored", "method": "m", "option": ""}
    rows = list(scores.score(drive, study.Answer(drive.truth(), drive.reference_poses), **named))
    assert [row.part for row in rows] == ["", "0-99", "100-199", "200-259"]
    assert all(row.counts.f1 == 1.0 for row in rows)
    assert sum(row.true for row in rows[1:]) < rows[0].true


def test_pairs_count_inside_the_stretches_only(study: ModuleType) -> None:
    drive = loop(0)
    scores = import_module("drive_scores")
    named = {"set_name": "loop", "half": "scored", "method": "m", "option": ""}
    known = replace(drive, stretches=((0, 9), (20, 39)))
    (row,) = scores.score(known, study.Answer(drive.truth()), **named)
    inside = [drive.truth(range(first, last + 1)) for first, last in known.stretches]
    sizes = [(a.table != MISSED).sum(axis=1) for a in inside]
    assert row.true == sum(int((s * (s - 1) // 2).sum()) for s in sizes)
    assert row.common == row.answered == row.true


@pytest.mark.usefixtures("study")
@pytest.mark.parametrize("name", ["nearest_neighbour", "joint_compatibility"])
def test_the_filters_find_a_clean_loop(name: str) -> None:
    noise = OdometryNoise(0.01, 0.01, math.radians(0.2))
    rng = np.random.default_rng(5)
    drive = simulate_drive(
        "loop", 8, 40, rng, sigma=math.radians(0.1), miss=0.0, false_alarms=0.0, odometry=noise
    )
    module, model = import_module(name), import_module("drive_sets").MODELS["loop"]
    answer = module.answer(drive, replace(model, sigma=math.radians(0.1)), module.OPTIONS[1])
    assert answer.association.f1(drive.truth()) > 0.9
    assert answer.poses.shape == (40, 3)


@pytest.mark.usefixtures("study")
def test_joint_compatibility_takes_the_largest_compatible_set() -> None:
    module = import_module("joint_compatibility")
    gates = module.chi2.ppf(0.95, np.arange(1, 5))
    # Two landmarks with one common error: both predictions are off alike, and only together.
    joint = np.full((2, 2), 25.0)
    alike = np.array([[5.0, 9.0], [1.0, 5.0]])
    assert module.Search(alike, joint, gates).best.tolist() == [0, 1]
    apart = np.array([[5.0, 30.0], [30.0, -5.0]])
    assert module.Search(apart, joint, gates).best.tolist() == [0, MISSED]


def test_associations_of_a_failed_drive_are_empty(study: ModuleType) -> None:
    scores = import_module("drive_scores")
    named = {"set_name": "loop", "half": "scored", "method": "m", "option": ""}
    (row,) = scores.score(loop(1), study.Answer(None), **named)
    assert (row.common, row.answered, row.confirmed) == (0, 0, 0)
    assert row.true > 0
    assert math.isnan(row.position_sim)
    assert Association([], loop(1).n_detections).n_landmarks == 0


def test_a_table_with_other_columns_is_kept_aside(
    study: ModuleType, run_study: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "rows.csv").write_text("set,f1\nloop,0.5\n", encoding="utf-8")
    rows = run_study(lambda drive, _model, _option: study.Answer(drive.truth()))
    assert len(rows) == N_DRIVES
    assert (tmp_path / "rows.old.csv").read_text(encoding="utf-8") == "set,f1\nloop,0.5\n"


@pytest.mark.usefixtures("study")
def test_both_halves_of_a_simulated_set_have_all_sizes(monkeypatch: pytest.MonkeyPatch) -> None:
    sets = import_module("drive_sets")
    monkeypatch.setattr(sets, "N_SEEDS", 2)
    drives = sets.simulated("smooth")
    sizes = [{(len(d.reference_landmarks), len(d)) for d in half} for half in sets.halves(drives)]
    assert sizes[0] == sizes[1] == set(sets.SIMULATED)
    assert len({d.name for d in drives}) == len(drives)
