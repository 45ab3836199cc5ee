"""Polygon score against graph evidence: `compare`, one row per hypothesis."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.stats import kendalltau

from mht_slam.association import Association
from mht_slam.errors import AssociationError, OptionError
from mht_slam.hypotheses import Posterior, Ranking


@dataclass(frozen=True)
class ComparisonRow:
    """One association under both scores. Ranks start at 1; None where a score is missing."""

    association: Association
    polygon_score: float | None
    polygon_rank: int | None
    log_likelihood: float | None
    log_evidence: float
    evidence_rank: int
    probability: float


@dataclass(frozen=True)
class Comparison:
    """The polygon ranking and the posterior side by side.

    Attributes
    ----------
    rows : in the posterior's order, most probable first.
    kendall_tau : Kendall's tau-b between polygon score and log evidence over the rows that have
        both (finite); None where it is undefined (fewer than two, or all tied).
    top1_agree : whether both put the same association first; False where either is empty.
    truth_polygon_rank, truth_evidence_rank : rank of the truth, None when it is not given or not
        among the candidates.
    """

    rows: tuple[ComparisonRow, ...]
    kendall_tau: float | None
    top1_agree: bool
    truth_polygon_rank: int | None
    truth_evidence_rank: int | None


def compare(ranking: Ranking, posterior: Posterior, truth: Association | None = None) -> Comparison:
    """Compare how the polygon method and the factor graph order the associations.

    `truth` is an association over the ranking's scans. Raises `AssociationError` where the three
    do not speak of the same scans, and `OptionError` for a ranking or posterior that is none.
    """
    if not isinstance(ranking, Ranking):
        raise OptionError(f"ranking is {type(ranking).__name__}: give a Ranking")
    if not isinstance(posterior, Posterior):
        raise OptionError(f"posterior is {type(posterior).__name__}: give a Posterior")
    if len(ranking) and len(posterior) and ranking.scans != posterior.scans:
        raise AssociationError(
            f"the ranking is over scans {ranking.scans} and the posterior over {posterior.scans}: "
            "compare results of the same scans"
        )
    polygon_rank = {h.association: rank for rank, h in enumerate(ranking, start=1)}
    polygon_score = {h.association: h.score for h in ranking}
    rows = tuple(
        ComparisonRow(
            association=h.association,
            polygon_score=polygon_score.get(h.association, h.score),
            polygon_rank=polygon_rank.get(h.association),
            log_likelihood=h.log_likelihood,
            log_evidence=h.log_evidence,
            evidence_rank=rank,
            probability=h.probability,
        )
        for rank, h in enumerate(posterior, start=1)
    )
    return Comparison(
        rows=rows,
        kendall_tau=_kendall_tau(rows),
        top1_agree=bool(
            len(ranking)
            and len(posterior)
            and posterior[0].failure is None
            and ranking[0].association == posterior[0].association
        ),
        truth_polygon_rank=rank_of_truth([h.association for h in ranking], truth),
        truth_evidence_rank=rank_of_truth([h.association for h in posterior], truth),
    )


def rank_of_truth(associations: Iterable[Association], truth: Association | None) -> int | None:
    """Rank, from 1, of the first association with the truth's pairs of detections.

    None where none has them, or no truth is given. Raises `AssociationError` for associations of
    other scans.
    """
    if truth is None:
        return None
    for rank, association in enumerate(associations, start=1):
        if association.exact(truth):
            return rank
    return None


def _kendall_tau(rows: tuple[ComparisonRow, ...]) -> float | None:
    scored = [
        (row.polygon_score, row.log_evidence)
        for row in rows
        if row.polygon_score is not None and np.isfinite(row.log_evidence)
    ]
    if len(scored) < 2:
        return None
    polygon, evidence = np.array(scored).T
    tau = float(kendalltau(polygon, evidence).statistic)
    return tau if np.isfinite(tau) else None
