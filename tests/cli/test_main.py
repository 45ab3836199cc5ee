"""The command line as its users meet it: what it leaves behind, and how it fails."""

from __future__ import annotations

import csv
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mht_slam import __version__, pipeline
from mht_slam.cli.main import main
from mht_slam.cli.model_options import ModelOptions
from mht_slam.datasets import read_scans
from mht_slam.models import ObservationModel

SCRIPT = [sys.executable, "-c", "import sys; from mht_slam.cli.main import main; sys.exit(main())"]


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    parent = tmp_path_factory.mktemp("demo") / "runs"
    assert main(["demo", "--output", str(parent)]) == 0
    return parent / "latest"


@pytest.fixture
def scan_file(tmp_path: Path) -> Path:
    parent = tmp_path / "simulated"
    assert main(["simulate", "--landmarks", "3", "--output", str(parent)]) == 0
    return parent / "latest" / "scans.jsonl"


def run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(  # noqa: S603 - our own interpreter and program
        [*SCRIPT, *arguments], capture_output=True, text=True, cwd=cwd, check=False
    )


def error_line(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line of an error."""
    captured = capsys.readouterr()
    assert captured.err.startswith("mht-slam: error: ")
    assert captured.err.count("\n") == 1
    return captured.err


def test_the_demo_leaves_results_table_trajectory_and_figures(demo: Path) -> None:
    names = {path.name for path in demo.iterdir()}
    assert names == {
        "configuration.json",
        "results.json",
        "table.csv",
        "trajectory.tum",
        "cells.png",
        "landmark_frame.png",
        "comparison.png",
        "run_map.png",
    }
    for figure in demo.glob("*.png"):
        assert figure.stat().st_size > 20_000
    assert demo.is_symlink()
    assert demo.resolve().name.endswith("Z-demo")


def test_the_results_hold_every_hypothesis_with_its_scores_and_estimate(demo: Path) -> None:
    results = json.loads((demo / "results.json").read_text())
    assert set(results) == {
        "format", "scans", "n_detections", "unit", "model", "ranking", "truth", "comparison",
        "hypotheses", "seeds", "detections", "marginal_same_landmark",
    }  # fmt: skip
    hypotheses = results["hypotheses"]
    assert len(hypotheses) > 1, "the demo compares several hypotheses"
    assert sum(h["probability"] for h in hypotheses) == pytest.approx(1.0)
    assert [h["evidence_rank"] for h in hypotheses] == list(range(1, len(hypotheses) + 1))
    assert sum(h["truth"] for h in hypotheses) == 1
    assert all(h["polygon_score"] > 0.0 for h in hypotheses)
    assert np.shape(hypotheses[0]["poses"]) == (3, 3)
    assert np.shape(hypotheses[0]["landmark_covariances"]) == (3, 2, 2)
    assert np.shape(results["marginal_same_landmark"]) == (9, 9)
    assert results["model"]["sigma"] == pytest.approx(math.radians(3.0) / math.sqrt(3.0))


def test_the_table_says_the_same_as_the_results(demo: Path) -> None:
    with (demo / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    hypotheses = json.loads((demo / "results.json").read_text())["hypotheses"]
    assert len(rows) == len(hypotheses)
    for row, hypothesis in zip(rows, hypotheses, strict=True):
        for name in ("polygon_score", "log_likelihood", "log_evidence", "probability"):
            assert float(row[name]) == hypothesis[name]
        assert int(row["truth"]) == hypothesis["truth"]


def test_the_configuration_names_options_model_seed_and_versions(demo: Path) -> None:
    configuration = json.loads((demo / "configuration.json").read_text())
    assert configuration["seed"] == 0
    assert configuration["options"]["method"]["epsilon_deg"] == 3.0
    assert configuration["model"]["landmark_sigma"] == 30.0
    assert set(configuration["versions"]) == {
        "mht-slam", "numpy", "scipy", "shapely", "gtsam", "python",
    }  # fmt: skip


def test_the_trajectory_is_that_of_the_best_hypothesis_in_tum_format(demo: Path) -> None:
    trajectory = np.loadtxt(demo / "trajectory.tum")
    best = json.loads((demo / "results.json").read_text())["hypotheses"][0]
    poses = np.array(best["poses"])
    assert trajectory.shape == (3, 8)
    assert np.array_equal(trajectory[:, 0], [0.0, 1.0, 2.0])
    assert np.array_equal(trajectory[:, 1:3], poses[:, :2])
    assert np.allclose(2.0 * np.arctan2(trajectory[:, 6], trajectory[:, 7]), poses[:, 2])


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(
    demo: Path, tmp_path: Path
) -> None:
    for seed in ("0", "1"):
        assert main(["demo", "--seed", seed, "--output", str(tmp_path / seed)]) == 0
    for name in ("results.json", "table.csv", "trajectory.tum"):
        same = (tmp_path / "0" / "latest" / name).read_bytes()
        assert same == (demo / name).read_bytes()
        assert same != (tmp_path / "1" / "latest" / name).read_bytes()


def test_the_screen_shows_one_table_with_the_truth_marked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--output", str(tmp_path)]) == 0
    screen = capsys.readouterr()
    assert screen.out.count("Hypotheses, most probable first") == 1
    assert sum(line.rstrip().endswith(" truth") for line in screen.out.splitlines()) == 2, (
        "the heading and one row"
    )
    assert "agree on the first hypothesis" in screen.out
    assert "landmark_sigma=30" in screen.out
    assert f"Results: {tmp_path}" in screen.out
    assert screen.err == "", "no progress bar where there is no terminal"


def test_a_simulated_file_is_solved_with_its_truth(
    scan_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "runs"
    assert main(["solve", str(scan_file), "--output", str(out), "--figure-format", "svg"]) == 0
    assert "the truth ranks" in capsys.readouterr().out
    assert len(list((out / "latest").glob("*.svg"))) == 4


def test_three_scans_of_a_longer_file_are_solved(tmp_path: Path) -> None:
    simulated, out = tmp_path / "simulated", tmp_path / "runs"
    options = ["--landmarks", "3", "--n-scans", "5", "--noise", "gaussian", "--sigma-deg", "0.5"]
    assert main(["simulate", *options, "--output", str(simulated)]) == 0
    file = simulated / "latest" / "scans.jsonl"
    assert main(["solve", str(file), "--scans", "0", "2", "4", "--output", str(out)]) == 0
    results = json.loads((out / "latest" / "results.json").read_text())
    assert results["scans"] == [0, 2, 4]
    truth = read_scans(file).truth
    assert truth is not None
    assert results["truth"] == truth.restrict([0, 2, 4]).table.tolist()


def a_longer_file(tmp_path: Path, *options: str) -> Path:
    fixed = ["--landmarks", "3", "--n-scans", "5", "--noise", "gaussian", "--sigma-deg", "0.5"]
    assert main(["simulate", *fixed, *options, "--output", str(tmp_path / "simulated")]) == 0
    return tmp_path / "simulated" / "latest" / "scans.jsonl"


def test_a_longer_file_is_solved_over_all_of_its_scans(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = a_longer_file(tmp_path), tmp_path / "runs"
    capsys.readouterr()
    assert main(["solve", str(file), "--sigma-deg", "0.5", "--output", str(out)]) == 0
    screen = capsys.readouterr().out
    assert "Scans 0, 1, 2: hypotheses" in screen
    assert "All 5 scans: hypotheses" in screen
    assert screen.count("motion=straight") == 1
    results = json.loads((out / "latest" / "results.json").read_text())
    assert results["scans"] == [0, 1, 2, 3, 4]
    assert results["ranking"]["scans"] == [0, 1, 2]
    best = results["hypotheses"][0]
    assert best["truth"] is True
    assert best["polygon_score"] is None
    assert np.shape(best["poses"]) == (5, 3)
    assert sum(h["probability"] for h in results["hypotheses"]) == pytest.approx(1.0)
    assert all(np.shape(h["poses"]) == (3, 3) for h in results["seeds"])
    assert results["seeds"][0]["polygon_score"] > 0.0
    assert np.loadtxt(out / "latest" / "trajectory.tum").shape == (5, 8)
    for name, listed in (("table.csv", "hypotheses"), ("seeds.csv", "seeds")):
        with (out / "latest" / name).open(newline="") as table:
            assert len(list(csv.DictReader(table))) == len(results[listed])
    assert {path.name for path in (out / "latest").glob("*.png")} == {
        "cells.png", "landmark_frame.png", "comparison.png", "run_map.png",
    }  # fmt: skip


def test_scans_with_misses_need_a_model_that_knows_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = a_longer_file(tmp_path), tmp_path / "runs"
    lines = file.read_text().splitlines()
    short = json.loads(lines[1])
    short["bearings_deg"], short["landmarks"] = short["bearings_deg"][1:], short["landmarks"][1:]
    lines[1] = json.dumps(short)
    file.write_text("\n".join(lines))
    capsys.readouterr()
    solve = ["solve", str(file), "--output", str(out)]
    assert main(solve) == 2
    assert "--preset" in error_line(capsys)
    assert main([*solve, "--preset", "panoramic", "--sigma-deg", "0.5"]) == 0
    screen = capsys.readouterr().out
    assert "Polygons rank nothing here" in screen
    assert "All 5 scans: hypotheses" in screen
    model = json.loads((out / "latest" / "results.json").read_text())["model"]
    assert model["motion"] == "smooth"
    assert model["detection_probability"] == 0.9
    assert model["sigma"] == pytest.approx(math.radians(0.5)), "an option goes before the preset"
    assert (out / "latest" / "seeds.csv").read_text().count("\n") == 1


def test_every_option_of_the_model_reaches_the_model() -> None:
    assumed = ModelOptions(
        motion="smooth",
        sigma_deg=0.5,
        bearing_dof=4.0,
        heading_sigma_deg=1.0,
        lateral_sigma=0.1,
        turn_sigma_deg=2.0,
        drift_sigma_deg=3.0,
        step_change_sigma=0.3,
        stops=True,
        landmark_sigma=12.0,
        detection_probability=0.8,
        false_alarm_rate=0.2,
        expected_landmarks=6.0,
        stay_probability=0.9,
        field_of_view_deg=110.0,
    )
    options = {field.name.removesuffix("_deg") for field in fields(ModelOptions)}
    without_option = {"landmark_centre", "log_step_mean", "log_step_sigma"}
    assert options - {"preset"} == {f.name for f in fields(ObservationModel)} - without_option
    model = assumed.model(epsilon=0.05)
    for field in fields(ModelOptions):
        value = getattr(assumed, field.name)
        if field.name.endswith("_deg"):
            assert getattr(model, field.name.removesuffix("_deg")) == math.radians(value)
        elif field.name != "preset":
            assert getattr(model, field.name) == value


def test_more_workers_give_the_same_bytes(tmp_path: Path) -> None:
    file = a_longer_file(tmp_path)
    for workers in ("1", "2"):
        out = ["--output", str(tmp_path / workers)]
        assert main(["solve", str(file), "--workers", workers, *out]) == 0
    for name in ("results.json", "table.csv", "seeds.csv", "trajectory.tum"):
        alone, together = (tmp_path / n / "latest" / name for n in ("1", "2"))
        assert alone.read_bytes() == together.read_bytes()


def test_the_workers_of_a_dask_cluster_give_the_same_bytes(
    scan_file: Path, tmp_path: Path, start_dask: Callable[[int], Any]
) -> None:
    with start_dask(1) as cluster:
        dask = ["--dask", cluster.scheduler_address]
        assert main(["solve", str(scan_file), *dask, "--output", str(tmp_path / "dask")]) == 0
    assert main(["solve", str(scan_file), "--output", str(tmp_path / "alone")]) == 0
    there, here = (tmp_path / n / "latest" / "results.json" for n in ("dask", "alone"))
    assert there.read_bytes() == here.read_bytes()


def test_two_pairs_of_scans_are_solved(tmp_path: Path) -> None:
    simulated, out = tmp_path / "simulated", tmp_path / "runs"
    options = ["--pair", "--landmarks", "3", "--epsilon-deg", "2", "--seed", "3"]
    assert main(["simulate", *options, "--output", str(simulated)]) == 0
    file = simulated / "latest" / "scans.jsonl"
    solve = ["solve", str(file), "--pair", "--epsilon-deg", "2", "--output", str(out)]
    assert main(solve) == 0
    results = json.loads((out / "latest" / "results.json").read_text())
    assert results["scans"] == [0, 1, 2, 3]
    assert results["comparison"]["truth_polygon_rank"] is not None


def test_nothing_listed_is_said_and_is_no_failure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "bad.jsonl"
    # Bearings that only turn towards the front: no landmark can be passed like this.
    lines = [json.dumps({"bearings_deg": [b - 9 * k for b in (40, 80, 120)]}) for k in range(3)]
    file.write_text("\n".join(lines))
    out = tmp_path / "runs"
    solve = ["solve", str(file), "--epsilon-deg", "0.5", "--output", str(out)]
    assert main(solve) == 0
    assert "No association has a positive polygon score" in capsys.readouterr().out
    results = json.loads((out / "latest" / "results.json").read_text())
    assert results["hypotheses"] == []
    assert {p.name for p in (out / "latest").glob("*.png")} == {"cells.png"}


def test_simulation_is_determined_by_its_seed(tmp_path: Path) -> None:
    files = []
    for name, seed in (("a", "5"), ("b", "5"), ("c", "6")):
        out = ["--seed", seed, "--output", str(tmp_path / name)]
        assert main(["simulate", "--kind", "corridor", *out]) == 0
        files.append((tmp_path / name / "latest" / "scans.jsonl").read_bytes())
        world = json.loads((tmp_path / name / "latest" / "world.json").read_text())
        assert np.shape(world["landmarks"]) == (4, 2)
    assert files[0] == files[1] != files[2]


@pytest.mark.parametrize(
    "options",
    [
        ["--kind", "paper"],
        ["--kind", "model", "--noise", "gaussian"],
        ["--kind", "one_sided", "--n-scans", "4", "--file-format", "csv"],
        ["--kind", "clusters", "--noise", "heavy_tailed"],
    ],
)
def test_every_kind_of_scene_is_written_with_its_truth(tmp_path: Path, options: list[str]) -> None:
    assert main(["simulate", *options, "--output", str(tmp_path)]) == 0
    (file,) = (tmp_path / "latest").glob("scans.*")
    assert read_scans(file).truth is not None


def test_a_round_trip_through_csv_loses_nothing(scan_file: Path, tmp_path: Path) -> None:
    there, back = tmp_path / "scans.csv", tmp_path / "back.jsonl"
    assert main(["convert", str(scan_file), str(there)]) == 0
    assert main(["convert", str(there), str(back)]) == 0
    assert read_scans(back) == read_scans(scan_file)


def test_what_csv_cannot_hold_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "scans.jsonl"
    source.write_text('{"bearings_deg": [1, 2], "sigma_deg": 1.0}\n')
    assert main(["convert", str(source), str(tmp_path / "scans.csv")]) == 2
    assert "sigma" in error_line(capsys)
    assert not (tmp_path / "scans.csv").exists()


def test_an_existing_target_is_not_overwritten(
    scan_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "mine.csv"
    target.write_text("mine")
    capsys.readouterr()
    assert main(["convert", str(scan_file), str(target)]) == 2
    assert "exists" in error_line(capsys)
    assert target.read_text() == "mine"


def test_runs_of_the_same_second_get_folders_of_their_own(tmp_path: Path) -> None:
    for _ in range(3):
        assert main(["simulate", "--output", str(tmp_path)]) == 0
    folders = [path for path in tmp_path.iterdir() if not path.is_symlink()]
    assert len(folders) == 3
    assert all((folder / "scans.jsonl").is_file() for folder in folders)


@pytest.mark.parametrize(
    ("content", "options", "named"),
    [
        (None, [], "cannot be read"),
        ('{"bearings_deg": [1, 2, 3]}\n{"bearings_deg": oops}\n', [], ":2:"),
        ('{"bearings_deg": [1, 2, 3]}\n' * 2, [], "at least 3"),
        ('{"bearings_deg": [1, 2]}\n' * 3, [], "at least 3"),
        ('{"bearings_deg": [1, 2, 3]}\n' * 3, ["--scans", "0", "1", "9"], "scan 9"),
        ('{"bearings_deg": [1, 2, 3]}\n' * 3, ["--epsilon-deg", "95"], "epsilon_deg"),
        ('{"bearings_deg": [1, 2, 3]}\n' * 3, ["--epsilon-deg", "nan"], "epsilon_deg"),
        ('{"bearings_deg": [1, 2, 3]}\n' * 3, ["--sigma-deg", "0"], "sigma_deg"),
        ('{"bearings_deg": [1, 2, 3]}\n' * 3, ["--top-k", "0"], "top_k"),
        ('{"bearings_deg": [1, 2, 3]}\n' * 3, ["--workers", "0"], "workers"),
        ('{"bearings_deg": [1, 2, 3]}\n' * 3, ["--workers", "5000"], "at most 1024"),
        ('{"bearings_deg": [1, 2, 3]}\n' * 3, ["--dask", "nowhere"], "dask"),
        ('{"bearings_deg": [1, 2, 3]}\n' * 3, ["--dask", "tcp://x:1", "--workers", "2"], "dask"),
        ('{"bearings_deg": [1, 2, 3]}\n' * 3, ["--turn-sigma-deg", "-1"], "turn_sigma_deg"),
        ('{"bearings_deg": [1, 2, 3]}\n' * 3, ["--field-of-view-deg", "400"], "field_of_view_deg"),
        ('{"bearings_deg": [1, 2, 3]}\n' * 3, ["--detection-probability", "2"], "detection_prob"),
        ('{"bearings_deg": [1, 2, 3]}\n' * 3, ["--pair"], "exactly four"),
        ('{"bearings_deg": [1, 2, 3]}\n{"bearings_deg": [1, 2, 3, 4]}\n' * 2, [], "detections"),
    ],
)
def test_an_error_is_one_line_that_names_what_is_wrong_and_leaves_no_folder(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    content: str | None,
    options: list[str],
    named: str,
) -> None:
    file, out = tmp_path / "scans.jsonl", tmp_path / "runs"
    if content is not None:
        file.write_text(content)
    assert main(["solve", str(file), *options, "--output", str(out)]) == 2
    assert named in error_line(capsys)
    assert not out.exists() or not list(out.iterdir())


def test_an_output_that_cannot_be_made_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("in the way")
    assert main(["demo", "--output", str(tmp_path / "file" / "runs")]) == 2
    error_line(capsys)


@pytest.mark.parametrize(
    "options",
    [
        ["--kind", "model"],
        ["--kind", "paper", "--n-scans", "4"],
        ["--sigma-deg", "1"],
        ["--pair", "--kind", "model", "--noise", "gaussian"],
        ["--pair", "--n-scans", "5"],
        ["--seed", "-1"],
        ["--n-scans", "2"],
    ],
)
def test_options_that_would_be_ignored_or_make_no_sense_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str]
) -> None:
    assert main(["simulate", *options, "--output", str(tmp_path)]) == 2
    error_line(capsys)


def test_an_interrupt_ends_quietly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(pipeline, "solve", interrupted)
    assert main(["demo", "--output", str(tmp_path)]) == 130
    assert capsys.readouterr().err == "mht-slam: interrupted\n"
    assert list(tmp_path.iterdir()) == []


def test_wrong_usage_leaves_with_code_two(tmp_path: Path) -> None:
    done = run("demo", "--bogus", cwd=tmp_path)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


def test_the_version_is_printed_alone(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"mht-slam {__version__}\n"


def test_help_loads_neither_gtsam_nor_matplotlib(tmp_path: Path) -> None:
    program = (
        "import sys\nfrom mht_slam.cli.main import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit as end:\n    assert not end.code\n"
        "print([m for m in ('gtsam', 'matplotlib', 'shapely', 'scipy') if m in sys.modules])"
    )
    done = subprocess.run(  # noqa: S603 - our own interpreter and program
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    assert done.stdout.rstrip().endswith("[]")
    assert all(command in done.stdout for command in ("demo", "solve", "simulate", "convert"))


def test_a_reader_that_leaves_ends_the_command_quietly(tmp_path: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(  # noqa: S603 - our own interpreter and program
        [*SCRIPT, "demo"], stdout=write, stderr=subprocess.PIPE, text=True, cwd=tmp_path,
        check=False,
    )  # fmt: skip
    os.close(write)
    assert done.returncode == 141
    assert done.stderr == ""
