"""A checkpoint is whole, or refused in one line; a write that fails leaves the old one."""

from __future__ import annotations

import io
import json
import math
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mht_slam as ms
from mht_slam.errors import CheckpointError
from mht_slam.incremental import checkpoint

from .drives import along_a_row, fed


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("checkpoint") / "slam.npz"
    config = ms.SlamConfig(lag=4, sight=30.0, hypotheses=2, start_hypotheses=2)
    fed(config, along_a_row(7)).save(path)
    return path


def refused(path: Path) -> str:
    with pytest.raises(CheckpointError) as refusal:
        ms.MultiHypothesisSlam.load(path)
    message = str(refusal.value)
    assert "\n" not in message
    assert str(path) in message
    return message


def test_what_was_saved_is_what_is_loaded(saved: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.npz"
    ms.MultiHypothesisSlam.load(saved).save(again)
    assert again.read_bytes() == saved.read_bytes()


@pytest.mark.parametrize("scans", [0, 1, 2, 3])
def test_the_youngest_estimators_are_saved_too(scans: int, tmp_path: Path) -> None:
    """Before the first scan, and while initialising."""
    path, other = tmp_path / "a.npz", tmp_path / "b.npz"
    slam = fed(ms.SlamConfig(), along_a_row(scans))
    slam.save(path)
    loaded = ms.MultiHypothesisSlam.load(path)
    assert loaded.n_scans == scans
    assert loaded.status == slam.status
    fed(slam, along_a_row(8, scans)).save(path)
    fed(loaded, along_a_row(8, scans)).save(other)
    assert path.read_bytes() == other.read_bytes()


def test_a_file_cut_short_is_refused(saved: Path, tmp_path: Path) -> None:
    content, path = saved.read_bytes(), tmp_path / "cut.npz"
    for length in (0, 1, 4, 30, 200, len(content) // 2, len(content) - 30, len(content) - 1):
        path.write_bytes(content[:length])
        refused(path)


def test_a_damaged_file_is_refused_or_the_same(saved: Path, tmp_path: Path) -> None:
    """A byte that nobody reads may change; any other is found by the archive's checksum."""
    content, path = saved.read_bytes(), tmp_path / "damaged.npz"
    rng = np.random.default_rng(0)
    again = tmp_path / "again.npz"
    for _ in range(150):
        damaged = bytearray(content)
        for at in rng.integers(0, len(content), rng.integers(1, 4)):
            damaged[at] ^= int(rng.integers(1, 256))
        path.write_bytes(bytes(damaged))
        try:
            slam = ms.MultiHypothesisSlam.load(path)
        except CheckpointError as refusal:
            assert "\n" not in str(refusal)
        else:
            slam.save(again)
            assert again.read_bytes() == content


def with_entry(saved: Path, path: Path, name: str, value: Any) -> Path:
    """The checkpoint with an entry replaced (or left out: None), and its checksums right."""
    with np.load(saved) as file:
        arrays = {n: file[n] for n in file.files}
    if value is None:
        del arrays[name]
    else:
        arrays[name] = value
    np.savez(path, allow_pickle=False, **arrays)
    return path


def told_of(saved: Path) -> dict[str, Any]:
    with np.load(saved) as file:
        found: dict[str, Any] = json.loads(file[checkpoint.TOLD].tobytes())
    return found


def with_told(saved: Path, path: Path, **changes: Any) -> Path:
    told = told_of(saved) | changes
    told = {name: value for name, value in told.items() if value is not Ellipsis}
    entry = np.frombuffer(json.dumps(told).encode(), np.uint8)
    return with_entry(saved, path, checkpoint.TOLD, entry)


def test_every_entry_is_missed(saved: Path, tmp_path: Path) -> None:
    with np.load(saved) as file:
        names = list(file.files)
    for name in names:
        refused(with_entry(saved, tmp_path / "less.npz", name, None))
    for name in told_of(saved):
        refused(with_told(saved, tmp_path / "less.npz", **{name: ...}))


@pytest.mark.parametrize("version", [0, checkpoint.VERSION - 1, checkpoint.VERSION + 1, "2", None])
def test_another_version_is_named(saved: Path, tmp_path: Path, version: Any) -> None:
    """Older or newer, before anything else of it is read."""
    changes = {"version": version, "config": "of another shape"}
    message = refused(with_told(saved, tmp_path / "other.npz", **changes))
    assert f"version {version} of the checkpoint, this is {checkpoint.VERSION}" in message


@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("tail", [0, 2])
def test_names_that_lead_round_in_a_circle_are_refused(
    saved: Path, tmp_path: Path, n: int, tail: int
) -> None:
    """Whoever followed them would never come back; a chain that ends is taken."""
    chain = [[number, number + 1] for number in range(100, 100 + tail + n)]
    ends = with_told(saved, tmp_path / "ends.npz", renamed=chain)
    assert ms.MultiHypothesisSlam.load(ends)._history.name(100) == 100 + tail + n
    circle = [*chain[:-1], [chain[-1][0], 100 + tail]]
    assert "damaged" in refused(with_told(saved, tmp_path / "circle.npz", renamed=circle))


@pytest.mark.parametrize(
    "changes",
    [
        {"format": "another"},
        {"config": {}},
        {"config": None},
        {"config": {"model": {}}},
        {"n_branches": 99},
        {"n_branches": 0},
        {"n_branches": "x"},
        {"monitor": {"is_found": False}},
        {"monitor": [1]},
        {"renamed": [[1]]},
        {"loops": [[1, 2]]},
        {"moved": "far"},
    ],
    ids=str,
)
def test_a_story_that_makes_no_sense_is_refused(
    saved: Path, tmp_path: Path, changes: dict[str, Any]
) -> None:
    refused(with_told(saved, tmp_path / "odd.npz", **changes))


@pytest.mark.parametrize(
    "name", ["past.mean", "past.covariance", "window.kinds", "branch0.poses", "history.motion"]
)
def test_arrays_of_another_shape_are_refused(saved: Path, tmp_path: Path, name: str) -> None:
    """Machine code reads them without asking how long they are."""
    with np.load(saved) as file:
        array = file[name]
    refused(with_entry(saved, tmp_path / "short.npz", name, array[:-1]))


def test_foreign_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "foreign"
    for content in (b"", b"hello\n", b"PK\x03\x04", b"\x93NUMPY", b'{"scan": 1}', b"\x80\x04."):
        path.write_bytes(content)
        refused(path)
    np.save(tmp_path / "array.npy", np.zeros(3))
    refused(tmp_path / "array.npy")
    np.savez(tmp_path / "arrays.npz", a=np.zeros(3))
    refused(tmp_path / "arrays.npz")
    np.savez(tmp_path / "told.npz", told=np.frombuffer(b"[1, 2]", np.uint8))
    refused(tmp_path / "told.npz")
    with zipfile.ZipFile(tmp_path / "text.zip", "w") as archive:
        archive.writestr("told.npy", "no array")
    refused(tmp_path / "text.zip")
    pickled = io.BytesIO()
    np.save(pickled, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    path.write_bytes(pickled.getvalue())
    refused(path)


def test_a_file_that_is_not_there_is_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        ms.MultiHypothesisSlam.load(tmp_path / "nothing.npz")


class FullDisk(io.BytesIO):
    """Takes a little, and then no more."""

    def write(self, _: Any) -> int:
        raise OSError(28, "No space left on device")


def fail(*_: Any, **__: Any) -> Any:
    raise OSError(5, "Input/output error")


@pytest.mark.parametrize("what", ["open", "write", "fsync", "replace"])
def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(
    saved: Path, tmp_path: Path, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "slam.npz"
    path.write_bytes(saved.read_bytes())
    slam = fed(ms.MultiHypothesisSlam.load(path), along_a_row(8, 7))
    with monkeypatch.context() as patch:
        if what == "open":
            patch.setattr(Path, "open", fail)
        elif what == "write":
            patch.setattr(Path, "open", lambda *_: FullDisk())
        elif what == "fsync":
            patch.setattr(os, "fsync", fail)
        else:
            patch.setattr(Path, "replace", fail)
        with pytest.raises(OSError, match=r"Input|space"):
            slam.save(path)
    assert path.read_bytes() == saved.read_bytes()
    assert [entry.name for entry in tmp_path.iterdir()] == ["slam.npz"]
    slam.save(path)  # and goes on unharmed
    assert ms.MultiHypothesisSlam.load(path).n_scans == 8


def test_every_option_comes_back(tmp_path: Path) -> None:
    config = ms.SlamConfig(
        motion="odometry", hypotheses=3, lag=2, drop=7.5, ranked=1, depth=2, pair_within=3,
        return_probability=0.03, sight=12.0, settled=0.2, active=5, familiar=0.4, loop_odds=7.0,
        loop_scans=9, loop_every=4, remaps=2,
        model=ms.ObservationModel(
            sigma=math.radians(0.3), bearing_dof=5.0, landmark_centre=(1.5, -2.0),
            detection_probability=0.7, false_alarm_rate=0.2, expected_landmarks=3.0,
            field_of_view=2.0,
        ),
    )  # fmt: skip
    path = tmp_path / "slam.npz"
    ms.MultiHypothesisSlam(config).save(path)
    assert ms.MultiHypothesisSlam.load(path).config == config
