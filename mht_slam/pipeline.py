"""The whole method on one page: rank by polygons, refine by factor graphs, compare."""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass

from mht_slam.association import Association
from mht_slam.comparison import Comparison, compare
from mht_slam.graph.refine import refine
from mht_slam.graph.solve import EvidenceMethod
from mht_slam.hypotheses import Posterior, Ranking
from mht_slam.measurements import RunPair, StraightRun
from mht_slam.models import ObservationModel
from mht_slam.polygon.ranking import rank
from mht_slam.progress import Progress


@dataclass(frozen=True)
class Solution:
    """What `solve` found: the polygon ranking, the graphs' posterior, and both side by side."""

    ranking: Ranking
    posterior: Posterior
    comparison: Comparison


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
    scans: tuple[int, int, int] = (0, 1, 2),
    truth: Association | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Solution:
    """Rank associations by the polygon method, refine the best ones, and compare the two scores.

    Parameters
    ----------
    run : bearings of look-alike landmarks.
    epsilon : vision error, the bound on a bearing's error, radians.
    sigma : standard deviation of a bearing, radians; a scan's own sigmas go before it.
    top_k : how many of the ranked associations are refined; None means all with a positive score.
    scale : length of the first baseline in metres, if known.
    heading_sigma, lateral_sigma, model, evidence, executor : as in `mht_slam.refine`.
    max_range : baselines of each pair of scans at which the polygon method cuts its cells.
    scans : three scans of a straight run; a `RunPair` uses all of its four.
    truth : the true association over these scans, for the comparison only.
    progress : called as ``progress(done, total)`` during refinement.

    Raises what `mht_slam.rank`, `mht_slam.refine` and `mht_slam.compare` raise.

    Source: docs/method.md, sections 3 and 4.
    """
    if isinstance(run, RunPair):
        ranking = rank(run, epsilon=epsilon, top_k=top_k, max_range=max_range)
    else:
        ranking = rank(run, epsilon=epsilon, top_k=top_k, max_range=max_range, scans=scans)
    posterior = refine(
        run,
        ranking,
        sigma=sigma,
        heading_sigma=heading_sigma,
        lateral_sigma=lateral_sigma,
        model=model,
        evidence=evidence,
        scale=scale,
        executor=executor,
        progress=progress,
    )
    return Solution(ranking, posterior, compare(ranking, posterior, truth))
