"""Labels bind the ranking, options mean what they say, and what makes no sense is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mht_slam.association import MISSED, respects_labels
from mht_slam.errors import MeasurementError, OptionError, TooFewLandmarksError, UnequalScansError
from mht_slam.measurements import BearingScan, RunPair, StraightRun
from mht_slam.polygon.ranking import rank

from .conftest import (
    EPSILON,
    as_pair,
    as_run,
    assert_same_scores,
    easy_run,
    pair_bearings,
    scores_of,
    straight_bearings,
)

# --- labels ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "labels",
    [
        ((None, "a", None), (None, "a", None), (None, None, None)),
        (("a", None, None), (None, None, None), ("a", None, "b")),
        (("a", "b", "c"), ("a", "b", "c"), ("a", "b", "c")),
        (("a", None, None), ("b", None, None), (None, None, None)),
    ],
)
@pytest.mark.parametrize("budget", [0, 1])
def test_labels_are_hard_constraints(labels: Any, budget: int) -> None:
    bearings = straight_bearings(5, 3)
    free, run = (
        as_run(bearings),
        StraightRun(
            BearingScan(b, labels=names) for b, names in zip(bearings, labels, strict=True)
        ),
    )
    options: dict[str, Any] = {"include_zero": True, "max_missed": 2 * budget, "max_false": budget}
    expected = {
        a: s for a, s in scores_of(free, **options).items() if respects_labels(a, run.scans)
    }
    found = scores_of(run, **options)
    assert found.keys() == expected.keys()
    assert_same_scores(found, expected)


def test_labels_are_hard_constraints_between_two_runs() -> None:
    bearings = pair_bearings(5, 3)
    labels = (("a", None, None), (None, None, None), (None, None, "b"), (None, "a", None))
    scans = [BearingScan(b, labels=names) for b, names in zip(bearings, labels, strict=True)]
    expected = [
        a for a in scores_of(as_pair(bearings), include_zero=True) if respects_labels(a, scans)
    ]
    assert scores_of(RunPair(scans[:2], scans[2:]), include_zero=True).keys() == set(expected)


# --- options --------------------------------------------------------------------------------------


def test_a_given_base_is_kept_in_its_order() -> None:
    ranking = rank(easy_run(), epsilon=EPSILON, base=(2, 0))
    assert ranking.base == (2, 0)
    best = ranking[0]
    assert best.base == (2, 0)
    rows = best.map_in_landmark_frame.base
    assert best.association.table[list(rows), 1].tolist() == [2, 0]


def test_a_given_base_that_is_not_fully_seen_scores_zero() -> None:
    ranking = rank(
        easy_run(),
        epsilon=EPSILON,
        top_k=None,
        include_zero=True,
        base=(0, 1),
        max_missed=1,
        max_false=2,
    )
    for h in ranking:
        full = h.association.table[(h.association.table != MISSED).all(axis=1)]
        if len(full) >= 3 and not {0, 1} <= set(full[:, 1].tolist()):
            assert h.score == 0.0
            assert h.zero_reason == "a base landmark is not seen in every scan"
            assert h.map_in_landmark_frame is None


@pytest.mark.parametrize(
    "options",
    [
        {"epsilon": 0.0},
        {"epsilon": np.pi / 2.0},
        {"epsilon": np.nan},
        {"top_k": 0},
        {"work_limit": 0},
        {"method": "fast"},
        {"ratio": "dice"},
        {"region": "arcs"},
        {"base": (0, 9)},
        {"max_range": 0.0},
        {"max_missed": -1},
        {"max_false": 1.5},
        {"refine_pair": (0, 1)},
    ],
)
def test_options_that_make_no_sense_are_refused_by_name(options: dict[str, Any]) -> None:
    name = next(iter(options))
    with pytest.raises(OptionError, match=name):
        rank(easy_run(), **({"epsilon": EPSILON} | options))


def test_a_pair_of_runs_takes_neither_scans_nor_a_refining_pair() -> None:
    pair = as_pair(pair_bearings(0, 3))
    with pytest.raises(OptionError, match="scans"):
        rank(pair, epsilon=EPSILON, scans=(0, 1, 3))
    with pytest.raises(OptionError, match="refine_pair"):
        rank(pair, epsilon=EPSILON, refine_pair=(0, 2))


def test_scans_that_do_not_exist_and_other_runs_are_refused() -> None:
    with pytest.raises(MeasurementError, match="scan 3"):
        rank(easy_run(), epsilon=EPSILON, scans=(0, 1, 3))
    with pytest.raises(OptionError, match="StraightRun"):
        rank([1, 2, 3], epsilon=EPSILON)  # type: ignore[arg-type]


def test_too_few_landmarks_and_unequal_scans_are_told_apart() -> None:
    with pytest.raises(TooFewLandmarksError):
        rank(easy_run(2), epsilon=EPSILON)
    bearings = [scan.bearings for scan in easy_run().scans]
    unequal = as_run([bearings[0], bearings[1], bearings[2][:3]])
    with pytest.raises(UnequalScansError, match="max_missed"):
        rank(unequal, epsilon=EPSILON)
    assert len(rank(unequal, epsilon=EPSILON, max_missed=1))
    with pytest.raises(TooFewLandmarksError):
        rank(as_run([bearings[0], bearings[1], bearings[2][:2]]), epsilon=EPSILON, max_missed=2)


def test_an_enumeration_that_would_not_end_is_refused_with_its_size() -> None:
    bearings = np.linspace(0.3, 2.8, 9)
    with pytest.raises(OptionError, match="131,681,894,400"):
        rank(as_run([bearings] * 3), epsilon=EPSILON, method="exhaustive")


def test_an_empty_ranking_is_legal() -> None:
    crossing = as_run([np.array([2.5, 2.6, 2.7]), np.array([0.5, 0.6, 0.7]), np.ones(3)])
    for method, n_scored in (("exact", 0), ("exhaustive", 36)):
        ranking = rank(crossing, epsilon=0.01, method=method)
        assert len(ranking) == 0
        assert ranking.complete
        assert ranking.n_scored == n_scored


def test_progress_reaches_its_total() -> None:
    calls: list[tuple[int, int]] = []
    rank(
        easy_run(),
        epsilon=EPSILON,
        top_k=None,
        max_false=3,
        progress=lambda done, total: calls.append((done, total)),
    )
    assert calls[-1][0] == calls[-1][1]
    assert [done for done, _ in calls] == sorted(done for done, _ in calls)


def test_hundreds_of_detections_are_refused_before_any_work():
    run = StraightRun([BearingScan(np.linspace(-3.0, 3.0, 500))] * 3)
    with pytest.raises(OptionError, match="at most 100 a scan"):
        rank(run, epsilon=0.05)


def test_a_count_too_long_to_read_is_not_spelled_out():
    run = StraightRun([BearingScan(np.linspace(-3.0, 3.0, 40))] * 3)
    with pytest.raises(OptionError, match=r"through 10\^18 hypotheses or more"):
        rank(run, epsilon=0.05, method="exhaustive")


def test_labels_do_not_let_through_what_memory_cannot_hold(monkeypatch):
    monkeypatch.setattr("mht_slam.polygon.tables.MAX_RATIOS", 0)
    landmarks = np.array([[1.0, 3.0], [2.0, -2.0], [3.5, 1.5]])
    run = StraightRun(
        BearingScan(np.arctan2(landmarks[:, 1], landmarks[:, 0] - x), labels=["a", "b", "c"])
        for x in (0.0, 1.0, 2.2)
    )
    monkeypatch.setattr("mht_slam.polygon.base_regions.MAX_SLOTS", 0)
    with pytest.raises(OptionError, match="rank fewer detections"):
        rank(run, epsilon=0.05, method="exact")
    with pytest.raises(OptionError, match="rank fewer detections"):
        rank(run, epsilon=0.05, method="exhaustive")


def test_a_max_range_that_geometry_cannot_take_is_refused():
    run = StraightRun([BearingScan([0.4, 1.0, 2.0])] * 3)
    with pytest.raises(OptionError, match="at most 1e\\+06"):
        rank(run, epsilon=0.05, max_range=1e300)


def test_a_limit_beyond_every_machine_is_no_limit() -> None:
    run = easy_run()
    assert rank(run, epsilon=EPSILON, work_limit=2**70).complete
