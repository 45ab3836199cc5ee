"""The study of dense runs: its worlds are what they say, and a second call does nothing again."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import shapely

FOLDER = Path(__file__).parents[2] / "benchmarks" / "tracking"
OURS = ("contenders", "dense_runs", "dense_scenes")


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """Other studies have modules of the same names: these are ours for the test alone."""
    monkeypatch.syspath_prepend(str(FOLDER))
    before = {name: sys.modules.pop(name) for name in OURS if name in sys.modules}
    yield importlib.import_module("dense_runs")
    for name in OURS:
        sys.modules.pop(name, None)
    sys.modules.update(before)


def test_every_row_has_its_name_and_its_misses_and_false_alarms(study: ModuleType) -> None:
    settings = list(study.settings())
    assert len({setting.name for setting in settings}) == len(settings) == 60
    for setting in settings[::7]:
        scene = study.scene_of(setting, 0, tuning=False)
        assert len(scene.scans) == 100
        seen = sum(len(scan) for scan in scene.scans)
        false = len(scene.truth.false_alarms)
        assert (seen - false) / (100 * setting.n_landmarks) == pytest.approx(0.95, abs=0.05)
        assert false / (100 * setting.n_landmarks) == pytest.approx(0.03, abs=0.03)
        steps = np.hypot(*np.diff(scene.poses[:, :2], axis=0).T)
        np.testing.assert_allclose(steps, setting.step)


def test_a_yard_surrounds_the_path_and_scattered_landmarks_keep_clear(study: ModuleType) -> None:
    for setting in study.settings():
        scene = study.scene_of(setting, 0, tuning=True)
        path = shapely.LineString(scene.poses[:, :2])
        places = shapely.points(np.concatenate([scene.landmarks, scene.unseen_landmarks]))
        assert shapely.distance(places, path).min() > 0.4
        if setting.world == "yard" and setting.n_landmarks >= 5:
            assert shapely.covers(shapely.convex_hull(shapely.multipoints(places)), path)


def test_a_second_call_does_only_what_is_missing(
    study: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    contender = study.Contender
    field = [contender(method, 8.0, 3) for method in study.BASELINES if method != study.PAPER]
    monkeypatch.setattr(study, "trivial_trackers", lambda: iter(field))
    monkeypatch.setattr(study, "settings", lambda: iter([study.BASE]))
    monkeypatch.setattr(study, "ProcessPoolExecutor", ThreadPoolExecutor)
    arguments = ["--output", str(tmp_path), "--runs", "2"]
    assert study.main(arguments) == 0
    summary = (tmp_path / "summary.md").read_text()
    assert f"| {study.BASE.name} |" in summary
    assert "0 of 1." in summary
    monkeypatch.setattr(study, "answer", lambda job: pytest.fail(f"{job} was done again"))
    assert study.main(arguments) == 0
    assert (tmp_path / "summary.md").read_text() == summary
