"""A robot that stands still is seen to, and one that moves is not."""

from __future__ import annotations

import math

import numpy as np
import pytest

import mht_slam as ms
from mht_slam.graph.problem import make_problem
from mht_slam.graph.standstill import standstills

SIGMA = math.radians(0.2)
LANDMARKS = np.array(
    [[4, 3], [6, -2], [9, 4], [3, -4], [12, 1], [-3, 2], [-1, -3], [2, 5], [5, -6]], dtype=float
)
MODEL = ms.ObservationModel(
    sigma=SIGMA,
    motion="smooth",
    stops=True,
    detection_probability=0.95,
    false_alarm_rate=0.02,
    expected_landmarks=5.0,
)


def scans_at(places: list[float], rng: np.random.Generator) -> list[ms.BearingScan]:
    """Shuffled noisy scans of the landmarks from places on the x axis."""
    scans = []
    for x in places:
        bearings = np.arctan2(LANDMARKS[:, 1], LANDMARKS[:, 0] - x)
        noisy = bearings + SIGMA * rng.standard_normal(len(bearings))
        scans.append(ms.BearingScan(rng.permutation(noisy)))
    return scans


@pytest.mark.parametrize("seed", range(5))
def test_standstills_are_the_steps_of_length_zero(seed: int) -> None:
    places = [0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.5]
    scans = scans_at(places, np.random.default_rng(seed))
    still = standstills(scans, [np.full(len(scan), SIGMA) for scan in scans])
    assert still == (True, True, False, False, True, False)


def test_a_robot_that_creeps_away_is_not_still_for_good() -> None:
    places = np.linspace(0.0, 1.0, 40).tolist()
    scans = scans_at(places, np.random.default_rng(1))
    still = standstills(scans, [np.full(len(scan), SIGMA) for scan in scans])
    assert not all(still)


def test_two_detections_alone_never_make_a_standstill() -> None:
    scan = ms.BearingScan([0.1, 0.7])
    assert standstills([scan] * 3, [np.full(2, SIGMA)] * 3) == (False, False)


def test_scans_without_detections_make_no_standstill() -> None:
    assert standstills([ms.BearingScan([])] * 3, [np.empty(0)] * 3) == (False, False)


@pytest.mark.parametrize("n", [10, 15, 30])
def test_many_bearings_make_no_standstill_by_chance(n: int) -> None:
    """Among many, each has a near one from another place."""
    rng = np.random.default_rng(n)
    sigma = math.radians(2.0)
    found = 0
    for _ in range(60):
        landmarks = rng.normal(0.0, 5.0, (n, 2))
        scans = []
        for x in (0.0, 1.0):
            exact = np.arctan2(landmarks[:, 1], landmarks[:, 0] - x)
            scans.append(ms.BearingScan(exact + sigma * rng.standard_normal(n)))
        found += standstills(scans, [np.full(n, sigma)] * 2)[0]
    assert found <= 3


def test_the_second_place_is_where_the_first_step_leads() -> None:
    run = ms.StraightRun(scans_at([0.0, 0.0, 0.5, 1.0, 1.0, 1.5], np.random.default_rng(0)))
    problem = make_problem(run, tuple(range(6)), MODEL)
    assert problem.still == (True, False, False, True, False)
    assert problem.second_place == 2
    assert problem.free_steps == ((2, 3), (4, 5))
    assert problem.part(1, 5).still == (False, False, True)


@pytest.mark.parametrize("places", [[0.0, 0.0, 0.5, 1.0, 1.0, 1.5], [0.0, 0.0, 0.0, 0.0]])
def test_a_run_with_standstills_is_solved(places: list[float]) -> None:
    rng = np.random.default_rng(3)
    run = ms.StraightRun(scans_at(places, rng))
    posterior = ms.solve(run, epsilon=3.0 * SIGMA, model=MODEL).posterior
    best = posterior[0]
    assert best.failure is None
    assert best.association.n_landmarks == len(LANDMARKS)
    x = best.poses[:, 0]
    expected = np.array(places) / 0.5  # in first steps
    assert x == pytest.approx(expected, abs=0.15)


def test_without_leave_to_stop_no_scans_share_a_place() -> None:
    run = ms.StraightRun(scans_at([0.0, 0.0, 0.5], np.random.default_rng(0)))
    model = ms.ObservationModel(sigma=SIGMA, motion="smooth")
    assert make_problem(run, (0, 1, 2), model).still == ()
