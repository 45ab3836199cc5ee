"""Calibration figures agree with their definitions, and tell perfect forecasters from others."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.arrays import FloatArray
from mht_slam.errors import OptionError
from mht_slam.evaluation.calibration import (
    Events,
    Forecast,
    expected_calibration_error_excess,
    mean_brier_score,
    mean_log_score,
    reliability_curve,
    top_forecast,
    total_variation,
)

N_SCENES = 2000


@st.composite
def forecasts(draw: st.DrawFn) -> Forecast:
    """A scene of up to five candidates; they need not take all the probability."""
    weights = draw(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=5))
    taken = draw(st.floats(0.0, 1.0))
    total = sum(weights)
    p = [taken * w / total if total > 0.0 else 0.0 for w in weights]
    return Forecast(p, draw(st.one_of(st.none(), st.integers(0, len(p) - 1))))


LISTS = st.lists(forecasts(), min_size=1, max_size=12)


def slow_events(scenes: list[Forecast], events: Events) -> list[tuple[float, bool]]:
    pairs = []
    for scene in scenes:
        p = scene.probabilities.tolist()
        if events == "all":
            pairs += [(p[i], scene.truth == i) for i in range(len(p))]
        elif max(p, default=0.0) > 0.0:
            pairs.append((max(p), scene.truth == p.index(max(p))))
        else:
            pairs.append((0.0, False))
    return pairs


def slow_error(pairs: list[tuple[float, bool]], n_bins: int) -> float:
    error = 0.0
    for b in range(n_bins):
        low, high = b / n_bins, (b + 1) / n_bins
        inside = [(p, y) for p, y in pairs if int(p * n_bins) == b or (p == 1.0 and high == 1.0)]
        assert all(low - 1e-12 <= p <= high + 1e-12 for p, _ in inside)
        if inside:
            rate = sum(y for _, y in inside) / len(inside)
            error += len(inside) / len(pairs) * abs(rate - sum(p for p, _ in inside) / len(inside))
    return error


def simulated(
    rng: np.random.Generator, *, sharpness: float = 1.0, listed: float = 1.0
) -> list[Forecast]:
    """Scenes whose truth is drawn from probabilities p, stated as p^sharpness, normalised.

    The candidates together have the probability `listed`, and say so.
    """
    scenes = []
    for _ in range(N_SCENES):
        p: FloatArray = listed * rng.dirichlet([0.5] * 5)
        drawn = int(rng.choice(6, p=np.append(p, max(1.0 - p.sum(), 0.0))))
        stated = listed * p**sharpness / (p**sharpness).sum()
        scenes.append(Forecast(stated, drawn if drawn < 5 else None))
    return scenes


@given(LISTS, st.sampled_from(["top", "all"]), st.integers(1, 12))
def test_the_calibration_error_is_its_definition(
    scenes: list[Forecast], events: Events, n_bins: int
) -> None:
    curve = reliability_curve(scenes, events, n_bins)
    pairs = slow_events(scenes, events)
    assert curve.counts.sum() == len(pairs)
    assert curve.expected_calibration_error == pytest.approx(slow_error(pairs, n_bins), abs=1e-12)


@given(LISTS)
def test_scores_are_those_of_a_list_that_names_the_rest(scenes: list[Forecast]) -> None:
    brier, log = [], []
    for scene in scenes:
        p = scene.probabilities.tolist()
        rest = 1.0 - sum(p) if any(p) else 0.0
        of_truth = rest if scene.truth is None else p[scene.truth]
        indicator = [float(scene.truth == i) for i in range(len(p))]
        brier.append(
            sum((a - b) ** 2 for a, b in zip(p, indicator, strict=True))
            + (rest - float(scene.truth is None)) ** 2
        )
        log.append(math.log(max(of_truth, 1e-3)))
    assert mean_brier_score(scenes) == pytest.approx(sum(brier) / len(brier), abs=1e-5)
    assert mean_log_score(scenes, floor=1e-3) == pytest.approx(sum(log) / len(log), abs=1e-2)


@given(LISTS)
def test_one_bin_compares_mean_top_probability_with_accuracy(scenes: list[Forecast]) -> None:
    top = top_forecast(scenes)
    error = reliability_curve(scenes, "top", n_bins=1).expected_calibration_error
    assert error == pytest.approx(abs(top.mean_probability - top.accuracy), abs=1e-12)


@pytest.mark.parametrize("events", ["top", "all"])
@pytest.mark.parametrize("listed", [1.0, 0.8])
@pytest.mark.parametrize("seed", range(3))
def test_a_perfect_forecaster_has_no_excess(events: Events, listed: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    excess = expected_calibration_error_excess(simulated(rng, listed=listed), events, rng=rng)
    assert abs(excess.excess) < 3.5 * excess.spread
    assert excess.of_chance > 0.0


@pytest.mark.parametrize("events", ["top", "all"])
@pytest.mark.parametrize("sharpness", [3.0, 0.3])
def test_an_overconfident_and_a_timid_forecaster_have_excess(
    events: Events, sharpness: float
) -> None:
    rng = np.random.default_rng(5)
    scenes = simulated(rng, sharpness=sharpness)
    excess = expected_calibration_error_excess(scenes, events, rng=rng)
    assert excess.excess > 6.0 * excess.spread
    top = top_forecast(scenes)
    assert (top.mean_probability > top.accuracy) == (sharpness > 1.0)


def test_lists_that_deny_unlisted_truths_are_overconfident() -> None:
    rng = np.random.default_rng(6)
    honest = simulated(rng, listed=0.8)
    denying = [Forecast(f.probabilities / f.probabilities.sum(), f.truth) for f in honest]
    excess = expected_calibration_error_excess(denying, rng=rng)
    assert excess.excess > 6.0 * excess.spread
    assert mean_log_score(denying) < mean_log_score(honest)


def test_the_error_of_chance_is_that_of_drawn_truths() -> None:
    rng = np.random.default_rng(7)
    scenes = simulated(rng)[:100]
    drawn = []
    for _ in range(300):
        again = [Forecast(f.probabilities, int(rng.choice(5, p=f.probabilities))) for f in scenes]
        drawn.append(reliability_curve(again, "top").expected_calibration_error)
    excess = expected_calibration_error_excess(scenes, "top", rng=rng, n_draws=300)
    standard_error = float(np.std(drawn)) / math.sqrt(150.0)
    assert abs(float(np.mean(drawn)) - excess.of_chance) < 4.0 * standard_error
    assert excess.spread == pytest.approx(float(np.std(drawn)), rel=0.25)


def test_a_scorer_that_failed_states_nothing_and_is_wrong() -> None:
    failed = [Forecast([], None), Forecast([0.0, 0.0], 1)]
    assert top_forecast(failed) == (0.0, 0.0)
    assert reliability_curve(failed, "top").counts[0] == 2
    assert mean_brier_score(failed) == 1.0
    assert mean_log_score(failed, floor=0.01) == pytest.approx(math.log(0.01))
    right = [*failed, Forecast([1.0], 0)]
    assert top_forecast(right) == pytest.approx((1 / 3, 1 / 3))


@given(st.lists(st.floats(0.0, 1.0), min_size=2, max_size=6), st.data())
def test_total_variation_is_the_largest_difference_of_any_event(
    weights: list[float], data: st.DataObject
) -> None:
    total = sum(weights) + 1.0
    p = [w / total for w in weights]
    q = data.draw(st.permutations(p))
    rest_p, rest_q = 1.0 - sum(p), 1.0 - sum(q)
    largest = sum(max(a - b, 0.0) for a, b in zip([*p, rest_p], [*q, rest_q], strict=True))
    assert total_variation(p, q) == pytest.approx(largest, abs=1e-9)


def test_what_is_no_forecast_is_refused() -> None:
    for p, truth in (([0.7, 0.7], 0), ([-0.1, 0.5], 0), ([0.5], 1), ([[0.5]], None)):
        with pytest.raises(OptionError):
            Forecast(p, truth)
    with pytest.raises(OptionError, match="empty"):
        top_forecast([])
    with pytest.raises(OptionError, match="nothing to count"):
        reliability_curve([Forecast([], None)], "all")
    with pytest.raises(OptionError, match="events"):
        reliability_curve([Forecast([1.0], 0)], "best")  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="same ones"):
        total_variation([1.0], [0.5, 0.5])
