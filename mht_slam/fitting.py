"""Fit an observation model to runs without known identities, by the evidence of their bearings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from scipy.special import logsumexp

from mht_slam.arrays import FloatArray, IntArray, whole_number
from mht_slam.errors import OptionError
from mht_slam.evidence.visibility import expected_detected, sightlines
from mht_slam.graph.problem import make_problem
from mht_slam.measurements import StraightRun
from mht_slam.models import ObservationModel
from mht_slam.parallel import ordered_map
from mht_slam.progress import Progress
from mht_slam.tree.branch import LostError, anew
from mht_slam.tree.effort import Effort
from mht_slam.tree.grow import grow
from mht_slam.tree.pattern import log_pattern
from mht_slam.tree.setting import Setting

BOUNDS: Final[Mapping[str, tuple[float, float]]] = MappingProxyType(
    {
        "sigma": (1e-5, 0.3),
        "turn_sigma": (1e-4, 1.0),
        "drift_sigma": (1e-4, 1.0),
        "step_change_sigma": (1e-3, 2.0),
        "landmark_sigma": (0.5, 1e3),
        "detection_probability": (1e-3, 1.0 - 1e-4),
        "stay_probability": (1e-3, 1.0 - 1e-4),
        "false_alarm_rate": (1e-6, 10.0),
        "expected_landmarks": (1e-2, 1e3),
    }
)
"""The parameters that can be fitted, and how far each may go."""
PARAMETERS: Final = tuple(BOUNDS)
OF_PATTERN = ("detection_probability", "stay_probability", "false_alarm_rate", "expected_landmarks")
"""Parameters that no pose and no landmark depends on: an association need not be solved again."""
OF_SMOOTH_MOTION = ("turn_sigma", "drift_sigma", "step_change_sigma")
PROBABILITIES = ("detection_probability", "stay_probability")
"""Searched by their log odds; all others by their logarithm."""

DEFAULT_EFFORT = Effort(keep=4, solve=8)
FIRST_STEP = 0.5
"""Step of a search in the first round, in log or log odds; half of it in each later round."""
MAX_STRIDES = 1
"""Strides beyond the first: associations found under one model say little of a distant one."""
SWEEPS = 4
"""Searches over each of `OF_PATTERN` in a round: they are cheap, and depend on each other."""
NEGLIGIBLE = 6.0
"""Nats below a run's best association at which another one is left out."""
N_PRIOR_POINTS = 500
"""Points that stand for the landmark prior where the field of view is limited."""


@dataclass(frozen=True)
class FitRound:
    """One round: associate with the model so far, then improve the model.

    Attributes
    ----------
    model : at the end of the round.
    log_evidence_before, log_evidence : of all runs over this round's associations, under the model
        that found them and under the improved one; the second is never below the first.
    n_runs : runs that have an association; the rest count in neither number.
    """

    model: ObservationModel
    log_evidence_before: float
    log_evidence: float
    n_runs: int


@dataclass(frozen=True)
class FittedModel:
    """What `fit_observation_model` found.

    Attributes
    ----------
    model : the fitted model.
    standard_errors : of each fitted parameter, in its own unit, from the curvature of the log
        evidence with the others held, hence a lower bound; nan where it has no maximum inside
        its `BOUNDS`, or a run is lost beside it.
    rounds : in order. Their evidence grows within a round; between rounds the associations change.
    n_runs : runs that were given.
    """

    model: ObservationModel
    standard_errors: Mapping[str, float]
    rounds: tuple[FitRound, ...]
    n_runs: int

    @property
    def log_evidence(self) -> tuple[float, ...]:
        """Log evidence at the end of each round."""
        return tuple(entry.log_evidence for entry in self.rounds)


