"""Ours beside the exhaustive peers: `refine` over the same (n!)^2 associations as theirs."""

from __future__ import annotations

from peer_graphs import full_tables

from mht_slam import Association, StraightRun, refine
from mht_slam.evaluation.bench.case import Assumptions
from mht_slam.evaluation.bench.methods import Method

OVER_ALL = "graph evidence over all (n!)^2"


def refine_over_all(run: StraightRun, assumptions: Assumptions) -> list[tuple[Association, float]]:
    """Weigh every full association by the graph's evidence; scores are probabilities."""
    tables = full_tables(len(run.scans[0]))
    everything = [Association(table, run.n_detections) for table in tables]
    posterior = refine(run, everything, model=assumptions.model)
    return [(h.association, h.probability) for h in posterior if h.failure is None]


METHOD = Method(refine_over_all, three_scans_only=True, weighs_candidates=False)
