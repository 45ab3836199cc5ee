"""A sweep is a list of independent scenes, each with randomness of its own."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.errors import OptionError
from mht_slam.evaluation.baselines import order_changes
from mht_slam.evaluation.bench.case import Case
from mht_slam.evaluation.bench.sweep import Cell, Sweep

EPSILON = math.radians(3.0)


def bits(case: Case) -> tuple[bytes, ...]:
    return (*(scan.bearings.tobytes() for scan in case.run.scans), case.truth.table.tobytes())


def test_more_cells_and_more_scenes_change_none_of_the_others() -> None:
    few = Sweep(kinds=("annulus",), landmarks=(4,), epsilons=(EPSILON,), scenes=2)
    many = Sweep(
        kinds=("corridor", "annulus", "model"),
        landmarks=(3, 4, 5),
        epsilons=(0.01, EPSILON),
        heading_sigmas=(0.0, 0.02),
        scenes=5,
    )
    drawn = {(cell.key, scene): bits(cell.case(scene)) for cell, scene in many.jobs[::3]}
    drawn |= {job_key(job): bits(job[0].case(job[1])) for job in few.jobs}
    for cell, scene in few.jobs:
        assert (cell, scene) in many.jobs
        assert bits(cell.case(scene)) == drawn[(cell.key, scene)]


def job_key(job: tuple[Cell, int]) -> tuple[str, int]:
    return job[0].key, job[1]


def test_scenes_cells_and_seeds_have_different_randomness() -> None:
    cell = Sweep(kinds=("annulus",), landmarks=(3,), epsilons=(EPSILON,)).cells[0]
    others = [replace(cell, seed=1), replace(cell, epsilon=0.05), replace(cell, n_scans=4)]
    drawn = [bits(cell.case(scene)) for scene in range(4)] + [bits(o.case(0)) for o in others]
    assert len({d[0] for d in drawn}) == len(drawn)


@settings(max_examples=20, deadline=None)
@given(
    kind=st.sampled_from(["annulus", "one_sided", "corridor", "clusters", "model"]),
    n=st.integers(3, 6),
    scans=st.integers(3, 5),
    step=st.sampled_from([None, 0.5, 2.0]),
    scene=st.integers(0, 10**6),
)
def test_a_case_is_what_its_cell_says_and_comes_out_the_same_twice(
    kind: str, n: int, scans: int, step: float | None, scene: int
) -> None:
    sweep = Sweep(
        kinds=(kind,),  # type: ignore[arg-type]
        landmarks=(n,),
        noises=("uniform",),
        epsilons=(EPSILON,),
        n_scans=(scans,),
        steps=(step,),
    )
    (cell,) = sweep.cells
    case = cell.case(scene)
    assert case.truth.is_full
    assert case.run.n_detections == (n,) * scans
    if step is not None:
        assert np.allclose(np.diff(case.poses[1:, 0]), step)
    assert bits(pickle.loads(pickle.dumps(cell)).case(scene)) == bits(case)  # noqa: S301 - ours
    assert isinstance(order_changes(case.run, case.truth), bool)


def test_uniform_noise_stays_inside_epsilon_and_gaussian_noise_is_not_clipped() -> None:
    def errors(noise: str) -> list[float]:
        sweep = Sweep(
            kinds=("annulus",), landmarks=(5,), noises=(noise,), epsilons=(EPSILON,), coverage=2.0,
        )  # type: ignore[arg-type]  # fmt: skip
        (cell,) = sweep.cells
        found = []
        for scene in range(30):
            case = cell.case(scene)
            for scan, pose, column in zip(
                case.run.scans, case.poses, case.truth.table.T, strict=True
            ):
                away = case.landmarks - pose[:2]
                residual = scan.bearings[column] - np.arctan2(away[:, 1], away[:, 0])
                found += np.abs(np.angle(np.exp(1j * residual))).tolist()
        return found

    assert max(errors("uniform")) < EPSILON
    gaussian = np.array(errors("gaussian"))
    assert (gaussian > EPSILON).any()
    assert np.sqrt((gaussian**2).mean()) == pytest.approx(EPSILON / 2.0, rel=0.15)


def test_sigma_and_epsilon_are_two_ways_to_say_the_same() -> None:
    options = {"kinds": ("annulus",), "landmarks": (3,), "noises": ("gaussian",)}
    by_sigma = Sweep(sigmas=(0.01,), coverage=4.0, **options).cells[0]  # type: ignore[arg-type]
    by_epsilon = Sweep(epsilons=(0.04,), coverage=4.0, **options).cells[0]  # type: ignore[arg-type]
    assert (by_sigma.epsilon, by_sigma.sigma) == pytest.approx((by_epsilon.epsilon, 0.01))


def test_scenes_of_kind_model_come_once_whatever_the_noise() -> None:
    sweep = Sweep(kinds=("model",), landmarks=(3,), epsilons=(EPSILON,))
    assert [cell.noise for cell in sweep.cells] == ["gaussian"]


def test_misses_and_clutter_are_in_the_scans_and_in_the_model() -> None:
    (cell,) = Sweep(
        kinds=("annulus",), landmarks=(4,), noises=("gaussian",), epsilons=(EPSILON,),
        detection_probabilities=(0.8,), false_alarms=(0.5,),
    ).cells  # fmt: skip
    cases = [cell.case(scene) for scene in range(20)]
    assert any(case.truth.n_missed for case in cases)
    assert any(case.truth.false_alarms for case in cases)
    assert all(3 <= count <= 6 for case in cases for count in case.run.n_detections)
    assert all(case.assumptions.model.compares_sizes for case in cases)


def test_where_no_scene_has_enough_detections_the_cell_says_so() -> None:
    (cell,) = Sweep(
        kinds=("annulus",), landmarks=(3,), noises=("gaussian",), epsilons=(EPSILON,),
        detection_probabilities=(0.01,),
    ).cells  # fmt: skip
    with pytest.raises(OptionError, match="none of 1000 scenes"):
        cell.case(0)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"kinds": ("ring",)}, "kinds"),
        ({"kinds": ()}, "no cell"),
        ({"landmarks": (2,)}, "landmarks"),
        ({"epsilons": (0.1,), "sigmas": (0.1,)}, "give one"),
        ({"epsilons": (2.0,)}, "epsilons"),
        ({"sigmas": (1.0,)}, "coverage"),
        ({"scenes": 0}, "scenes"),
        ({"n_scans": (2,)}, "n_scans"),
        ({"steps": (0.0,)}, "steps"),
        ({"detection_probabilities": (0.0,)}, "detection_probabilities"),
    ],
)
def test_settings_that_make_no_sense_are_refused_by_name(
    options: dict[str, object], word: str
) -> None:
    with pytest.raises(OptionError, match=word):
        Sweep(**options)  # type: ignore[arg-type]
