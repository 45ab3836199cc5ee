"""The live view, headless: what the viewer would show goes into a recording."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from mht_slam.cli.main import main
from mht_slam.errors import MissingExtraError
from mht_slam.plotting import RerunView
from mht_slam.plotting.slam_frames import SlamFrame

LINE = '{{"bearings_deg": [{}, {}, {}]}}\n'


def frame(scan: int, n_loops: int = 0) -> SlamFrame:
    first = max(0, scan - 5)
    poses = np.column_stack([np.arange(first, scan + 1.0), np.zeros((scan - first + 1, 2))])
    points = np.ones((scan, 2))
    return SlamFrame(scan, first, (poses, poses + 0.1), points, points, "tracking", n_loops)


def test_without_rerun_the_error_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'mht-slam\[rerun\]'"):
        RerunView()
    scans = tmp_path / "scans.jsonl"
    scans.write_text(LINE.format(1, 2, 3))
    assert main(["slam", str(scans), "--rerun", "--output", str(tmp_path / "runs")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_frames_become_a_recording(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    path = tmp_path / "run.rrd"
    view = RerunView(path)
    sizes = []
    for scan in range(2, 230):
        view.show(frame(scan, n_loops=scan // 100))
        sizes.append(len(view._settled))
    view.close()
    assert max(sizes) <= 101, "a scan costs the same all along a run"
    content = path.read_bytes()
    for entity in (b"path/0", b"path/2", b"open/best", b"open/alternatives", b"map", b"loops"):
        assert entity in content


def test_the_command_writes_a_recording(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    scans = tmp_path / "scans.jsonl"
    scans.write_text("".join(LINE.format(20 + 3 * k, 60 + 4 * k, -80 - 5 * k) for k in range(5)))
    path = tmp_path / "run.rrd"
    options = ["--rerun-file", str(path), "--output", str(tmp_path / "runs")]
    assert main(["slam", str(scans), *options]) == 0
    assert b"open/best" in path.read_bytes()
