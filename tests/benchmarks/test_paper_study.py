"""The paper's experiment: scenes and measures are what they say, and claims follow the numbers."""

from __future__ import annotations

import csv
import importlib
import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import mht_slam as ms

FOLDER = Path(__file__).parents[2] / "benchmarks" / "paper"
OURS = (
    "paper_measure",
    "paper_outcome",
    "paper_claims",
    "paper_tables",
    "paper_curves",
    "paper_figures",
    "paper_experiment",
)


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, ModuleType]]:
    """The study's modules, which are no package, for the test alone."""
    monkeypatch.syspath_prepend(str(FOLDER))
    for name in OURS:
        sys.modules.pop(name, None)
    yield {name.removeprefix("paper_"): importlib.import_module(name) for name in OURS}
    for name in OURS:
        sys.modules.pop(name)


def experiment(study: dict[str, ModuleType], track: str = "paper", epsilon_deg: float = 1.0):
    return study["measure"].Experiment(track, epsilon_deg, 0, 0)


def outcome_of(study: dict[str, ModuleType], epsilons: tuple[float, ...], n: int):
    """Made-up rows: O3 four metres off at every epsilon, the others one metre a degree."""
    measure, rows, places = study["measure"], [], []
    for track in measure.TRACKS:
        for epsilon in epsilons:
            for number in range(n):
                label = (track, epsilon, number)
                rows += [
                    measure.Ranked(*label, method, 2, 1, 0.5, 0.2, 9, True)
                    for method in (*measure.POLYGONS, *measure.PRIORS)
                ]
                for method in measure.MAPPED:
                    for hypothesis in (measure.FIRST, measure.TRUE):
                        for item in measure.ITEMS:
                            off = 4.0 if item == "O3" else epsilon
                            off /= 1.0 if track == measure.PAPER else 2.0
                            figures = (off, off**2, off, True)
                            places.append(
                                measure.Located(*label, method, hypothesis, item, *figures)
                            )
    return study["outcome"].Outcome(rows, places)


def verdicts(study: dict[str, ModuleType], outcome) -> dict[str, str]:
    return {claim.statement: claim.verdict for claim in study["claims"].claims(outcome)}


def test_every_track_keeps_the_landmarks_and_its_observation_points_are_as_stated(study) -> None:
    measure = study["measure"]
    for track, along in measure.TRACKS.items():
        scene = measure.experiment_scene(experiment(study, track))
        rows = measure.landmark_rows(scene)
        for name in measure.SEEN:
            x, y = measure.LANDMARKS[name]
            expected = np.array([x - along[0], y]) / measure.METRES_PER_BASELINE
            np.testing.assert_allclose(scene.landmarks[rows[name]], expected)
        steps = np.diff(scene.poses[:, 0]) * measure.METRES_PER_BASELINE
        np.testing.assert_allclose(steps, np.diff(along))
        off_line = scene.poses[2, 1] * measure.METRES_PER_BASELINE
        assert abs(off_line) == (measure.DEVIATION if track == measure.BENT else 0.0)


def test_places_are_measured_in_metres_of_the_base(study) -> None:
    measure = study["measure"]
    scene = measure.experiment_scene(experiment(study))
    places = measure.true_places(scene)
    # |O1 O2| is twelve metres wherever it is seen from.
    assert measure.UNIT * math.dist(places["O1"], places["O2"]) == pytest.approx(12.0)
    assert measure.UNIT * math.dist(places["O2"], places["O3"]) == pytest.approx(4.5)


def test_maps_of_the_truth_hold_it_and_shrink_to_it_with_the_noise(study) -> None:
    measure = study["measure"]
    for epsilon_deg, room in ((0.1, 1.5), (1.0, 10.0)):
        ranked, located = measure.measure(experiment(study, epsilon_deg=epsilon_deg))
        assert {row.method for row in ranked} == {*measure.POLYGONS, *measure.PRIORS}
        assert {row.method for row in located} == set(measure.MAPPED)
        true = [row for row in located if row.hypothesis == measure.TRUE]
        assert len(true) == len(measure.MAPPED) * len(measure.ITEMS)
        for row in true:
            assert 0.0 < row.uncertainty < room
            assert row.error < room
            assert row.area <= math.pi * row.uncertainty**2 * (1.0 + 1e-9)
            assert row.error <= 2.0 * row.uncertainty or row.method == measure.GRAPH
        assert all(row.holds_truth for row in true if row.method == measure.POLYGON)


