"""`mht-slam slam`: one line per scan at once, and results whatever becomes of the run."""

from __future__ import annotations

import csv
import errno
import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mht_slam.association import Association
from mht_slam.cli.main import main
from mht_slam.datasets import read_scans, write_scans
from mht_slam.incremental.estimator import MultiHypothesisSlam
from mht_slam.presets import panoramic_robot
from mht_slam.simulation.drives import OdometryNoise, simulate_drive

SCRIPT = [sys.executable, "-c", "import sys; from mht_slam.cli.main import main; sys.exit(main())"]
MODEL = ["--motion", "odometry", "--sigma-deg", "0.5", "--lag", "6", "--hypotheses", "4"]
N_SCANS = 24
ALL_FILES = {
    "configuration.json",
    "results.json",
    "table.csv",
    "map.csv",
    "associations.csv",
    "trajectory.tum",
    "trajectory_online.tum",
    "map.png",
}


@pytest.fixture(autouse=True)
def interruptible() -> Iterator[None]:
    """Shells start jobs in the background deaf to interrupts, and their children inherit it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="module")
def scan_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(3)
    drive = simulate_drive(
        "loop", 8, N_SCANS, rng, sigma=math.radians(0.5), odometry=OdometryNoise()
    )
    path = tmp_path_factory.mktemp("slam") / "scans.jsonl"
    write_scans(path, drive.scans, drive.truth())
    return path


@pytest.fixture(scope="module")
def whole(scan_file: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[str], Path]:
    """The lines and the folder of a run that nothing disturbs, animation included."""
    parent = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch, (parent / "lines").open("w+") as out:
        patch.setattr(sys, "stdout", out)
        options = ["--animate", "--output", str(parent / "runs")]
        assert main(["slam", str(scan_file), *MODEL, *options]) == 0
        out.seek(0)
        return out.read().splitlines(), parent / "runs" / "latest"


class Live:
    """The command on a live pipe."""

    def __init__(self, *options: str) -> None:
        self.process = subprocess.Popen(  # noqa: S603 - our own interpreter and program
            [*SCRIPT, "slam", "-", *MODEL, *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            bufsize=1,
        )

    def give(self, lines: list[str]) -> None:
        assert self.process.stdin is not None
        for line in lines:
            self.process.stdin.write(line + "\n")

    def line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().removesuffix("\n")

    def end(self) -> tuple[int, str]:
        """Close the pipe where it is open; the exit code and what was said on stderr."""
        _, said = self.process.communicate(timeout=60)
        return self.process.returncode, said


def run(*arguments: str) -> int:
    return main(["slam", *arguments])


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def results(folder: Path) -> dict[str, Any]:
    found = json.loads((folder / "results.json").read_text())
    assert isinstance(found, dict)
    return found


def test_every_scan_has_its_line(whole: tuple[list[str], Path], scan_file: Path) -> None:
    lines = [json.loads(line) for line in whole[0]]
    assert [line["scan"] for line in lines] == list(range(N_SCANS))
    assert [line["status"] for line in lines[:3]] == ["initialising"] * 2 + ["tracking"]
    for line, scan in zip(lines, read_scans(scan_file).scans, strict=True):
        assert line["time"] == scan.time
        assert len(line["detections"]) == len(scan)
        for readings in line["detections"]:
            assert 0.0 < sum(readings.values()) < 1.0 + 1e-5  # the rest: the map is mistaken
            assert list(readings.values()) == sorted(readings.values(), reverse=True)
        assert -180.0 < line["pose"]["theta_deg"] <= 180.0
    assert all(1 <= line["hypotheses"] <= 4 for line in lines[6:])  # more may be open at the start
    assert all(0.0 < line["probability"] <= 1.0 for line in lines[2:])
    assert any(line["dropped"].get("one too many") for line in lines)


def test_the_folder_holds_what_the_lines_say_and_the_estimate(
    whole: tuple[list[str], Path], scan_file: Path
) -> None:
    lines, folder = whole
    assert {path.name for path in folder.iterdir()} == {*ALL_FILES, "run.gif"}
    told = results(folder)
    assert (told["n_scans"], told["unit"], told["status"]) == (N_SCANS, "metre", "tracking")
    assert told["rejected"] == {"malformed": 0, "refused": 0}
    last = json.loads(lines[-1])
    table = rows(folder / "table.csv")
    assert len(table) == last["hypotheses"] == len(told["hypotheses"])
    assert float(table[0]["probability"]) == pytest.approx(last["probability"], abs=1e-6)
    online = np.loadtxt(folder / "trajectory_online.tum")
    assert online.shape == np.loadtxt(folder / "trajectory.tum").shape == (N_SCANS, 8)
    assert online[-1, 1:3] == pytest.approx([last["pose"]["x"], last["pose"]["y"]], abs=1e-6)
    landmarks = {row["landmark"]: int(row["sightings"]) for row in rows(folder / "map.csv")}
    assert len(landmarks) == told["landmarks"]
    associations = rows(folder / "associations.csv")
    scans, truth = read_scans(scan_file).scans, read_scans(scan_file).truth
    assert len(associations) == sum(map(len, scans))
    labels: list[list[str | None]] = [[] for _ in scans]
    for row in associations:
        labels[int(row["scan"])].append(row["landmark"] or None)
    assert truth is not None
    assert told["f1"] == Association.from_labels(labels).f1(truth) > 0.0
    names = [row["landmark"] for row in associations]
    assert {name: names.count(name) for name in landmarks} == landmarks
    assert float(associations[1]["bearing_deg"]) == pytest.approx(
        math.degrees(scans[0].bearings[1])
    )
    configuration = json.loads((folder / "configuration.json").read_text())
    assert configuration["model"]["motion"] == "odometry"
    assert configuration["options"]["estimator"]["lag"] == 6


def test_a_live_pipe_is_answered_scan_by_scan_and_an_interrupt_leaves_results(
    whole: tuple[list[str], Path], scan_file: Path, tmp_path: Path
) -> None:
    scans = scan_file.read_text().splitlines()
    live = Live("--output", str(tmp_path / "runs"), "--checkpoint", str(tmp_path / "c"))
    for k in range(12):
        live.give([scans[k]])
        assert live.line() == whole[0][k]  # before the next scan is given
    live.process.send_signal(signal.SIGINT)
    code, said = live.end()
    assert code == 130
    assert said.endswith("mht-slam: interrupted\n")
    assert results(tmp_path / "runs" / "latest")["n_scans"] == 12
    assert MultiHypothesisSlam.load(tmp_path / "c").n_scans == 12


def test_an_interrupt_in_the_middle_of_a_scan_waits_until_it_is_done(
    whole: tuple[list[str], Path],
    scan_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looked_at = MultiHypothesisSlam.posterior.fget
    assert looked_at is not None

    def interrupted(slam: MultiHypothesisSlam) -> Any:
        if slam.n_scans == 7:
            os.kill(os.getpid(), signal.SIGINT)
        return looked_at(slam)

    monkeypatch.setattr(MultiHypothesisSlam, "posterior", property(interrupted))
    options = ["--output", str(tmp_path / "runs"), "--checkpoint", str(tmp_path / "c")]
    assert run(str(scan_file), *MODEL, *options) == 130
    monkeypatch.undo()
    assert run(str(scan_file), *options, "--resume", str(tmp_path / "c")) == 0
    assert capsys.readouterr().out.splitlines() == whole[0]


def test_an_interrupt_at_the_end_of_the_stream_still_leaves_results(
    scan_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save = MultiHypothesisSlam.save

    def interrupted(slam: MultiHypothesisSlam, path: Path) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        save(slam, path)

    monkeypatch.setattr(MultiHypothesisSlam, "save", interrupted)
    options = ["--output", str(tmp_path / "runs"), "--checkpoint", str(tmp_path / "c")]
    assert run(str(scan_file), *MODEL, *options) == 130
    assert results(tmp_path / "runs" / "latest")["n_scans"] == N_SCANS
    assert MultiHypothesisSlam.load(tmp_path / "c").n_scans == N_SCANS


def test_the_progress_bar_leaves_the_lines_alone(
    whole: tuple[list[str], Path],
    scan_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal
    assert run(str(scan_file), *MODEL, "--output", str(tmp_path / "runs")) == 0
    captured = capsys.readouterr()
    assert captured.out.splitlines() == whole[0]
    assert "estimating" in captured.err


def test_a_run_killed_and_resumed_gives_the_lines_and_files_of_one_never_killed(
    whole: tuple[list[str], Path],
    scan_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    saved = ["--checkpoint", str(tmp_path / "c"), "--every", "5", "--animate"]
    live = Live(*saved, "--output", str(tmp_path / "killed"))
    live.give(scan_file.read_text().splitlines()[:13])
    before = [live.line() for _ in range(13)]
    live.process.kill()
    live.end()
    assert MultiHypothesisSlam.load(tmp_path / "c").n_scans == 10
    options = [*saved, "--resume", str(tmp_path / "c"), "--output", str(tmp_path / "runs")]
    assert run(str(scan_file), *MODEL, *options) == 0
    after = capsys.readouterr().out.splitlines()
    assert before[10:] == after[:3], "what came after the checkpoint is said again"
    assert before[:10] + after == whole[0]
    for path in (tmp_path / "runs" / "latest").iterdir():
        if path.name != "configuration.json":
            assert path.read_bytes() == (whole[1] / path.name).read_bytes(), path.name
    assert MultiHypothesisSlam.load(tmp_path / "c").n_scans == N_SCANS


def test_a_stream_that_goes_on_behind_the_checkpoint_is_taken_for_that(
    whole: tuple[list[str], Path],
    scan_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    scans = scan_file.read_text().splitlines(keepends=True)
    first, rest, checkpoint = tmp_path / "a.jsonl", tmp_path / "b.jsonl", str(tmp_path / "c")
    first.write_text("".join(scans[:9]))
    rest.write_text("".join(scans[9:]))
    output = ["--output", str(tmp_path / "runs")]
    assert run(str(first), *MODEL, *output, "--checkpoint", checkpoint) == 0
    assert run(str(rest), *output, "--resume", checkpoint) == 0  # with the checkpoint's options
    assert capsys.readouterr().out.splitlines() == whole[0]
    for name in ("trajectory.tum", "associations.csv", "map.csv"):
        folder = tmp_path / "runs" / "latest"
        assert (folder / name).read_bytes() == (whole[1] / name).read_bytes()
    assert run(str(scan_file), "--lag", "7", *output, "--resume", checkpoint) == 2
    assert "other options" in capsys.readouterr().err
    short = tmp_path / "short.jsonl"
    short.write_text("".join(scans[:4]))
    assert run(str(short), *output, "--resume", checkpoint) == 2
    assert "has 4 of the 9 scans of the checkpoint" in capsys.readouterr().err


@pytest.fixture
def spoilt(scan_file: Path, tmp_path: Path) -> Path:
    """The recording with lines among its own that cannot be scans."""
    scans = scan_file.read_text().splitlines()
    late = scans[2]
    labelled = json.dumps({"time": 7.5, "bearings_deg": [1.0], "labels": ["door"]})
    still = json.dumps({"time": 7.7, "bearings_deg": [1.0]})
    bad = ['{"time": 3.5, "bearings_deg": [1, "x"]}', "not json"]
    spoilt = [*scans[:5], *bad, scans[4], *scans[5:8], late, labelled, still, *scans[8:]]
    path = tmp_path / "spoilt.jsonl"
    path.write_text("\n".join(spoilt) + "\n")
    return path


def test_lines_that_are_no_scans_are_named_and_change_nothing(
    whole: tuple[list[str], Path],
    spoilt: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    output = ["--output", str(tmp_path / "runs")]
    assert run(str(spoilt), *MODEL, *output, "--checkpoint", str(tmp_path / "c")) == 0
    captured = capsys.readouterr()
    assert captured.out.splitlines() == whole[0]
    told = [line.partition("spoilt.jsonl:")[2] for line in captured.err.splitlines()[:-2]]
    expected = {6: "bearings_deg[1]", 7: "column", 8: "time", 12: "time", 13: "labels", 14: "odom"}
    assert [int(line.partition(":")[0]) for line in told] == list(expected)
    assert all(word in line for word, line in zip(expected.values(), told, strict=True))
    assert "Lines rejected: 6." in captured.err
    folder = tmp_path / "runs" / "latest"
    assert results(folder)["rejected"] == {"malformed": 2, "refused": 4}
    for name in ("trajectory.tum", "map.csv", "associations.csv"):
        assert (folder / name).read_bytes() == (whole[1] / name).read_bytes()
    # The whole recording again: nothing new in it, the same lines are known to be none.
    assert run(str(spoilt), *MODEL, *output, "--resume", str(tmp_path / "c")) == 0
    assert capsys.readouterr().out == ""
    assert results(folder)["rejected"] == {"malformed": 2, "refused": 4}


def test_a_strict_run_ends_at_the_first_of_them(
    spoilt: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(str(spoilt), *MODEL, "--strict", "--output", str(tmp_path / "runs")) == 2
    captured = capsys.readouterr()
    assert len(captured.out.splitlines()) == 5
    assert captured.err.count("mht-slam: error: ") == 1
    assert "spoilt.jsonl:6: bearings_deg[1]" in captured.err
    assert results(tmp_path / "runs" / "latest")["n_scans"] == 5


def test_a_reader_that_leaves_ends_the_run_quietly_and_leaves_results(
    scan_file: Path, tmp_path: Path
) -> None:
    scans = scan_file.read_text().splitlines()
    checkpoint = tmp_path / "c"
    saved = ["--checkpoint", str(checkpoint), "--every", "2"]
    live = Live("--output", str(tmp_path / "runs"), *saved)
    live.give(scans[:3])
    assert [json.loads(live.line())["scan"] for _ in range(3)] == [0, 1, 2]
    assert live.process.stdout is not None
    live.process.stdout.close()
    live.give(scans[3:4])
    assert live.process.wait(timeout=60) == 141
    assert live.process.stderr is not None
    assert live.process.stderr.read() == ""
    live.process.stderr.close()
    assert live.process.stdin is not None
    live.process.stdin.close()
    assert {path.name for path in (tmp_path / "runs" / "latest").iterdir()} == ALL_FILES
    assert MultiHypothesisSlam.load(checkpoint).n_scans == 2, "the fourth line reached nobody"


def test_a_full_disk_under_the_lines_is_one_line(scan_file: Path, tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(  # noqa: S603 - our own interpreter and program
            [*SCRIPT, "slam", str(scan_file), *MODEL, "--output", str(tmp_path / "runs")],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 2
    assert done.stderr == "mht-slam: error: [Errno 28] No space left on device\n"


def test_a_full_disk_under_a_checkpoint_leaves_the_one_before(
    scan_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    written = 0

    def sync(_descriptor: int) -> None:
        nonlocal written
        written += 1
        if written == 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", sync)
    checkpoint = tmp_path / "kept" / "c"
    checkpoint.parent.mkdir()
    saved = ["--checkpoint", str(checkpoint), "--every", "4"]
    assert run(str(scan_file), *MODEL, *saved, "--output", str(tmp_path / "runs")) == 2
    captured = capsys.readouterr()
    assert len(captured.out.splitlines()) == 12
    assert captured.err.count("\n") == 1
    assert "the checkpoint cannot be written (No space left on device)" in captured.err
    assert MultiHypothesisSlam.load(checkpoint).n_scans == 8
    assert [path.name for path in checkpoint.parent.iterdir()] == ["c"]


@pytest.mark.parametrize(
    ("content", "options", "said"),
    [
        ("\n", [], "no scan could be used"),
        ("not json\n", ["--strict"], "not JSON"),
        ('{"bearings_deg": [1]}\n', ["--every", "0"], "every"),
        ('{"bearings_deg": [1]}\n', ["--lag", "0"], "lag"),
        ('{"bearings_deg": [1]}\n', ["--checkpoint", "/no/such/folder/c"], "is no folder"),
        ('{"bearings_deg": [1]}\n', ["--resume", "absent"], "absent"),
        ('{"bearings_deg": [1]}\n', ["--fit", "--resume", "absent"], "leave out fit"),
        ("not json\n", ["--fit"], "no scan could be used"),
    ],
)
def test_what_cannot_be_run_is_one_line_and_leaves_no_results(
    content: str,
    options: list[str],
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "scans.jsonl"
    path.write_text(content)
    assert run(str(path), *options, "--output", str(tmp_path / "runs")) == 2
    error = capsys.readouterr().err
    assert error.startswith("mht-slam: error: ")
    assert error.count("\n") == 1
    assert said in error
    assert not list((tmp_path / "runs").glob("*"))


def test_a_fitted_run_says_what_it_found_and_judges_by_it(
    scan_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spoilt = tmp_path / "scans.jsonl"
    lines = scan_file.read_text().splitlines()
    spoilt.write_text("\n".join([*lines[:9], "not json", lines[3], *lines[9:]]))
    options = [*MODEL, "--hypotheses", "2", "--start-hypotheses", "5", "--fit"]
    assert run(str(spoilt), *options, "--output", str(tmp_path / "runs")) == 0
    said = capsys.readouterr()
    assert len(said.out.splitlines()) == N_SCANS
    model = results(tmp_path / "runs" / "latest")["model"]
    (fitted,) = (line for line in said.err.splitlines() if line.startswith("Fitted in "))
    for name in ("landmark_sigma", "stay_probability"):
        assert f"{name} {model[name]:.3g}" in fitted
    assert model["landmark_sigma"] != panoramic_robot().landmark_sigma


def test_a_pipe_cannot_be_fitted_to(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("-", "--fit", "--output", str(tmp_path / "runs")) == 2
    assert "a pipe can be read only once: give a file" in capsys.readouterr().err


def test_one_scan_is_a_run_too_and_csv_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "scans.csv"
    path.write_text("scan,time,bearing_deg\n0,,10\n0,,-20\n")
    assert run(str(path), "--output", str(tmp_path / "runs")) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert json.loads(line)["detections"] == [{"none": 1.0}] * 2
    folder = tmp_path / "runs" / "latest"
    assert {path.name for path in folder.iterdir()} == ALL_FILES
    assert (folder / "trajectory.tum").read_text().startswith("0.0 0.0 0.0 ")
