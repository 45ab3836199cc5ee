"""The whole method on one page: rank by polygons, refine by factor graphs, extend, compare."""

from __future__ import annotations

import math
from concurrent.futures import Executor
from dataclasses import dataclass, replace

from mht_slam.arrays import finite_number
from mht_slam.association import MISSED, Association
from mht_slam.comparison import Comparison, compare
from mht_slam.errors import (
    AssociationError,
    OptionError,
    TooFewLandmarksError,
    UnequalScansError,
    UnobservableError,
)
from mht_slam.evidence.candidates import stated_model, with_probabilities
from mht_slam.graph.problem import make_problem
from mht_slam.graph.refine import refine
from mht_slam.graph.solve import EvidenceMethod
from mht_slam.hypotheses import Hypothesis, Posterior, Ranking
from mht_slam.measurements import RunPair, StraightRun
from mht_slam.models import ObservationModel
from mht_slam.polygon.ranking import rank
from mht_slam.progress import Progress
from mht_slam.tracking.regime import is_dense
from mht_slam.tracking.whole_run import tracked_alternatives
from mht_slam.tree.effort import Effort
from mht_slam.tree.search import search_all_scans

FIRST_THREE = (0, 1, 2)
HEADING_COVERAGE = 2.0
"""Standard deviations of the headings' wander that epsilon is enlarged by: 95 % of them."""
RIGHT_ANGLE = math.pi / 2.0
LARGEST_EPSILON = math.radians(45.0)
"""The headings' wander enlarges epsilon up to here and no further."""
SEEDING_LIMIT = 300_000
"""Steps of the exact ranking where it only seeds a search over more scans."""


@dataclass(frozen=True)
class Solution:
    """What `solve` found: the polygon ranking, the graphs' posterior, and both side by side.

    Attributes
    ----------
    ranking : of three scans (of a `RunPair` all four). Empty, with the reason in its options, where
        polygons cannot follow.
    posterior : of the graphs, over all scans that were solved.
    comparison : of the ranking and the graphs' posterior over the ranked scans.
    seeds : the graphs' posterior over the ranked scans, from which a search over more scans set
        out; None where there are no more.
    tracked : whether the associations of all scans come from tracking a dense run.
    """

    ranking: Ranking
    posterior: Posterior
    comparison: Comparison
    seeds: Posterior | None = None
    tracked: bool = False


