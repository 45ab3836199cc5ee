"""Whether stated probabilities come true: reliability curves, calibration errors, proper scores.

A `Forecast` is what one scorer says of one scene. Candidates may leave probability over; that rest
is the probability that the truth is none of them, so a list made to sum to one is held responsible
for every truth it lacks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias, get_args

import numpy as np
import numpy.typing as npt

from mht_slam.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    finite_array,
    finite_number,
    freeze,
    whole_number,
)
from mht_slam.errors import OptionError
from mht_slam.evaluation.metrics import brier_score, log_score

Events: TypeAlias = Literal["top", "all"]
"""What is counted: the most probable candidate of every scene, or all candidates of all scenes."""

N_BINS = 10
"""Bins of equal width over [0, 1]; each holds its lower edge, the last one both."""
N_DRAWS = 400
"""Outcomes drawn to learn what a perfect forecaster of the same probabilities shows."""
LOG_SCORE_FLOOR = 1e-6
"""Probability below which the log score does not look: one scene must not decide a mean."""

_SUM_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Forecast:
    """The probabilities that a scorer gives to the candidates of one scene, and what was true.

    Attributes
    ----------
    probabilities : (n,) in [0, 1], with a sum of at most 1. What is missing to 1 is the probability
        that the truth is not among them. A scorer that failed gives all zeros, or no candidates: it
        states nothing, and whatever was true got probability 0.
    truth : index of the true candidate; None where it is not among them.

    Raises `OptionError` for anything else.
    """

    probabilities: FloatArray
    truth: int | None

    def __init__(self, probabilities: npt.ArrayLike, truth: int | None) -> None:
        p = finite_array(probabilities, "probabilities", OptionError, remedy="give probabilities")
        if p.ndim != 1:
            raise OptionError(f"probabilities has shape {p.shape}: give one per candidate")
        if ((p < 0.0) | (p > 1.0 + _SUM_TOLERANCE)).any() or p.sum() > 1.0 + _SUM_TOLERANCE:
            raise OptionError(
                f"probabilities sum to {p.sum():g}: give values from 0 to 1, with a sum of at most "
                "1 over the candidates of a scene"
            )
        if truth is not None and not 0 <= whole_number(truth, "truth", at_least=0) < len(p):
            raise OptionError(
                f"truth is {truth}: give an index of the {len(p)} candidates, or None"
            )
        object.__setattr__(self, "probabilities", freeze(np.minimum(p, 1.0)))
        object.__setattr__(self, "truth", truth)

    @property
    def rest(self) -> float:
        """Probability that the truth is none of the candidates; 0 where rounding alone is left."""
        total = float(self.probabilities.sum())
        return 1.0 - total if 0.0 < total < 1.0 - _SUM_TOLERANCE else 0.0

    @property
    def top(self) -> int | None:
        """Index of the most probable candidate, the first of equal ones; None without any."""
        return int(self.probabilities.argmax()) if self.probabilities.any() else None


@dataclass(frozen=True)
class ReliabilityCurve:
    """How often events of a stated probability happened, bin by bin.

    Attributes
    ----------
    edges : (b + 1,) of the bins.
    counts : (b,) events in each.
    mean_probability : (b,) stated there on average; nan where a bin is empty.
    rate : (b,) share of its events that happened; nan where a bin is empty.
    """

    edges: FloatArray
    counts: IntArray
    mean_probability: FloatArray
    rate: FloatArray

    @property
    def expected_calibration_error(self) -> float:
        """Mean over events of |rate - mean probability| of their bin.

        ECE = sum_b (count_b / N) |rate_b - mean_probability_b| (Naeini, Cooper and Hauskrecht,
        "Obtaining Well Calibrated Probabilities Using Bayesian Binning", 2015). Biased upwards:
        chance alone makes rates differ. Quote `expected_calibration_error_excess`.
        """
        filled = self.counts > 0
        gaps = np.abs(self.rate[filled] - self.mean_probability[filled])
        return float((self.counts[filled] * gaps).sum() / self.counts.sum())


class CalibrationExcess(NamedTuple):
    """An expected calibration error beside what chance alone would show.

    `excess` is the error minus its mean under perfect calibration, `spread` the standard deviation
    it has there. An excess within two spreads of zero is what a perfect forecaster shows.
    """

    error: float
    of_chance: float
    spread: float

    @property
    def excess(self) -> float:
        """Error beyond that of a perfect forecaster, mean over its draws."""
        return self.error - self.of_chance


class TopForecast(NamedTuple):
    """How sure a scorer is of its first answers, and how often these are right."""

    mean_probability: float
    accuracy: float


def reliability_curve(
    forecasts: Sequence[Forecast], events: Events = "top", n_bins: int = N_BINS
) -> ReliabilityCurve:
    """Compare stated probabilities with how often they came true.

    `events` "top" takes each scene's most probable candidate, one event a scene; a scene without
    candidates states 0 of something that did not happen. "all" takes every candidate of every
    scene; with it most events are hopeless ones in the first bin. Bins are `n_bins` of equal width.

    Raises `OptionError` without events.
    """
    flat = _Flat.of(forecasts, events)
    return _curve(flat.stated, flat.happened(flat.truth), n_bins)


def expected_calibration_error_excess(
    forecasts: Sequence[Forecast],
    events: Events = "top",
    *,
    rng: np.random.Generator,
    n_bins: int = N_BINS,
    n_draws: int = N_DRAWS,
) -> CalibrationExcess:
    """Expected calibration error, and what a perfect forecaster of the same probabilities shows.

    Perfect calibration is simulated `n_draws` times: the truth of every scene is drawn from the
    scene's own probabilities, the rest going to "none of the candidates" (`Forecast.rest`), and the
    same error is taken (resampling for consistency: Broecker and Smith, "Increasing the Reliability
    of Reliability Diagrams", 2007).

    Raises `OptionError` without events.
    """
    whole_number(n_draws, "n_draws", at_least=2)
    flat = _Flat.of(forecasts, events)
    error = _curve(flat.stated, flat.happened(flat.truth), n_bins).expected_calibration_error
    drawn = np.array(
        [
            _curve(flat.stated, flat.happened(flat.draw(rng)), n_bins).expected_calibration_error
            for _ in range(n_draws)
        ]
    )
    return CalibrationExcess(error, float(drawn.mean()), float(drawn.std(ddof=1)))


def top_forecast(forecasts: Sequence[Forecast]) -> TopForecast:
    """Mean top probability against accuracy; a perfect forecaster has them equal, up to chance."""
    flat = _Flat.of(forecasts, "top")
    return TopForecast(float(flat.stated.mean()), float(flat.happened(flat.truth).mean()))


def mean_brier_score(forecasts: Sequence[Forecast]) -> float:
    """Mean over scenes of the multiclass Brier score, in [0, 2], 0 being certainty in the truth.

    sum_i (p_i - [i true])^2 over the candidates and "none of them", whose probability is the rest
    (G. W. Brier, "Verification of forecasts expressed in terms of probability", 1950).
    """
    return _mean([brier_score(*_with_rest(forecast)) for forecast in _some(forecasts)])


def mean_log_score(forecasts: Sequence[Forecast], floor: float = LOG_SCORE_FLOOR) -> float:
    """Mean over scenes of ln(probability of the truth), at most 0, each at least ln(`floor`).

    An unlisted truth has the rest as its probability (I. J. Good, "Rational Decisions", 1952).
    """
    lowest = math.log(finite_number(floor, "floor", above=0.0, at_most=1.0))
    return _mean([max(log_score(*_with_rest(forecast)), lowest) for forecast in _some(forecasts)])


def total_variation(first: npt.ArrayLike, second: npt.ArrayLike) -> float:
    """Half the sum of |p_i - q_i| over the same candidates, and over what both leave to others."""
    p, q = Forecast(first, None), Forecast(second, None)
    if len(p.probabilities) != len(q.probabilities):
        raise OptionError(
            f"first has {len(p.probabilities)} candidates and second {len(q.probabilities)}: "
            "give probabilities of the same ones"
        )
    inside = float(np.abs(p.probabilities - q.probabilities).sum())
    return 0.5 * (inside + abs(p.rest - q.rest))


@dataclass(frozen=True)
class _Flat:
    """All scenes' candidates in one array, and the events counted among them.

    Every scene has one place more than candidates, for "none of them".
    """

    cumulative: FloatArray
    """(P,) cumulative probability within a scene, plus the number of the scene."""
    first: IntArray
    """(S,) where each scene begins."""
    truth: IntArray
    """(S,) place of the truth."""
    places: IntArray
    """(E,) place that each event is about."""
    stated: FloatArray
    """(E,) its probability."""

    @classmethod
    def of(cls, forecasts: Sequence[Forecast], events: Events) -> _Flat:
        if events not in get_args(Events):
            raise OptionError(f"events is {events!r}: give one of {get_args(Events)}")
        sizes = np.array([len(f.probabilities) for f in _some(forecasts)])
        first = np.concatenate([[0], np.cumsum(sizes + 1)[:-1]]).astype(np.int64)
        columns = [_with_rest(f) for f in forecasts]
        probabilities = np.concatenate([p for p, _ in columns])
        cumulative = np.concatenate(
            [scene + np.append(np.cumsum(p)[:-1], 1.0) for scene, (p, _) in enumerate(columns)]
        )
        if events == "top":
            top = [f.top for f in forecasts]
            chosen = np.array([s if t is None else t for t, s in zip(top, sizes, strict=True)])
            places = first + chosen
            stated = np.array(
                [0.0 if t is None else p[t] for t, (p, _) in zip(top, columns, strict=True)]
            )
            # Without candidates the event is one that cannot happen.
            places = np.where([t is None for t in top], -1, places)
        else:
            listed = np.ones(len(probabilities), dtype=np.bool_)
            listed[first + sizes] = False
            places = np.flatnonzero(listed)
            stated = probabilities[places]
            if not len(places):
                raise OptionError("forecasts have no candidates: there is nothing to count")
        truth = first + np.array([index for _, index in columns])
        return cls(cumulative, first, truth, places, stated)

    def happened(self, truth: IntArray) -> BoolArray:
        """(E,) which events are true where each scene's truth is at these places."""
        true = np.zeros(len(self.cumulative) + 1, dtype=np.bool_)  # the last one for place -1
        true[truth] = True
        return true[self.places]

    def draw(self, rng: np.random.Generator) -> IntArray:
        """Draw the place of every scene's truth from the scene's own probabilities, (S,)."""
        wanted = np.arange(len(self.first)) + rng.random(len(self.first))
        drawn = np.searchsorted(self.cumulative, wanted, side="right")
        last = np.append(self.first[1:], len(self.cumulative)) - 1
        return np.asarray(np.minimum(drawn, last), dtype=np.int64)


def _curve(stated: FloatArray, happened: BoolArray, n_bins: int) -> ReliabilityCurve:
    n_bins = whole_number(n_bins, "n_bins", at_least=1)
    bins = np.minimum((stated * n_bins).astype(np.int64), n_bins - 1)
    counts = np.bincount(bins, minlength=n_bins)
    with np.errstate(invalid="ignore"):
        mean = np.bincount(bins, weights=stated, minlength=n_bins) / counts
        rate = np.bincount(bins, weights=happened.astype(np.float64), minlength=n_bins) / counts
    return ReliabilityCurve(np.linspace(0.0, 1.0, n_bins + 1), counts, mean, rate)


def _with_rest(forecast: Forecast) -> tuple[FloatArray, int]:
    """Probabilities with "none of them" as the last candidate, and the truth among those."""
    probabilities = np.append(forecast.probabilities, forecast.rest)
    truth = len(probabilities) - 1 if forecast.truth is None else forecast.truth
    return probabilities, truth


def _some(forecasts: Sequence[Forecast]) -> Sequence[Forecast]:
    if not len(forecasts):
        raise OptionError("forecasts is empty: give one per scene")
    return forecasts


def _mean(figures: list[float]) -> float:
    return math.fsum(figures) / len(figures)
