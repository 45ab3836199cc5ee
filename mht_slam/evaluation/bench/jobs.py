"""One job of a comparison: every method on one case, timed and judged."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from mht_slam.association import Association
from mht_slam.evaluation.baselines import order_changes
from mht_slam.evaluation.bench.case import Case, CaseSource
from mht_slam.evaluation.bench.judging import (
    Verdict,
    failed,
    ordered_answers,
    verdict_on,
)
from mht_slam.evaluation.bench.map_error import map_error
from mht_slam.evaluation.bench.methods import (
    CEILINGS,
    GRAPH_EVIDENCE,
    Answers,
    Method,
    with_candidates,
)

CANDIDATES = "candidates"
"""Under this name stands the time that finding the shared candidates took."""
MESSAGE_LENGTH = 200


@dataclass(frozen=True)
class Job:
    """One scene to be done."""

    source: CaseSource
    scene: int

    @property
    def key(self) -> tuple[str, int]:
        """What names the job in a store."""
        return self.source.key, self.scene


@dataclass(frozen=True)
class JobResult:
    """What came out of one job, the same wherever it ran.

    Attributes
    ----------
    source, scene : the job's key.
    order_changes : whether the visual order changes between scans.
    candidates : how many there are for the methods that weigh them; 0 where none does.
    truth_listed : whether the truth is among these.
    verdicts : one of each method that was asked, and of each ceiling.
    """

    source: str
    scene: int
    order_changes: bool
    candidates: int
    truth_listed: bool
    verdicts: tuple[Verdict, ...]

    @property
    def key(self) -> tuple[str, int]:
        """What names the job in a store."""
        return self.source, self.scene


@dataclass(frozen=True)
class JobTimes:
    """What differs from run to run: seconds, and the words of errors.

    Attributes
    ----------
    seconds : wall clock of each method, and under `CANDIDATES` that of the shared candidates,
        which the methods that weigh them need besides their own.
    messages : of the errors that methods raised.
    """

    source: str
    scene: int
    seconds: dict[str, float]
    messages: dict[str, str]


def run_job(methods: Mapping[str, Method], job: Job) -> tuple[JobResult, JobTimes]:
    """Let every method and ceiling answer one case; what a method raises is its failure."""
    case = job.source.case(job.scene)
    seconds: dict[str, float] = {}
    messages: dict[str, str] = {}
    assumptions = case.assumptions
    if any(method.weighs_candidates for method in methods.values()):
        begun = time.perf_counter()
        assumptions = with_candidates(case.run, case.assumptions)
        seconds[CANDIDATES] = time.perf_counter() - begun
    answers: dict[str, list[tuple[Association, float]] | str] = {}

    def ask(name: str, question: Any) -> None:
        begun = time.perf_counter()
        try:
            answers[name] = ordered_answers(question(), case)
        except Exception as error:  # a method that raises has failed the case
            answers[name] = type(error).__name__
            messages[name] = " ".join(str(error).split())[:MESSAGE_LENGTH]
        seconds[name] = time.perf_counter() - begun

    for name, method in methods.items():
        if method.takes(case):
            ask(name, _question(method, case, assumptions))
    for name, ceiling in CEILINGS.items():
        ask(name, lambda ceiling=ceiling: ceiling(case))
    truth = case.truth
    result = JobResult(
        *job.key,
        order_changes=order_changes(case.run, truth),
        candidates=len(assumptions.candidates),
        truth_listed=any(a.exact(truth) for a in assumptions.candidates),
        verdicts=_verdicts(answers, case),
    )
    return result, JobTimes(*job.key, seconds, messages)


def _question(method: Method, case: Case, assumptions: Any) -> Any:
    def question() -> Answers:
        return method.function(case.run, assumptions)

    return question


def _verdicts(
    answers: dict[str, list[tuple[Association, float]] | str], case: Case
) -> tuple[Verdict, ...]:
    reference = answers.get(GRAPH_EVIDENCE, [])
    scores = {} if isinstance(reference, str) else dict(reference)

    @cache
    def error_of_map(association: Association) -> float:
        return map_error(association, case)

    return tuple(
        failed(name, answer, case, error_of_map)
        if isinstance(answer, str)
        else verdict_on(name, answer, case, scores, error_of_map)
        for name, answer in answers.items()
    )
