"""`mht-slam track`: a scan file becomes tracks, a figure and a report, or one line of an error."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from mht_slam.association import Association
from mht_slam.cli.main import main
from mht_slam.datasets import write_scans
from mht_slam.measurements import BearingScan

LANDMARKS = np.array([(2.0, 1.5), (2.4, 3.0), (1.0, -2.0), (-3.0, 1.0)])


@pytest.fixture(params=["scans.jsonl", "scans.csv"])
def scan_file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A dense run in which the first two landmarks cross, and its truth."""
    scans = []
    for x in np.arange(0.0, 3.0, 0.1):
        away = LANDMARKS - (x, 0.0)
        scans.append(BearingScan(np.arctan2(away[:, 1], away[:, 0])))
    path = tmp_path / str(request.param)
    write_scans(path, scans, Association.from_labels([range(4)] * len(scans)))
    return path


def test_a_file_becomes_tracks_a_figure_and_a_report(
    scan_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parent = tmp_path / "runs"
    assert main(["track", str(scan_file), "--sigma-deg", ".05", "--output", str(parent)]) == 0
    folder = parent / "latest"
    assert {path.name for path in folder.iterdir()} == {
        "configuration.json",
        "tracks.csv",
        "tracks.json",
        "tracks.png",
    }
    results = json.loads((folder / "tracks.json").read_text())
    assert results["tracks"] == [[k] * 30 for k in range(4)]
    assert results["f1"] == 1.0
    assert [exchange["pair"] for exchange in results["exchanges"]] == [[0, 1]]
    assert all(0.9 < probability <= 1.0 for probability in results["probabilities"])
    with (folder / "tracks.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4 * 30
    assert float(rows[0]["bearing_deg"]) == pytest.approx(np.degrees(np.arctan2(1.5, 2.0)))
    configuration = json.loads((folder / "configuration.json").read_text())
    assert configuration["model"]["sigma"] == pytest.approx(np.deg2rad(0.05))
    said = capsys.readouterr().out
    assert "4 tracks through 30 scans; detections in none: 0; exchanges of places: 1." in said
    assert "Pairwise F1 against the truth: 1.000." in said


def test_the_paper_rule_and_another_figure_format_are_options(
    scan_file: Path, tmp_path: Path
) -> None:
    options = ["--mode", "paper", "--figure-format", "svg", "--output", str(tmp_path / "runs")]
    assert main(["track", str(scan_file), *options]) == 0
    folder = tmp_path / "runs" / "latest"
    assert (folder / "tracks.svg").exists()
    assert json.loads((folder / "configuration.json").read_text())["model"]["mode"] == "paper"


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--sigma-deg", "0"], "sigma_deg"),
        (["--turn-sigma-deg", "-1"], "turn_sigma_deg"),
        (["--detection-probability", "1"], "detection_probability"),
        (["--confirm", "0"], "confirm"),
    ],
)
def test_options_that_make_no_sense_are_one_line_and_leave_no_folder(
    scan_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    named: str,
) -> None:
    parent = tmp_path / "runs"
    assert main(["track", str(scan_file), *options, "--output", str(parent)]) == 2
    line = capsys.readouterr().err
    assert line.startswith("mht-slam: error: ")
    assert line.count("\n") == 1
    assert named in line
    assert not parent.exists()


def test_no_file_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["track", str(tmp_path / "absent.jsonl"), "--output", str(tmp_path / "runs")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
