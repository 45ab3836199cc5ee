"""How far the map of an association is from the true one."""

from __future__ import annotations

import numpy as np

from mht_slam.association import Association
from mht_slam.errors import MhtSlamError
from mht_slam.evaluation.bench.case import Case
from mht_slam.evaluation.landmark_maps import gospa
from mht_slam.graph.refine import refine


def map_error(association: Association, case: Case) -> float:
    """`gospa` of the graph's map of an association, baselines, in the run's frame.

    Landmarks seen once have no range and are no part of the map. Where the graph finds no estimate
    the map is empty, and all landmarks are missed.
    """
    seen_often = np.asarray((case.truth.table >= 0).sum(axis=1) >= 2)
    true = case.landmarks[seen_often]
    try:
        best = refine(case.run, [association], model=case.assumptions.model, evidence="laplace")[0]
    except MhtSlamError:
        return gospa(np.empty((0, 2)), true)
    if best.landmarks is None or best.ranged is None:
        return gospa(np.empty((0, 2)), true)
    return gospa(best.landmarks[best.ranged], true)
