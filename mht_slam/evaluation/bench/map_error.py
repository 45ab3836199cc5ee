"""How far the map of an association is from the true one."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from mht_slam.arrays import FloatArray
from mht_slam.association import Association
from mht_slam.errors import MhtSlamError
from mht_slam.evaluation.bench.case import Case
from mht_slam.graph.refine import refine

CUTOFF = 2.0
"""Baselines: an error as large as this, or two landmarks of which one has no partner."""


def gospa(estimated: FloatArray, true: FloatArray, cutoff: float = CUTOFF) -> float:
    """Sum of the matched landmarks' errors, and half a cutoff for each landmark left over.

    GOSPA with p = 1 and alpha = 2 (A. S. Rahmathullah, A. F. Garcia-Fernandez, L. Svensson,
    "Generalized optimal sub-pattern assignment metric", 2017): the least sum over matchings of
    min(|x - y|, cutoff) + cutoff / 2 per landmark without a partner.

    Parameters
    ----------
    estimated, true : (k, 2) and (n, 2) positions in one frame.
    cutoff : in the unit of the positions.

    >>> gospa(np.array([[0.0, 0.5]]), np.array([[0.0, 0.0], [9.0, 9.0]]))
    1.5
    """
    distances = np.linalg.norm(estimated[:, None] - true, axis=2)
    # A pair beyond the cutoff costs as much as two landmarks left alone.
    rows, columns = linear_sum_assignment(np.minimum(distances, cutoff))
    matched = float(np.minimum(distances, cutoff)[rows, columns].sum())
    return matched + 0.5 * cutoff * abs(len(estimated) - len(true))


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