def solve(
    run: StraightRun | RunPair,
    *,
    epsilon: float,
    sigma: float | None = None,
    top_k: int | None = 50,
    scale: float | None = None,
    heading_sigma: float = 0.0,
    lateral_sigma: float = 0.0,
    model: ObservationModel | None = None,
    evidence: EvidenceMethod = "marginal",
    max_range: float = 100.0,
    scans: tuple[int, int, int] | None = None,
    effort: Effort | None = None,
    truth: Association | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Solution:
    """Rank associations by the polygon method, refine the best ones, and compare the two scores.

    Three scans are ranked and refined. A longer run goes on from there: the refined associations of
    its first three scans, and those that a hypothesis tree finds without polygons, are extended
    scan by scan, and the best are refined over all scans. A dense run, whose bearings hardly move
    between many scans, is tracked instead, and only where tracking is ambiguous hypotheses remain:
    the tracker's best readings are refined over all scans (`mht_slam.tracking.regime.is_dense`).

    Parameters
    ----------
    run : bearings of look-alike landmarks.
    epsilon : vision error, the bound on a bearing's error, radians. Where the model lets headings
        wander, the ranking's epsilon is enlarged to cover twice their standard deviation,
        sqrt(epsilon^2 + (2 sigma_h)^2); the ranking names it.
    sigma : standard deviation of a bearing, radians; a scan's own sigmas go before it.
    top_k : how many of the ranked associations are refined; None means all with a positive score.
    scale : length of the first baseline in metres, if known.
    heading_sigma, lateral_sigma, model, evidence, executor : as in `mht_slam.refine`.
    max_range : baselines of each pair of scans at which the polygon method cuts its cells.
    scans : three scans of a straight run to solve alone; None solves all of them.
    effort : how hard the tree searches, and how many readings of a dense run are refined (`keep`);
        None means `Effort()`.
    truth : the true association over the scans that are solved, for the comparison only.
    progress : called as ``progress(done, total)``, of scans in the tree and then of candidates.

    Raises what `mht_slam.rank`, `mht_slam.refine` and `mht_slam.compare` raise, and `OptionError`
    for ``free`` motion over more than three scans. A run of more than three scans needs no
    polygons: where its first three have different numbers of detections, or fewer than three, the
    ranking stays empty. Its posterior is empty where no association of all scans could be solved:
    where the model lets landmarks neither be missed nor come and go, one bad scan is enough.

    Source: docs/method.md, sections 3 to 5.
    """
    if not isinstance(run, StraightRun | RunPair):
        raise OptionError(f"run is {type(run).__name__}: give a StraightRun or a RunPair")
    three = FIRST_THREE if scans is None else scans
    if effort is not None and not isinstance(effort, Effort):
        raise OptionError(f"effort is {type(effort).__name__}: give an Effort")
    if truth is not None and not isinstance(truth, Association):
        raise AssociationError(f"truth is {type(truth).__name__}: give an Association")
    longer = isinstance(run, StraightRun) and scans is None and len(run) > len(FIRST_THREE)
    used = three if isinstance(run, StraightRun) and not longer else tuple(range(len(run)))
    full_model = stated_model(run, used, sigma, heading_sigma, lateral_sigma, model)
    if longer and full_model.motion == "free":
        raise OptionError(
            "motion is 'free', under which nothing tells where to look for the next pose: name "
            "three scans, or give refine candidates over all of them"
        )
    if isinstance(run, RunPair):
        ranking = rank(run, epsilon=epsilon, top_k=top_k, max_range=max_range)
    else:
        ranking = _ranking(run, three, epsilon, full_model, top_k, max_range, longer)
    try:
        seeds = refine(
            run,
            ranking,
            model=full_model,
            evidence=evidence,
            scale=scale,
            executor=executor,
            progress=None if longer else progress,
        )
    except UnobservableError:
        if not longer:
            raise
        seeds = Posterior((), three, full_model)  # all scans together may tell more
    if truth is not None and longer:
        truth = truth.restrict(three)
    comparison = compare(ranking, seeds, truth)
    if not longer or isinstance(run, RunPair):
        return Solution(ranking, seeds, comparison)
    chosen = effort or Effort()
    readings = _tracked(run, full_model, chosen)
    if readings:
        posterior = refine(
            run,
            readings,
            model=full_model,
            evidence=evidence,
            scale=scale,
            executor=executor,
            progress=progress,
        )
        if any(h.failure is None for h in posterior):
            return Solution(ranking, posterior, comparison, seeds, tracked=True)
    posterior = _over_all_scans(run, seeds, full_model, evidence, scale, chosen, executor, progress)
    return Solution(ranking, posterior, comparison, seeds)


def _ranking(
    run: StraightRun,
    scans: tuple[int, int, int],
    epsilon: float,
    model: ObservationModel,
    top_k: int | None,
    max_range: float,
    only_seeds: bool,
) -> Ranking:
    """Rank three scans; without a ranking there are no seeds, but a longer run has its tree."""
    wander = model.turn_sigma if model.motion == "smooth" else model.heading_sigma
    finite_number(epsilon, "epsilon", above=0.0, below=RIGHT_ANGLE)
    enlarged = min(math.hypot(epsilon, HEADING_COVERAGE * wander), LARGEST_EPSILON)
    enlarged = max(epsilon, enlarged)
    if not only_seeds:
        return rank(run, epsilon=enlarged, top_k=top_k, max_range=max_range, scans=scans)
    try:
        return rank(
            run,
            epsilon=enlarged,
            top_k=top_k,
            max_range=max_range,
            scans=scans,
            work_limit=SEEDING_LIMIT,
        )
    except (TooFewLandmarksError, UnequalScansError) as cause:
        return Ranking(
            hypotheses=(),
            scans=scans,
            base=(MISSED, MISSED),
            complete=False,
            gap=1.0,
            epsilon=enlarged,
            options={"not_ranked": str(cause)},
        )


def _tracked(run: StraightRun, model: ObservationModel, effort: Effort) -> list[Association]:
    """Readings of a dense run; none of a run that the tree is to search.

    That is any other run, one with known identities, and one of which no reading has every landmark
    in every scan while the model says nothing of misses.
    """
    labelled = any(label is not None for scan in run.scans for label in scan.labels or ())
    if labelled or not is_dense(run):
        return []
    readings = tracked_alternatives(run, model, effort.keep)
    return [a for a in readings if a.n_landmarks and (model.compares_sizes or a.is_full)]


def _over_all_scans(
    run: StraightRun,
    seeds: Posterior,
    model: ObservationModel,
    evidence: EvidenceMethod,
    scale: float | None,
    effort: Effort,
    executor: Executor | None,
    progress: Progress | None,
) -> Posterior:
    """Extend the seeds over all scans, and refine what comes out.

    A detection in no pair is a landmark seen once or a false alarm. Which of the two says nothing
    of the other detections, so such readings are one hypothesis, listed as the likelier and weighed
    by their sum.
    """
    everything = tuple(range(len(run)))
    problem = make_problem(run, everything, model, scale)
    best = [h for h in seeds if h.failure is None][: effort.keep]
    finalists = search_all_scans(problem, effort, best, progress)
    candidates = [
        Hypothesis(f.association, None, None, -math.inf, 0.0, poses=f.poses, landmarks=f.landmarks)
        for f in finalists
    ]
    posterior = refine(
        run,
        Posterior(tuple(candidates), everything, model),
        model=model,
        evidence=evidence,
        scale=scale,
        executor=executor,
        progress=progress,
    )
    other_readings = {f.association: f.log_other_readings for f in finalists}
    weighed = [
        replace(h, log_evidence=h.log_evidence + other_readings[h.association]) for h in posterior
    ]
    return replace(posterior, hypotheses=with_probabilities(weighed))