def test_a_wrong_hypothesis_is_measured_against_the_landmarks_that_o2_names(study) -> None:
    measure = study["measure"]
    made = replace(experiment(study), epsilon_deg=4.0)
    scene = measure.experiment_scene(made)
    ranking = ms.rank(
        scene.run, epsilon=made.epsilon, top_k=None, base=measure.base_detections(scene)
    )
    wrong = ranking[0]
    assert not wrong.association.exact(scene.truth)
    _, located = measure.measure(made)
    first = {(row.hypothesis, row.item): row for row in located if row.method == measure.POLYGON}
    names_ld = int(scene.truth.table[measure.landmark_rows(scene)["Ld"], 1])
    row = wrong.association.table[:, 1].tolist().index(names_ld)
    region = next(
        r for r in wrong.map_in_landmark_frame.landmarks if r.name == f"landmark {row}"
    ).intersection
    centre = np.array(region.centroid.coords[0])
    off = math.dist(centre, measure.true_places(scene)["Ld"])
    assert first[measure.FIRST, "Ld"].error == pytest.approx(measure.UNIT * off)
    assert first[measure.TRUE, "Ld"].holds_truth


def test_claims_follow_the_numbers(study) -> None:
    outcome = outcome_of(study, (1.0, 2.0, 4.0), n=3)
    found = verdicts(study, outcome)
    assert found["The uncertainty of O3 is the largest"] == "holds for 1 deg, 2 deg only"
    assert found["The error of O1, O2 and Ld is small, that of O3 large"] == (
        "holds for 1 deg, 2 deg only"
    )
    assert found["The error grows with epsilon"] == "holds for O1, O2, Ld only"
    assert found["The true hypothesis has the greatest ratio"] == "holds"
    assert found["O3 is uncertain because it is far away"] == "holds"
    assert found["The pair (O1, O3) refines the map"] == "does not hold"

    beaten = [row._replace(truth_rank=2) for row in outcome.ranked]
    assert verdicts(study, replace(outcome, ranked=beaten))[
        "The true hypothesis has the greatest ratio"
    ] == ("does not hold")
    outside = [row._replace(holds_truth=row.item != "O3") for row in outcome.located]
    held = "The regions of the true hypothesis hold the true places in F_L"
    assert verdicts(study, replace(outcome, located=outside))[held] == "does not hold"


def test_a_method_that_says_nothing_is_infinitely_off(study) -> None:
    outcome = outcome_of(study, (1.0,), n=4)
    silent = [
        row._replace(error=math.nan) if row.experiment < 3 else row for row in outcome.located
    ]
    spread = replace(outcome, located=silent).spread("error", study["measure"].POLYGON, "O1", 1.0)
    assert spread.median == math.inf
    assert spread.low == 1.0


def test_where_the_polygons_win_is_read_off_the_rows(study) -> None:
    measure, tables = study["measure"], study["tables"]
    outcome = outcome_of(study, (1.0,), n=8)
    assert list(tables.polygon_wins(outcome)) == ["- nowhere"]
    worse = [
        row._replace(error=row.error + 1.0) if row.method == measure.GRAPH else row
        for row in outcome.located
    ]
    lines = list(tables.polygon_wins(replace(outcome, located=worse)))
    assert len(lines) == 2 * 2 * len(measure.ITEMS)
    assert all("1 deg (8 of 8)" in line for line in lines)
    lost = [
        row._replace(truth_rank=2) if row.method == measure.GRAPH else row for row in outcome.ranked
    ]
    (line,) = tables.polygon_wins(replace(outcome, ranked=lost))
    assert "first in 8 of 8, with the graph in 0" in line


def test_the_study_leaves_rows_summary_and_figures_and_repeats_itself(study, tmp_path) -> None:
    measure = study["measure"]
    arguments = ["--experiments", "1", "--epsilons-deg", "1", "2", "--output"]
    docs_figure = tmp_path / "docs.png"
    assert (
        study["experiment"].main(
            [*arguments, str(tmp_path / "a"), "--docs-figure", str(docs_figure)]
        )
        == 0
    )
    names = {path.name for path in (tmp_path / "a").iterdir()}
    pictures = ("layout", "cells", "hypotheses", "ratios", "landmark_frame", "zones")
    assert names == {
        "ranked.csv",
        "located.csv",
        "summary.md",
        *(f"{name}.png" for name in (*pictures, "uncertainty", "error")),
    }
    assert docs_figure.stat().st_size > 10_000
    with (tmp_path / "a" / "ranked.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * (len(measure.POLYGONS) + len(measure.PRIORS) + len(measure.TRACKS) - 1)
    again = study["experiment"].run((1.0, 2.0), 1, 0)
    study["experiment"].write_rows(tmp_path / "b.csv", measure.Located._fields, again.located)
    assert (tmp_path / "b.csv").read_bytes() == (tmp_path / "a" / "located.csv").read_bytes()
    lines = (tmp_path / "a" / "summary.md").read_text(encoding="utf-8").splitlines()
    tables = [line for line in lines if line.startswith("|")]
    widths = {line.count("|") for line in tables if line.startswith("| The ")}
    assert widths == {5}, "no claim's text breaks the table"
