"""Exact evidence of straight runs by quadrature: of given associations, and the best of all."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Executor

import numpy as np

from mht_slam.arrays import FloatArray, freeze, whole_number
from mht_slam.association import Association, refuse_unequal, respects_labels
from mht_slam.errors import OptionError
from mht_slam.evidence.candidates import (
    Candidates,
    check_sizes,
    distinct_candidates,
    size_weight,
    stated_model,
    with_probabilities,
)
from mht_slam.evidence.cluster_table import tabulate
from mht_slam.evidence.cover_problem import CoverProblem
from mht_slam.evidence.ratio_grid import association_log_evidence
from mht_slam.hypotheses import Hypothesis, Posterior
from mht_slam.measurements import BearingScan, RunPair, StraightRun, scan_selection
from mht_slam.models import ObservationModel
from mht_slam.progress import Progress

DEFAULT_SCANS = (0, 1, 2)
WORK_LIMIT = 20_000
WIDEST_STEP_PRIOR = 10.0
"""The largest `log_step_sigma`: the knots of a wider prior are too far apart to begin with."""
RESOLVED_SIGMA = 1e-3
"""The smallest sigma, radians: the tables may miss the bump in ln r of a narrower one."""


def evidence_by_quadrature(
    run: StraightRun,
    candidates: Candidates,
    *,
    sigma: float | None = None,
    model: ObservationModel | None = None,
    scans: Sequence[int] = DEFAULT_SCANS,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Posterior:
    """Weigh associations of three scans by their exact evidence, without estimating anything.

    With a common heading p(A | Z) ~ Int p(r) prod_j E_j(r) dr over the step ratio r, where E_j
    is the two-dimensional integral of one landmark. Each E_j is tabulated once as a function of
    ln r, on knots that adapt to it, and an association is then a sum of logs, summed over r at
    half its posterior's spread. The result has the normalisers of `refine`.

    Parameters
    ----------
    run : the scans.
    candidates : a `Ranking` or `Posterior` over three scans, or associations over `scans`. A
        candidate given twice counts once.
    sigma, model : as in `refine`; its `heading_sigma` and `lateral_sigma` must be zero.
    scans : indices of three scans, in order of travel; a `Ranking` or `Posterior` brings its own.
    executor : any `concurrent.futures.Executor`, for the tables; None works in this process. The
        result does not depend on it, to the last bit.
    progress : called as ``progress(done, total)``.

    Returns
    -------
    The posterior over the candidates, without poses and likelihoods. A candidate that the labels
    or the model rule out has log evidence -inf and its `failure`.

    Raises `OptionError` for a `RunPair`, a model whose headings or lateral deviations vary, where
    no sigma is known or one is below 1e-3 radians, where `log_step_sigma` is above 10, or where
    candidates differ in size and the model does not say what that costs; `AssociationError` for
    candidates of other scans; `MeasurementError` for `scans` that do not exist.

    Source: docs/method.md, section 4.

    >>> import numpy as np
    >>> from mht_slam import Association, BearingScan, StraightRun
    >>> bearings = [[45.0, 27.0, -34.0], [90.0, 45.0, -53.0], [153.0, 90.0, -90.0]]
    >>> run = StraightRun([BearingScan(np.deg2rad(b)) for b in bearings])
    >>> keep = Association([[0, 0, 0], [1, 1, 1], [2, 2, 2]], (3, 3, 3))
    >>> swap = Association([[0, 1, 0], [1, 0, 1], [2, 2, 2]], (3, 3, 3))
    >>> posterior = evidence_by_quadrature(run, [swap, keep], sigma=np.deg2rad(1.0))
    >>> posterior[0].association == keep
    True
    """
    _check_run(run)
    own = getattr(candidates, "scans", scans)
    chosen = scan_selection(own, len(run), exactly=3)
    _, pairs = distinct_candidates(run, candidates, chosen)
    full_model = _strict(stated_model(run, chosen, sigma, 0.0, 0.0, model))
    check_sizes([pair.association for pair in pairs], full_model)
    members = tuple(run.scans[i] for i in chosen)
    rows = {tuple(row) for pair in pairs for row in pair.association.table.tolist()}
    entries = np.array(sorted(rows), dtype=np.int64).reshape(-1, 3)
    table = tabulate(members, _sigmas(members, full_model), full_model, entries, executor)
    index = {tuple(row): i for i, row in enumerate(entries.tolist())}
    hypotheses = []
    for done, (association, score, _) in enumerate(pairs, start=1):
        failure = None
        weight = size_weight(association, full_model)
        evidence = -math.inf
        if not respects_labels(association, members):
            failure = "it contradicts the detections' labels"
        elif weight == -math.inf:
            failure = "the model rules out its misses or false alarms"
        else:
            clusters = [index[tuple(row)] for row in association.table.tolist()]
            evidence = weight + association_log_evidence(
                table, np.array(clusters, dtype=np.int64), full_model
            )
        hypotheses.append(_weighed(association, score, evidence, failure))
        if progress is not None:
            progress(done, len(pairs))
    return Posterior(hypotheses=with_probabilities(hypotheses), scans=chosen, model=full_model)


def rank_by_evidence(
    run: StraightRun,
    *,
    sigma: float | None = None,
    top_k: int = 10,
    model: ObservationModel | None = None,
    scans: Sequence[int] = DEFAULT_SCANS,
    max_missed: int = 0,
    max_false: int = 0,
    work_limit: int = WORK_LIMIT,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Posterior:
    """Find the associations of three scans with the largest evidence, of all there are.

    The tables of `evidence_by_quadrature`, for all clusters of detections, on one grid of step
    ratios that resolves every association which counts; then branch and bound over covers of the
    detections. Evidence alone orders, unlike in `rank`: no association is preferred for its size.

    Parameters
    ----------
    run, sigma, model, scans : as in `evidence_by_quadrature`.
    top_k : how many associations to list, fewer where the others have less than e^-40 of the
        evidence of the first.
    max_missed : the most -1 entries of a table. 0 allows full tables only.
    max_false : the most detections that belong to no landmark.
    work_limit : branches opened before the search gives up and lists the best so far.
    executor : as in `evidence_by_quadrature`: for the tables, the search itself is serial.
    progress : called as ``progress(done, work_limit)``, now and then.

    Returns
    -------
    The posterior over the associations listed, without poses and likelihoods. Its `complete` says
    that nothing unlisted has more evidence than the last one; its `covered` bounds the
    probability of everything unlisted among all associations allowed. Both are exact for the
    discretised evidence, which the tests hold to .005 nats of dense integration. Empty where the
    labels leave no association.

    Raises `OptionError` as `evidence_by_quadrature`, and where misses or false alarms are allowed
    but the model does not say what they cost; `UnequalScansError` where the scans differ in
    length more than that allows.

    Source: docs/method.md, section 4.

    >>> import numpy as np
    >>> from mht_slam import BearingScan, StraightRun
    >>> bearings = [[45.0, 27.0, -34.0], [90.0, 45.0, -53.0], [153.0, 90.0, -90.0]]
    >>> run = StraightRun([BearingScan(np.deg2rad(b)) for b in bearings])
    >>> posterior = rank_by_evidence(run, sigma=np.deg2rad(1.0))
    >>> posterior[0].association.table.tolist(), posterior.complete, posterior.covered < 1e-6
    ([[0, 0, 0], [1, 1, 1], [2, 2, 2]], True, True)
    """
    _check_run(run)
    whole_number(top_k, "top_k", at_least=1)
    whole_number(max_missed, "max_missed", at_least=0)
    whole_number(max_false, "max_false", at_least=0)
    whole_number(work_limit, "work_limit", at_least=1)
    chosen = scan_selection(scans, len(run), exactly=3)
    full_model = _strict(stated_model(run, chosen, sigma, 0.0, 0.0, model))
    members = tuple(run.scans[i] for i in chosen)
    _check_limits(members, full_model, max_missed, max_false)
    problem = CoverProblem(
        members, _sigmas(members, full_model), full_model, max_missed, max_false, executor
    )
    found = problem.search(top_k, work_limit, progress)
    hypotheses = [
        _weighed(association, None, evidence, None) for evidence, association in found.listed
    ]
    # Evidences that differ by rounding only are ties, and go by the table.
    hypotheses.sort(key=lambda h: (-round(h.log_evidence, 9), h.association.sort_key()))
    hypotheses = hypotheses[:top_k]
    return Posterior(
        hypotheses=with_probabilities(hypotheses),
        scans=chosen,
        model=full_model,
        covered=found.outside_of(hypotheses),
        complete=found.complete,
    )


def _weighed(
    association: Association, score: float | None, evidence: float, failure: str | None
) -> Hypothesis:
    return Hypothesis(
        association=association,
        score=score,
        log_likelihood=None,
        log_evidence=evidence,
        probability=0.0,
        failure=failure,
        log_evidence_error=None if failure else 0.0,
    )


def _check_run(run: StraightRun) -> None:
    if isinstance(run, RunPair):
        raise OptionError(
            "run is a RunPair, which has three more unknowns than the step: use refine, which "
            "samples them"
        )
    if not isinstance(run, StraightRun):
        raise OptionError(f"run is {type(run).__name__}: give a StraightRun")


def _strict(model: ObservationModel) -> ObservationModel:
    """Return the model, or raise where its landmarks do not separate given one step ratio."""
    for name in ("heading_sigma", "lateral_sigma"):
        if getattr(model, name) != 0.0:
            raise OptionError(
                f"{name} is {getattr(model, name):g}: quadrature takes headings and line as exact, "
                "since only then one step ratio couples the landmarks; use refine, which samples "
                f"the deviations, or set {name} to 0"
            )
    if model.log_step_sigma > WIDEST_STEP_PRIOR:
        raise OptionError(
            f"log_step_sigma is {model.log_step_sigma:g}: quadrature tabulates step priors up to "
            f"{WIDEST_STEP_PRIOR:g}; use refine"
        )
    simple = ObservationModel(sigma=model.sigma)
    for name in ("motion", "bearing_dof", "stay_probability", "field_of_view"):
        if getattr(model, name) != getattr(simple, name):
            raise OptionError(
                f"{name} is {getattr(model, name)}: quadrature takes straight motion, Gaussian "
                "bearings, and landmarks that stay in view all round; use refine"
            )
    return model


def _sigmas(members: tuple[BearingScan, ...], model: ObservationModel) -> tuple[FloatArray, ...]:
    """For each scan the sigmas of its detections; raises where the tables do not resolve them."""
    sigmas = tuple(
        freeze(np.full(len(scan), model.sigma)) if scan.sigma is None else scan.sigma
        for scan in members
    )
    least = min(float(sigma.min(initial=np.pi)) for sigma in sigmas)
    if least < RESOLVED_SIGMA:
        raise OptionError(
            f"sigma is {least:g}: quadrature resolves bearings down to {RESOLVED_SIGMA:g} radians; "
            "use refine, which integrates about the estimate"
        )
    return sigmas


def _check_limits(
    members: tuple[BearingScan, ...], model: ObservationModel, max_missed: int, max_false: int
) -> None:
    if (max_missed or max_false) and not model.compares_sizes:
        raise OptionError(
            "max_missed or max_false allow associations of different size: give a model with "
            "detection_probability, false_alarm_rate and expected_landmarks"
        )
    refuse_unequal([len(scan) for scan in members], max_missed, max_false)
