"""The calibration study goes on where it was, and its scorers weigh the same candidates."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from mht_slam import Association
from mht_slam.measurements import wrap_angle

STUDY = Path(__file__).parents[2] / "benchmarks" / "calibration"
CELL = "model n=3 epsilon=3 prior=5"
N_SCENES = 3


@pytest.fixture
def part_of_study(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """Import a module of the study, as its script does."""
    monkeypatch.syspath_prepend(str(STUDY))
    return import_module


def run_study(output: Path, workers: int = 1) -> str:
    """Score a few scenes; return what was said of the progress."""
    command = [sys.executable, str(STUDY / "calibration.py"), "--cells", CELL]
    command += ["--scenes", str(N_SCENES), "--marginal-scenes", "1"]
    command += ["--output", str(output), "--workers", str(workers)]
    outcome = subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603 - ours
    assert (output / "calibration.png").stat().st_size > 0
    assert f"| {CELL} | {N_SCENES} |" in (output / "summary.md").read_text(encoding="utf-8")
    return outcome.stderr


def test_a_killed_study_goes_on_and_workers_change_nothing(tmp_path: Path) -> None:
    rows = tmp_path / "rows.jsonl"
    assert f"0 of {N_SCENES} scenes are done" in run_study(tmp_path)
    first, second, third = rows.read_text(encoding="utf-8").splitlines(keepends=True)

    # One line as it was, one that other sources scored, and one that a kill cut short.
    code = json.loads(second)["code"]
    rows.write_text(first + second.replace(code, "other") + third[:40], encoding="utf-8")
    assert f"1 of {N_SCENES} scenes are done" in run_study(tmp_path, workers=2)
    again = rows.read_text(encoding="utf-8").splitlines(keepends=True)
    assert again == [first, second.replace(code, "other"), second, third]

    for seed, line in enumerate((first, second, third)):
        row = json.loads(line)
        assert (row["cell"], row["seed"]) == (CELL, seed)
        sizes = {len(said) for said in row["probabilities"].values()}
        assert len(sizes) == 1
        assert row["truth"] is None or row["truth"] < sizes.pop()
        assert ("graph evidence, marginal" in row["probabilities"]) == (seed < 1)
        for said in row["probabilities"].values():
            assert sum(said) == pytest.approx(1.0, abs=1e-6)


def test_polygon_scores_become_shares(part_of_study: Callable[[str], ModuleType]) -> None:
    scores = part_of_study("calibration_scores")
    keep, swap = Association([[0, 0], [1, 1]], (2, 2)), Association([[0, 1], [1, 0]], (2, 2))

    class Listed:
        def __init__(self, association: Association, score: float) -> None:
            self.association, self.score = association, score

    both = [Listed(swap, 0.6), Listed(keep, 0.2)]
    assert scores._polygon_shares([keep, swap], both) == pytest.approx([0.25, 0.75])
    assert scores._polygon_shares([keep, swap], both[1:]) == [1.0, 0.0]
    assert scores._polygon_shares([keep, swap], []) == [0.5, 0.5]
    assert scores._polygon_shares([keep, swap], None) == [0.5, 0.5]


def test_every_cell_has_its_name_and_its_scenes_their_seeds(
    part_of_study: Callable[[str], ModuleType],
) -> None:
    cells = part_of_study("calibration_plan").all_cells()
    assert len({cell.name for cell in cells}) == len(cells)
    for cell in cells[:: len(cells) // 8]:
        one, again, other = cell.simulate(1), cell.simulate(1), cell.simulate(2)
        assert one.scans == again.scans
        assert one.scans != other.scans


def test_scenes_of_a_cell_have_the_noise_it_names(
    part_of_study: Callable[[str], ModuleType],
) -> None:
    module = part_of_study("calibration_cells")
    epsilon = math.radians(5.0)
    bounded = np.concatenate(
        [errors(module.Cell("uniform noise", 4, 5.0).simulate(seed)) for seed in range(60)]
    )
    assert 0.95 * epsilon < np.abs(bounded).max() < epsilon
    gaussian = np.concatenate(
        [errors(module.Cell("model", 4, 5.0).simulate(seed)) for seed in range(60)]
    )
    assert np.abs(gaussian).max() > epsilon
    for sample in (bounded, gaussian):
        assert sample.std() == pytest.approx(epsilon / math.sqrt(3.0), rel=0.1)
    cluttered = [module.Cell("model", 3, 3.0, detections=True).simulate(seed) for seed in range(40)]
    assert any(scene.truth.false_alarms for scene in cluttered)
    assert any(scene.truth.n_missed for scene in cluttered)
    assert {count for scene in cluttered for count in scene.run.n_detections} == {2, 3, 4}


def errors(scene: Any) -> Any:
    """Bearing errors of a scene in which every landmark is seen in every scan."""
    away = scene.landmarks[:, None] - scene.poses[None, :, :2]
    true = np.arctan2(away[..., 1], away[..., 0]) - scene.poses[:, 2]
    seen = [scan.bearings[scene.truth.table[:, k]] for k, scan in enumerate(scene.scans)]
    return wrap_angle(np.column_stack(seen) - true).ravel()
