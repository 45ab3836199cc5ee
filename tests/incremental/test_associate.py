"""Children of a hypothesis against all matchings, written out one by one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations, permutations

import numpy as np
import pytest

import mht_slam as ms
from mht_slam.incremental import associate
from mht_slam.incremental.associate import Option, Prediction, Weights
from mht_slam.incremental.branch import Branch
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.steps import next_step, propose
from mht_slam.matchings import Matches

LANDMARKS = np.array([[3.0, 2.0], [4.0, -2.5], [6.0, 3.5]])
EVERYTHING = {"ranked": 10_000, "depth": 100_000, "drop": 1e6}


def scan_at(x: float, wanted: tuple[int, ...], rng: np.random.Generator) -> ms.BearingScan:
    away = LANDMARKS[list(wanted)] - [x, 0.0]
    bearings = np.arctan2(away[:, 1], away[:, 0]) + 0.01 * rng.normal(size=len(away))
    return ms.BearingScan(rng.permutation([*bearings, *rng.uniform(-3, 3, rng.integers(0, 2))]))


def predictions_of(
    config: SlamConfig, scans: list[ms.BearingScan]
) -> tuple[ms.MultiHypothesisSlam, list[Prediction]]:
    """What an estimator predicts of the last scan; it has taken in all of them."""
    slam = ms.MultiHypothesisSlam(config)
    for scan in scans[:-1]:
        slam.update(scan)
    branches: tuple[Branch, ...] = slam._branches
    slam.update(scans[-1])
    model = config.observation_model
    step = next_step(model, scans[-1], len(scans) - 1, False, None)
    weights = Weights.of(config)
    return slam, [
        associate.predict(branch, slam._window, propose(step, branch.poses), config, weights)
        for branch in branches
    ]


def tiny_run(seed: int, n: int = 4) -> list[ms.BearingScan]:
    rng = np.random.default_rng(seed)
    return [
        scan_at(0.9 * k, ((0, 1), (0, 1, 2), (1, 2), (0, 2))[(k + seed) % 4], rng) for k in range(n)
    ]


def all_matchings(rows: int, columns: int) -> Iterator[Matches]:
    for size in range(min(rows, columns) + 1):
        for chosen in combinations(range(rows), size):
            for order in permutations(range(columns), size):
                yield tuple(zip(chosen, order, strict=True))


def exhaustive(prediction: Prediction) -> dict[Matches, float]:
    """Every matching of positive gains, with its best score over all proposals."""
    found: dict[Matches, float] = {}
    for g in range(len(prediction.offsets)):
        table = prediction.table[g]
        for matches in all_matchings(*table.shape):
            gains = [float(table[pair]) for pair in matches]
            if all(gain > 0.0 for gain in gains):
                score = float(prediction.offsets[g]) + sum(gains)
                found[matches] = max(score, found.get(matches, -math.inf))
    return found


def scores(options: list[Option]) -> dict[Matches, float]:
    return {option.matches: option.log_score for option in options}


@pytest.mark.parametrize("seed", range(6))
def test_with_every_effort_the_children_are_all_matchings(seed: int) -> None:
    config = SlamConfig(**EVERYTHING)
    _, predictions = predictions_of(SlamConfig(start_hypotheses=2), tiny_run(seed))
    for prediction in predictions:
        options = associate.best_options([prediction], config, 10**6)
        expected = exhaustive(prediction)
        assert len(scores(options)) == len(options), "a child twice"
        assert scores(options).keys() == expected.keys()
        for matches, score in scores(options).items():
            assert score == pytest.approx(expected[matches], abs=1e-9)
        order = [option.log_score for option in options]
        assert order == sorted(order, reverse=True)


@pytest.mark.parametrize("seed", range(6))
def test_with_ordinary_effort_the_best_child_is_the_best_of_all_matchings(seed: int) -> None:
    config = SlamConfig(start_hypotheses=5)
    _, predictions = predictions_of(config, tiny_run(seed))
    options = associate.best_options(predictions, config, 20)
    expected = [exhaustive(prediction) for prediction in predictions]
    best = max(max(scores.values()) for scores in expected)
    assert options[0].log_score == pytest.approx(best, abs=1e-9)
    assert all(option.log_score >= best - config.drop for option in options)
    seen = set()
    for option in options:
        i = next(i for i, p in enumerate(predictions) if p is option.prediction)
        assert (i, option.matches) not in seen, "a child twice"
        seen.add((i, option.matches))
        # One found at a proposal that is not its best counts less, never more.
        assert option.log_score <= expected[i][option.matches] + 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_a_child_has_the_detections_that_its_matches_name(seed: int) -> None:
    config = SlamConfig(start_hypotheses=5)
    slam, predictions = predictions_of(config, tiny_run(seed))
    weights = Weights.of(config)
    for option in associate.best_options(predictions, config, 20)[:10]:
        branch = associate.child(option, slam._window, config, weights)
        parent = option.prediction.branch
        newest = branch.owners[-1]
        assert len(newest) == len(slam._window.bearings[-1])
        matched = {d for _, d in option.matches}
        assert {d for d, owner in enumerate(newest.tolist()) if owner != -1} == matched
        for row, d in option.matches:
            if row < len(parent.ids):
                assert newest[d] == parent.ids[row]
            else:
                scan, earlier = option.prediction.singles[row - len(parent.ids)]
                assert parent.owners[scan][earlier] == -1
                assert branch.owners[scan][earlier] == newest[d]
        owners = np.concatenate(branch.owners)
        assert len(branch.sightings) == (owners != -1).sum()
        for (pose, landmark), bearing in zip(
            branch.sightings.tolist(), branch.bearings.tolist(), strict=True
        ):
            scan = pose - 2
            d = branch.owners[scan].tolist().index(branch.ids[landmark])
            assert slam._window.bearings[scan][d] == bearing


def log_pattern(branch: Branch, config: SlamConfig) -> float:
    """The weight of seen, missed and alone over all scans from the first, by a forward filter."""
    model, weights = config.observation_model, Weights.of(config)
    chance, stay = model.detection_probability, model.stay_probability
    back = config.return_probability
    assert chance is not None
    total = -len(branch.owners[0]) * weights.alone(0)  # the first scan is the same for all
    for scan, owner in enumerate(branch.owners):
        total += int((owner == -1).sum()) * weights.alone(scan)
    for number in branch.ids.tolist():
        seen = [number in owner.tolist() for owner in branch.owners]
        first = seen.index(True)
        total += weights.landmark(first)
        here, gone = 1.0, 0.0  # in view or not, given all so far, not normalised
        for hit in seen[first + 1 :]:
            here, gone = stay * here + back * gone, (1.0 - stay) * here + (1.0 - back) * gone
            here, gone = (here * chance, 0.0) if hit else (here * (1.0 - chance), gone)
        total += math.log(here + gone)
    return total


@pytest.mark.parametrize("seed", range(6))
def test_the_weight_of_a_pattern_is_that_of_a_filter_from_scan_to_scan(seed: int) -> None:
    """Seen, missed and left alone, whatever the order in which a child came to it."""
    config = SlamConfig(start_hypotheses=30)
    slam = ms.MultiHypothesisSlam(config)
    for scan in tiny_run(seed, 7):
        slam.update(scan)
        for branch in slam._branches:
            assert branch.log_pattern == pytest.approx(log_pattern(branch, config), abs=1e-9)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("count", [0, 1, 5])
def test_a_scan_may_always_say_nothing(seed: int, count: int) -> None:
    config = SlamConfig(start_hypotheses=5)
    rng = np.random.default_rng(seed)
    scans = [*tiny_run(seed), ms.BearingScan(rng.uniform(-3, 3, count))]
    slam, predictions = predictions_of(config, scans)
    for prediction in predictions:
        option = associate.nothing_matched(prediction)
        branch = associate.child(option, slam._window, config, Weights.of(config))
        assert (branch.owners[-1] == -1).all()
        assert slam._solved(branch) is not None
        assert option.log_score == pytest.approx(prediction.offsets.max())


def test_what_is_out_of_view_is_not_missed() -> None:
    """A landmark behind a camera that looks ahead keeps the weight it has."""
    config = SlamConfig(model=ms.ObservationModel(
        sigma=0.01, motion="smooth", detection_probability=0.9, false_alarm_rate=0.01,
        expected_landmarks=5.0, field_of_view=math.radians(120.0), stay_probability=1.0,
    ))  # fmt: skip
    landmarks = np.array([[2.5, 1.0], [9.0, 2.0], [8.0, -3.0], [10.0, 0.5]])
    slam = ms.MultiHypothesisSlam(config)
    for k in range(8):
        away = landmarks - [0.7 * k, 0.0]
        bearings = np.arctan2(away[:, 1], away[:, 0])
        slam.update(ms.BearingScan(bearings[np.abs(bearings) < math.radians(60.0)]))
    weights = Weights.of(config)
    assert config.model.detection_probability is not None
    hits = sum(len(bearings) for bearings in slam._window.bearings) - len(landmarks)
    assert slam.association.false_alarms == ()
    expected = len(landmarks) * (weights.landmark(0) - weights.alone(0)) + hits * math.log(0.9)
    assert slam._branches[0].log_pattern == pytest.approx(expected, abs=1e-9)
