"""What one method's answers on one case are worth: a verdict, failures included."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import kendalltau

from mht_slam.association import MISSED, Association
from mht_slam.errors import OptionError
from mht_slam.evaluation.bench.case import Case
from mht_slam.evaluation.bench.methods import Answers

NOTHING = "nothing returned"

SCORE_DIGITS = 12
"""Scores that agree to so many decimals are tied, and go by the table."""
LEAST_KEPT = 1e-9
"""Smaller probabilities are not kept, but for the truth's."""

_SUM_TOLERANCE = 1e-6
_DIGITS = 9


@dataclass(frozen=True)
class Verdict:
    """How one method did on one case.

    Attributes
    ----------
    method : its name.
    failure : the error that it raised, or why its answer is none; None where it answered.
    listed : how many different associations it listed; those that differ in single detections
        only count once.
    rank : the truth's rank, from 1; None where it is not listed. Ties go by the table.
    f1 : of the first association, over same-landmark pairs of detections; 0 for a failure.
    first : table of the first association, rows in order, "" for a failure.
    forecast : probabilities, most probable first; None where the scores are none.
    truth : the truth's place in the forecast; None where it is not listed.
    tau : Kendall's tau-b between the method's scores and the reference's, over what both list;
        None where it is undefined.
    map_error : `gospa` of the map of the first association, baselines; of no map for a failure.
    """

    method: str
    failure: str | None
    listed: int
    rank: int | None
    f1: float
    first: str
    forecast: list[float] | None
    truth: int | None
    tau: float | None
    map_error: float


class AnswerError(OptionError):
    """What a method returned is no list of scored associations."""


def ordered_answers(answers: Answers, case: Case) -> list[tuple[Association, float]]:
    """Check what a method returned, join what differs in single detections only, and sort.

    Probabilities of the same pairs are summed, of other scores the best one stands. Raises
    `AnswerError` for anything but associations of the case's scans with finite scores.
    """
    listed = _checked(answers, case)
    join: Callable[[float, float], float] = _add if is_forecast([s for _, s in listed]) else max
    joined: dict[Association, float] = {}
    for association, score in listed:
        pairs = _pairs_only(association)
        joined[pairs] = join(joined[pairs], score) if pairs in joined else score
    return sorted(joined.items(), key=lambda item: (-round(item[1], SCORE_DIGITS),
                                                    item[0].sort_key()))  # fmt: skip


def is_forecast(scores: list[float]) -> bool:
    """Whether scores can be read as probabilities: from 0 to 1, with a sum of at most 1."""
    in_range = all(0.0 <= s <= 1.0 + _SUM_TOLERANCE for s in scores)
    return in_range and math.fsum(scores) <= 1.0 + _SUM_TOLERANCE


def verdict_on(
    method: str,
    answers: list[tuple[Association, float]],
    case: Case,
    reference: dict[Association, float],
    error_of_map: Callable[[Association], float],
) -> Verdict:
    """Judge the ordered answers of a method; `reference` has the scores that tau is about."""
    if not answers:
        return failed(method, NOTHING, case, error_of_map)
    places = [i for i, (association, _) in enumerate(answers) if association.exact(case.truth)]
    place = places[0] if places else None
    scores = [score for _, score in answers]
    forecast, truth = None, None
    if is_forecast(scores):
        kept = [i for i, p in enumerate(scores) if p >= LEAST_KEPT or i == place]
        forecast = [_rounded(min(scores[i], 1.0)) for i in kept]
        truth = None if place is None else kept.index(place)
    first = answers[0][0]
    return Verdict(
        method=method,
        failure=None,
        listed=len(answers),
        rank=None if place is None else place + 1,
        f1=_rounded(first.f1(case.truth)),
        first=";".join(" ".join(map(str, row)) for row in first.table.tolist()),
        forecast=forecast,
        truth=truth,
        tau=_tau(dict(answers), reference),
        map_error=_rounded(error_of_map(first)),
    )


def failed(
    method: str, reason: str, case: Case, error_of_map: Callable[[Association], float]
) -> Verdict:
    """Return the verdict on a method that gave no answer: a miss, and a map without landmarks."""
    nothing = Association([], case.run.n_detections)
    return Verdict(
        method=method,
        failure=reason,
        listed=0,
        rank=None,
        f1=0.0,
        first="",
        forecast=None,
        truth=None,
        tau=None,
        map_error=_rounded(error_of_map(nothing)),
    )


def _checked(answers: Answers, case: Case) -> list[tuple[Association, float]]:
    listed = []
    try:
        pairs = [(association, float(score)) for association, score in answers]
    except (TypeError, ValueError) as cause:
        raise AnswerError("give pairs (association, score)") from cause
    for association, score in pairs:
        if not isinstance(association, Association):
            raise AnswerError(f"{type(association).__name__} is no Association")
        if association.n_detections != case.run.n_detections:
            raise AnswerError("an association is over other scans than the run's")
        if not math.isfinite(score):
            raise AnswerError(f"a score is {score}: give finite ones")
        listed.append((association, score))
    return listed


def _pairs_only(association: Association) -> Association:
    """Leave out the landmarks that are seen once: to the truth they are nothing."""
    table = association.table
    often = (table != MISSED).sum(axis=1) >= 2
    return association if often.all() else Association(table[often], association.n_detections)


def _tau(scores: dict[Association, float], reference: dict[Association, float]) -> float | None:
    both = [a for a in scores if a in reference]
    if len(both) < 2:
        return None
    tau = float(kendalltau([scores[a] for a in both], [reference[a] for a in both]).statistic)
    return _rounded(tau) if np.isfinite(tau) else None


def _add(a: float, b: float) -> float:
    return a + b


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