def fit_observation_model(
    runs: Sequence[StraightRun],
    start: ObservationModel,
    *,
    parameters: Sequence[str] = PARAMETERS,
    rounds: int = 3,
    effort: Effort | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> FittedModel:
    """Fit an observation model to runs whose associations nobody knows.

    The objective is the evidence of the runs, summed over associations A,

        sum_runs log sum_A p(Z, A | model),

    which needs no truth. Each round grows the hypothesis tree of every run under the model so far
    (`mht_slam.tree`); then, with these associations and their solutions sought anew for every
    model tried, improves one parameter after another. The counts' exponent, which is the same for
    all associations of a run but not for all models, is part of it (docs/method.md, section 4).

    Parameters
    ----------
    runs : with all detections as the sensor gives them.
    start : where the search begins; gives the parameters that are not fitted. A `sigma` rather too
        small than too large: a large one lets wrong associations pass, and these bear it out.
        `field_of_view` is a datum of the sensor and never fitted. Nor is `bearing_dof`: Laplace's
        approximation cuts off the tails of every unknown that bearings settle, with
        ln(t(0) sqrt(2 pi dof / (dof + 1))) = -.17 nats for dof 4, and would always choose none.
    parameters : names out of `PARAMETERS`; a parameter that is not at work in `start` (a None, a
        probability of 1, a motion of another kind) cannot be fitted.
    rounds : at least 1; three bring a start within a factor of two or three to rest.
    effort : how hard the trees search; by default `DEFAULT_EFFORT`, less than ranking needs.
    executor : solves runs in parallel; the result does not depend on it.
    progress : called as ``progress(done, total)``.

    The result is deterministic, and a local maximum. Some parameters hold each other: false alarms
    and landmarks that stay for one scan, `stay_probability` and `detection_probability`, and
    `landmark_sigma` and `expected_landmarks`, of which the density of landmarks is known better.

    Raises `OptionError` for parameters that cannot be fitted, a model that cannot compare
    associations of different size, no runs, runs whose detections carry labels, or a start under
    which every run is lost.

    Source: docs/method.md, section 4.
    """
    whole_number(rounds, "rounds", at_least=1)
    _check(runs, start, parameters)
    effort = DEFAULT_EFFORT if effort is None else effort
    ordered = [name for name in parameters if name not in OF_PATTERN]
    ordered += SWEEPS * [name for name in parameters if name in OF_PATTERN]
    model = start
    history: list[FitRound] = []
    errors: dict[str, float] = {}
    for turn in range(rounds):
        objective = _associate(runs, model, effort, executor)
        state = objective.start
        before = state.log_evidence
        for k, name in enumerate(ordered, start=1):
            state, errors[name] = _climb(objective, state, name, FIRST_STEP / 2.0**turn)
            if progress is not None:
                progress(turn * len(ordered) + k, rounds * len(ordered))
        model = state.model
        history.append(FitRound(model, before, state.log_evidence, len(objective.runs)))
    return FittedModel(
        model=model,
        standard_errors=MappingProxyType({name: errors[name] for name in parameters}),
        rounds=tuple(history),
        n_runs=len(runs),
    )


def _check(runs: Sequence[StraightRun], start: ObservationModel, names: Sequence[str]) -> None:
    if not runs:
        raise OptionError("there are no runs: give at least one to fit to")
    for i, run in enumerate(runs):
        if any(scan.labels is not None for scan in run.scans):
            raise OptionError(f"runs[{i}] has labels: the fit takes scans without labels")
    if not start.compares_sizes:
        raise OptionError(
            "start leaves out detection_probability, false_alarm_rate or expected_landmarks: "
            "associations of different size can only be weighed if it states all three"
        )
    if not names:
        raise OptionError(f"parameters is empty: give some of {PARAMETERS}")
    for name in names:
        if name not in BOUNDS:
            raise OptionError(f"{name!r} is no parameter that can be fitted: give {PARAMETERS}")
        if name in OF_SMOOTH_MOTION and start.motion != "smooth":
            raise OptionError(
                f"{name} is no part of motion {start.motion!r}: leave it out of parameters"
            )
        value, (low, high) = getattr(start, name), BOUNDS[name]
        if value is None or not low <= value <= high:
            raise OptionError(
                f"{name} is {value} in start: start between {low:g} and {high:g}, or leave it "
                "out of parameters"
            )


@dataclass(frozen=True, eq=False)
class _Solved:
    """An association and its solution; `log_graph` is the evidence of the graph alone."""

    table: IntArray
    singles: IntArray
    poses: FloatArray
    points: FloatArray
    log_graph: float


@dataclass(frozen=True, eq=False)
class _State:
    """A model, the solutions of all runs under it, and its log evidence."""

    model: ObservationModel
    solutions: tuple[tuple[_Solved, ...], ...]
    log_evidence: float


@dataclass(frozen=True, eq=False)
class _Objective:
    """Log evidence of runs over given associations, as a function of the model."""

    runs: tuple[StraightRun, ...]
    start: _State
    executor: Executor | None

    def moved(self, state: _State, model: ObservationModel, *, solve: bool = True) -> _State:
        """Return the state under another model; `solve` unless only the pattern changes.

        An association whose optimum is lost there counts for nothing, so that the sum stays a lower
        bound; a run with none left makes it -inf.
        """
        solutions = state.solutions
        if solve:
            jobs = list(zip(self.runs, solutions, strict=True))
            solutions = tuple(ordered_map(self.executor, partial(_solve, model), jobs))
        pairs = zip(self.runs, solutions, strict=True)
        return _State(model, solutions, sum(_log_evidence(model, *pair) for pair in pairs))


def _associate(
    runs: Sequence[StraightRun],
    model: ObservationModel,
    effort: Effort,
    executor: Executor | None,
) -> _Objective:
    """Grow every run's tree and solve its best associations; runs without any are left out."""
    found = list(ordered_map(executor, partial(_grow_and_solve, model, effort), runs))
    kept = [(run, some) for run, some in zip(runs, found, strict=True) if some]
    if not kept:
        raise OptionError("every run is lost under the model: start from wider parameters")
    total = sum(_log_evidence(model, run, some) for run, some in kept)
    start = _State(model, tuple(some for _, some in kept), total)
    return _Objective(tuple(run for run, _ in kept), start, executor)


def _grow_and_solve(
    model: ObservationModel, effort: Effort, run: StraightRun
) -> tuple[_Solved, ...]:
    branches = grow(_setting(run, model), effort)
    kept = [b for b in branches if b.log_score > branches[0].log_score - NEGLIGIBLE]
    grown = tuple(_Solved(b.table, b.singles, b.poses, b.points, b.log_score) for b in kept)
    return _solve(model, (run, grown))


def _solve(
    model: ObservationModel, job: tuple[StraightRun, tuple[_Solved, ...]]
) -> tuple[_Solved, ...]:
    """Solve a run's associations under a model, from where they stand; lost ones are left out."""
    run, some = job
    setting = _setting(run, model)
    solved = []
    for old in some:
        try:
            branch = anew(setting, old.table, old.singles, old.poses, old.points)
        except LostError:
            continue
        new = _Solved(branch.table, branch.singles, branch.poses, branch.points, branch.log_score)
        solved.append(replace(new, log_graph=branch.log_score - _log_pattern(setting, new)))
    return tuple(solved)


def _setting(run: StraightRun, model: ObservationModel) -> Setting:
    return Setting(make_problem(run, tuple(range(len(run))), model))


def _log_pattern(setting: Setting, solved: _Solved) -> float:
    bearings = sightlines(solved.poses, solved.points)
    return log_pattern(setting, solved.poses, solved.table, solved.singles, bearings)


def _log_evidence(model: ObservationModel, run: StraightRun, some: tuple[_Solved, ...]) -> float:
    """Log evidence of a run over some of its associations, all normalisers included."""
    assert model.false_alarm_rate is not None  # noqa: S101 - see `_check`
    setting = _setting(run, model)
    scores = [
        solved.log_graph
        + _log_pattern(setting, solved)
        - expected_landmarks_detected(model, solved.poses)
        for solved in some
    ]
    false_alarms = model.false_alarm_rate * model.field_of_view * len(run)
    return float(logsumexp(scores)) - false_alarms if scores else -math.inf


def expected_landmarks_detected(model: ObservationModel, poses: FloatArray) -> float:
    """Expected number of landmarks that some scan detects, given the poses.

    With a limited view, a sum over points that share out the prior: u is the chance of being in
    view and not detected so far, u_0 = 1, u_k = s (1 - p_{k-1}) u_{k-1} + 1 - s, and the number of
    first detections the sum of all p_k u_k, p_k = 0 outside the view.
    """
    if model.field_of_view >= 2.0 * math.pi:
        return expected_detected(model, len(poses))
    assert model.detection_probability is not None  # noqa: S101 - see `_check`
    assert model.expected_landmarks is not None  # noqa: S101 - see `_check`
    share = (np.arange(N_PRIOR_POINTS) + 0.5) / N_PRIOR_POINTS
    radius = model.landmark_sigma * np.sqrt(-2.0 * np.log1p(-share))
    angle = np.arange(N_PRIOR_POINTS) * math.pi * (3.0 - math.sqrt(5.0))  # a sunflower's spiral
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    inside = np.abs(sightlines(poses, points + np.array(model.landmark_centre)))
    chances = np.where(inside <= 0.5 * model.field_of_view, model.detection_probability, 0.0)
    undetected, total = np.ones(N_PRIOR_POINTS), 0.0
    for chance in chances.T:
        total += float((chance * undetected).mean())
        undetected = model.stay_probability * (1.0 - chance) * undetected
        undetected += 1.0 - model.stay_probability
    return model.expected_landmarks * total


def _climb(objective: _Objective, state: _State, name: str, step: float) -> tuple[_State, float]:
    """Improve one parameter: uphill in strides until bracketed, then the parabola's top.

    Returns the best state met, and the parameter's standard error.
    """
    low, high = (free_value(name, bound) for bound in BOUNDS[name])
    here = free_value(name, getattr(state.model, name))
    tried = {here: state}

    def evaluate(place: float) -> None:
        place = min(max(place, low), high)
        if place not in tried:
            change: dict[str, Any] = {name: bounded_value(name, place)}
            model = replace(state.model, **change)
            tried[place] = objective.moved(state, model, solve=name not in OF_PATTERN)

    def best() -> float:
        return max(tried, key=lambda place: tried[place].log_evidence)

    evaluate(here - step)
    evaluate(here + step)
    for _ in range(MAX_STRIDES):
        top = best()
        if min(tried) < top < max(tried) or top in (low, high):
            break
        evaluate(top + math.copysign(step, top - here))
    top, error = best(), math.nan
    if min(tried) < top < max(tried):
        left, right = (max(p for p in tried if p < top), min(p for p in tried if p > top))
        values = [tried[place].log_evidence for place in (left, top, right)]
        if np.isfinite(values).all():
            curve, slope, _ = np.polyfit(np.array([left, top, right]) - top, values, 2)
            if curve < 0.0:
                evaluate(top - 0.5 * slope / curve)
                error = _unit(name, best()) / math.sqrt(-2.0 * curve)
    return tried[best()], error


def free_value(name: str, value: float) -> float:
    """Log of a parameter, or log odds of a probability: what the search walks along."""
    return math.log(value / (1.0 - value)) if name in PROBABILITIES else math.log(value)


def bounded_value(name: str, place: float) -> float:
    """Undo `free_value`, inside `BOUNDS` in spite of rounding."""
    value = 1.0 / (1.0 + math.exp(-place)) if name in PROBABILITIES else math.exp(place)
    return min(max(value, BOUNDS[name][0]), BOUNDS[name][1])


def _unit(name: str, place: float) -> float:
    """How much of the parameter a unit step of the search is."""
    value = bounded_value(name, place)
    return value * (1.0 - value) if name in PROBABILITIES else value
