"""`refine`: every candidate association becomes a solved graph; together they are a posterior."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from concurrent.futures import Executor
from functools import partial
from itertools import compress
from typing import Any, get_args

import numpy as np

from mht_slam.arrays import freeze, one_of
from mht_slam.association import MISSED, Association, respects_labels
from mht_slam.errors import OptionError
from mht_slam.evidence.candidates import (
    Candidate,
    Candidates,
    check_sizes,
    distinct_candidates,
    false_alarm_term,
    size_weight,
    stated_model,
    with_probabilities,
)
from mht_slam.evidence.visibility import sightlines
from mht_slam.graph.build import FactorPool, build_graph, graph_keys, make_values
from mht_slam.graph.gate import log_evidence_bound
from mht_slam.graph.observability import require_observable
from mht_slam.graph.problem import Problem, make_problem
from mht_slam.graph.solve import (
    Estimate,
    EvidenceMethod,
    TrappedError,
    UnsolvedError,
    solve_association,
)
from mht_slam.hypotheses import Hypothesis, Posterior
from mht_slam.measurements import RunPair, StraightRun
from mht_slam.models import ObservationModel
from mht_slam.parallel import ordered_map
from mht_slam.progress import Progress

BEYOND_FLOATS = "the model's numbers go beyond double precision"

GATE = 60.0
"""Nats below the best hypothesis beyond which a trapped one is given up: probabilities of 1e-26."""
CHUNK = 16
"""Candidates sent to a worker at a time."""


def refine(
    run: StraightRun | RunPair,
    candidates: Candidates,
    *,
    sigma: float | None = None,
    heading_sigma: float = 0.0,
    lateral_sigma: float = 0.0,
    model: ObservationModel | None = None,
    evidence: EvidenceMethod = "marginal",
    scale: float | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Posterior:
    """Solve the factor graph of every candidate and weigh the candidates by their evidence.

    Parameters
    ----------
    run : the scans. Frame of the result: O1 at the origin, O2 at (1, 0); for a `RunPair` the
        frame of its first run.
    candidates : a `Ranking` or a `Posterior` (its scans are used), or associations over all scans
        of the run. A candidate given twice counts once.
    sigma : standard deviation of a bearing, radians; a scan's own sigmas go before it.
    heading_sigma : deviation of each heading from the direction of travel, radians.
    lateral_sigma : deviation of scans 3 and later from the line, baselines.
    model : everything assumed. A `sigma`, and a `heading_sigma` or `lateral_sigma` other than
        zero, replace its fields. Without a model the rest of `ObservationModel` has its defaults.
    evidence : how the evidence integral is taken about the graph's optimum. "marginal" integrates
        every landmark exactly, a single step by a sum, more unknowns of the poses by sampling;
        "laplace" is Laplace's approximation over everything, from GTSAM's Hessian, and is also
        what hypotheses with a residual beyond six sigma, or with more than eight unknowns of the
        poses, get.
    scale : length of the first baseline in metres, if known, from 1e-3 to 1e4; the result is then
        in metres.
    executor : any `concurrent.futures.Executor`, also that of a `dask.distributed.Client`; None
        works in this process. The result does not depend on it, to the last bit, nor on workers
        that get killed (`mht_slam.parallel`).
    progress : called as ``progress(done, total)``.

    Returns
    -------
    The posterior. A candidate that cannot be solved stays in it with log evidence -inf,
    probability 0 and its `failure`. So does one that leads the optimiser onto an observation point
    or backwards and has, whatever the path, less than e^-60 of the best one's evidence: it is
    ``gated``.

    Raises `OptionError` for a run, model, evidence or scale that is none, where no sigma is known,
    or where candidates differ in the numbers of landmarks, misses or false alarms and the model
    does not say what those cost; `AssociationError` for a candidate that is not over the run's
    scans; `UnobservableError` where nothing but priors could tell the candidates apart,
    neither their bearings nor the model of misses and false alarms.

    Source: docs/method.md, sections 2 and 4.

    >>> import numpy as np
    >>> from mht_slam import Association, BearingScan, StraightRun
    >>> bearings = [[45.0, 27.0, -34.0, -63.0], [90.0, 45.0, -53.0, -104.0],
    ...             [153.0, 90.0, -90.0, -146.0]]
    >>> run = StraightRun([BearingScan(np.deg2rad(b)) for b in bearings])
    >>> keep = Association([[0, 0, 0], [1, 1, 1], [2, 2, 2], [3, 3, 3]], (4, 4, 4))
    >>> swap = Association([[0, 0, 0], [1, 1, 1], [2, 2, 3], [3, 3, 2]], (4, 4, 4))
    >>> posterior = refine(run, [swap, keep], sigma=np.deg2rad(1.0))
    >>> posterior[0].association == keep, posterior[0].probability > 0.99
    (True, True)
    """
    if not isinstance(run, StraightRun | RunPair):
        raise OptionError(f"run is {type(run).__name__}: give a StraightRun or a RunPair")
    scans, pairs = distinct_candidates(run, candidates)
    one_of(evidence, "evidence", get_args(EvidenceMethod))
    full_model = stated_model(run, scans, sigma, heading_sigma, lateral_sigma, model)
    check_sizes([pair.association for pair in pairs], full_model)
    if not full_model.compares_sizes:  # else misses and false alarms tell associations apart, too
        require_observable(run, [pair.association for pair in pairs], full_model)
    problem = make_problem(run, scans, full_model, scale)
    hypotheses = _hypotheses(problem, pairs, evidence, executor, progress)
    return Posterior(
        hypotheses=with_probabilities(hypotheses),
        scans=scans,
        model=full_model,
        unit="baseline" if scale is None and full_model.motion != "odometry" else "metre",
    )


def _hypotheses(
    problem: Problem,
    pairs: list[Candidate],
    evidence: EvidenceMethod,
    executor: Executor | None,
    progress: Progress | None,
) -> list[Hypothesis]:
    """Solve the candidates; those that trap the optimiser are rescued where that may matter.

    Most of them are hopeless, and a rescue costs more than all else. Which are is told by the best
    of the others, so the outcome hangs neither on the order of the candidates nor on the executor.
    """
    first = list(_solved(problem, pairs, evidence, executor, progress, rescue=False))
    worthwhile = -GATE + max((h.log_evidence for h in first if h is not None), default=-math.inf)
    trapped = [pair for pair, outcome in zip(pairs, first, strict=True) if outcome is None]
    matters = [_bound(problem, pair) >= worthwhile for pair in trapped]
    rescued = _solved(
        problem, list(compress(trapped, matters)), evidence, executor, None, rescue=True
    )
    second = [
        next(rescued) if may else _gated(pair) for pair, may in zip(trapped, matters, strict=True)
    ]
    return [*filter(None, first), *filter(None, second)]


def _bound(problem: Problem, candidate: Candidate) -> float:
    """Bound of the log evidence with all weights; infinite where none is known."""
    model = problem.model
    if model.compares_sizes and model.field_of_view < 2.0 * math.pi:
        return math.inf  # what is out of view hangs on the estimate
    bound = log_evidence_bound(problem, candidate.association.table)
    return bound + size_weight(candidate.association, model)


def _gated(candidate: Candidate) -> Hypothesis:
    reason = (
        "gated: the optimiser puts a landmark on an observation point or goes backwards, and no "
        f"straight path brings it within {GATE:g} nats of the best hypothesis"
    )
    return Hypothesis(
        candidate.association, candidate.score, -math.inf, -math.inf, 0.0, failure=reason
    )


def _solved(
    problem: Problem,
    pairs: list[Candidate],
    evidence: EvidenceMethod,
    executor: Executor | None,
    progress: Progress | None,
    *,
    rescue: bool,
) -> Iterator[Hypothesis | None]:
    """Solve candidates in their order, in chunks where an executor does the work."""
    if executor is None:
        pool = FactorPool(problem)
        batches: Iterable[list[Hypothesis | None]] = (
            [_solve_one(pool, evidence, pair, rescue)] for pair in pairs
        )
    else:
        chunks = [pairs[i : i + CHUNK] for i in range(0, len(pairs), CHUNK)]
        work = partial(_solve_chunk, problem, evidence, rescue)
        batches = ordered_map(executor, work, chunks)
    done = 0
    for batch in batches:
        yield from batch
        done += len(batch)
        if progress is not None:
            progress(done, len(pairs))


def _solve_chunk(
    problem: Problem, evidence: EvidenceMethod, rescue: bool, pairs: list[Candidate]
) -> list[Hypothesis | None]:
    pool = FactorPool(problem)
    return [_solve_one(pool, evidence, pair, rescue) for pair in pairs]


def _solve_one(
    pool: FactorPool, evidence: EvidenceMethod, candidate: Candidate, rescue: bool
) -> Hypothesis | None:
    """Return the solved hypothesis, or None for one to be rescued."""
    association, score, start = candidate
    problem, model = pool.problem, pool.problem.model
    failed = partial(Hypothesis, association, score, -math.inf, -math.inf, 0.0)
    if problem.labelled and not respects_labels(association, problem.scans):
        return failed("it contradicts the detections' labels")
    if size_weight(association, model) == -math.inf:
        return failed("the model rules out its misses or false alarms")
    try:
        # Extreme models overflow on the way; what matters is whether the outcome is finite.
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            estimate = solve_association(
                problem, association.table, evidence, start, pool, rescue=rescue
            )
    except TrappedError as cause:
        return failed(str(cause)) if rescue else None
    except UnsolvedError as cause:
        return failed(str(cause))
    except OverflowError:
        return failed(BEYOND_FLOATS)
    if not (math.isfinite(estimate.log_evidence) and math.isfinite(estimate.log_likelihood)):
        return failed(BEYOND_FLOATS)
    weight = false_alarms = 0.0
    if model.compares_sizes:
        bearings = sightlines(estimate.poses, estimate.landmarks)
        weight = size_weight(association, model, bearings)
    if model.false_alarm_rate is not None:
        false_alarms = false_alarm_term(association, model)
    return Hypothesis(
        association=association,
        score=score,
        log_likelihood=estimate.log_likelihood + false_alarms,
        log_evidence=estimate.log_evidence + weight,
        probability=0.0,
        poses=freeze(estimate.poses),
        landmarks=freeze(estimate.landmarks),
        landmark_covariances=freeze(estimate.landmark_covariances),
        pose_covariances=freeze(estimate.pose_covariances),
        log_evidence_error=estimate.log_evidence_error,
        ranged=freeze((association.table != MISSED).sum(axis=1) >= 2),
        _build_graph=partial(_to_gtsam, problem, association, estimate),
    )


def _to_gtsam(problem: Problem, association: Association, estimate: Estimate) -> tuple[Any, ...]:
    graph = build_graph(problem, association.table, estimate.poses)
    keys = graph_keys(len(problem.scans), association.n_landmarks)
    return graph, make_values(keys, estimate.poses, estimate.landmarks), keys
