"""`mht-slam bearings` as its users meet it: pictures in, scans and overlays out."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from mht_slam.cli import bearings
from mht_slam.cli.main import main
from mht_slam.datasets import read_scans
from mht_slam.errors import MissingExtraError
from mht_slam.measurements import wrap_angle
from mht_slam.simulation.panorama import cones_at, render_panorama, render_ring
from mht_slam.vision import PanoramaCamera, Ring
from mht_slam.vision.images import write_image

CONES = [[4.0, 3.0], [-2.0, 5.0], [3.0, -6.0]]
TRUE = np.arctan2(*np.array(CONES).T[::-1])


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    path = tmp_path / "picture.png"
    rng = np.random.default_rng(0)
    write_image(path, render_panorama([0, 0, 0], cones_at(CONES), rng))
    return path


def found_in(path: Path, scan: int = 0) -> np.ndarray:
    return np.sort(read_scans(path).scans[scan].bearings)


def error_line(capsys: pytest.CaptureFixture[str]) -> str:
    captured = capsys.readouterr()
    assert captured.err.startswith("mht-slam: error: ")
    assert captured.err.count("\n") == 1
    return captured.err


def test_pictures_become_scans_with_sigmas_and_overlays(
    picture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "scans.jsonl"
    assert main(["bearings", str(picture), str(picture), "-o", str(output)]) == 0
    content = read_scans(output)
    assert len(content.scans) == 2
    assert found_in(output) == pytest.approx(np.sort(TRUE), abs=math.radians(0.1))
    assert content.scans[0].sigma is not None
    assert (content.scans[0].sigma < math.radians(0.1)).all()
    overlays = sorted(path.name for path in (tmp_path / "scans_overlays").iterdir())
    assert overlays == ["000_picture.png", "001_picture.png"]
    assert "3 cones at" in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == {
        "picture.png", "scans.jsonl", "scans_overlays",
    }  # fmt: skip


def test_mounting_and_direction_are_degrees_and_words(picture: Path, tmp_path: Path) -> None:
    output = tmp_path / "scans.jsonl"
    options = ["--mounting-deg", "90", "--direction", "counter-clockwise", "--no-overlays"]
    assert main(["bearings", str(picture), "-o", str(output), *options]) == 0
    expected = np.sort(wrap_angle(math.pi / 2.0 - TRUE))
    assert found_in(output) == pytest.approx(expected, abs=math.radians(0.1))
    assert not (tmp_path / "scans_overlays").exists()


def test_a_ring_is_given_by_its_centre_and_radii(tmp_path: Path) -> None:
    ring, rng = Ring(205.0, 210.0, 60.0, 200.0), np.random.default_rng(0)
    picture = render_ring([0, 0, 0], cones_at(CONES), rng, camera=PanoramaCamera(ring=ring))
    write_image(tmp_path / "ring.png", picture)
    output = tmp_path / "scans.jsonl"
    options = ["--ring", "210", "205", "60", "200", "--extra-sigma-deg", ".5"]
    assert main(["bearings", str(tmp_path / "ring.png"), "-o", str(output), *options]) == 0
    assert found_in(output) == pytest.approx(np.sort(TRUE), abs=math.radians(0.2))
    sigma = read_scans(output).scans[0].sigma
    assert sigma is not None
    assert (sigma > math.radians(0.5)).all()


def wrong_pictures(folder: Path) -> dict[str, tuple[Path, str]]:
    """Each kind of wrong picture, with words of its error."""
    green = np.full((40, 100, 3), (0.2, 0.6, 0.1))
    orange = np.full((40, 100, 3), (0.95, 0.4, 0.08))
    for name, picture in (("green", green), ("orange", orange)):
        write_image(folder / f"{name}.png", picture)
    (folder / "text.png").write_text("no picture")
    return {
        "no file": (folder / "nowhere.png", "no such file"),
        "not an image": (folder / "text.png", "cannot be read as a picture"),
        "no matching colour": (folder / "green.png", "no pixel matches"),
        "all pixels matching": (folder / "orange.png", "100% of the pixels match"),
    }


@pytest.mark.parametrize(
    "kind", ["no file", "not an image", "no matching colour", "all pixels matching"]
)
def test_a_wrong_picture_is_one_line_and_nothing_is_written(
    picture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    path, words = wrong_pictures(tmp_path)[kind]
    before = set(tmp_path.iterdir())
    assert main(["bearings", str(picture), str(path), "-o", str(tmp_path / "scans.jsonl")]) == 2
    line = error_line(capsys)
    assert words in line
    assert path.name in line
    assert set(tmp_path.iterdir()) == before


def test_a_picture_without_a_cone_may_be_an_empty_scan(picture: Path, tmp_path: Path) -> None:
    wrong_pictures(tmp_path)
    output = tmp_path / "scans.jsonl"
    pictures = [str(picture), str(tmp_path / "green.png")]
    assert main(["bearings", *pictures, "-o", str(output), "--allow-none"]) == 0
    assert [len(scan) for scan in read_scans(output).scans] == [3, 0]


@pytest.mark.parametrize(
    ("output", "words"),
    [
        ("scans.csv", "sigmas have no place"),
        ("nowhere/scans.jsonl", "is no folder"),
        ("old.jsonl", "exists"),
        ("kept.jsonl", "kept_overlays exists"),
    ],
)
def test_an_output_that_cannot_be_is_refused_first(
    picture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], output: str, words: str
) -> None:
    (tmp_path / "old.jsonl").write_text("kept")
    (tmp_path / "kept_overlays").mkdir()
    assert main(["bearings", str(picture), "-o", str(tmp_path / output)]) == 2
    assert words in error_line(capsys)
    assert (tmp_path / "old.jsonl").read_text() == "kept"


def test_no_picture_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        code: object = main(["bearings", "-o", str(tmp_path / "scans.jsonl")])
    except SystemExit as usage:
        code = usage.code
    assert code == 2
    assert capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_missing_extra_is_one_line_with_its_remedy(
    picture: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def missing(*_: object) -> None:
        raise MissingExtraError("pictures need scikit-image: pip install 'mht-slam[vision]'")

    monkeypatch.setattr(bearings, "_detect", missing)
    assert main(["bearings", str(picture), "-o", str(tmp_path / "scans.jsonl")]) == 2
    assert "mht-slam[vision]" in error_line(capsys)


def test_pictures_of_the_papers_scene_are_simulated_for_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parent = tmp_path / "runs"
    simulate = ["simulate", "--kind", "paper", "--panoramas", "--output", str(parent)]
    assert main([*simulate, "--epsilon-deg", "1"]) == 0
    pictures = sorted(str(path) for path in (parent / "latest" / "panoramas").iterdir())
    assert len(pictures) == 3
    output = tmp_path / "scans.jsonl"
    assert main(["bearings", *pictures, "-o", str(output)]) == 0
    noisy = parent / "latest" / "scans.jsonl"
    for scan in range(3):
        # The scan file's noise is inside epsilon, the pictures' far below.
        assert found_in(output, scan) == pytest.approx(found_in(noisy, scan), abs=math.radians(1.1))
    assert main(["simulate", "--panoramas", "--output", str(parent)]) == 2
    assert "panoramas: only kind paper" in error_line(capsys)
