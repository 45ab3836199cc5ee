"""How far an estimated map is from the true one, and whether it has the same landmarks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from mht_slam.arrays import FloatArray
from mht_slam.association import MISSED, Association

CUTOFF = 2.0
"""Baselines: an error as large as this, or two landmarks of which one has no partner."""


class LandmarkCounts(NamedTuple):
    """Landmarks that estimate and truth have in common, one to one, and those of each."""

    matched: int
    estimated: int
    true: int

    @property
    def one_to_one(self) -> bool:
        """Whether every landmark of either has its partner in the other."""
        return self.matched == self.estimated == self.true


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
    matched = _matched_distances(estimated, true, cutoff)
    return float(matched.sum()) + 0.5 * cutoff * abs(len(estimated) - len(true))


def matched_by_position(
    estimated: npt.ArrayLike, true: npt.ArrayLike, cutoff: float
) -> LandmarkCounts:
    """Match (k, 2) landmarks with (n, 2) true ones nearer than `cutoff`, in one frame.

    The matching is that of `gospa`.
    """
    ours = np.asarray(estimated, dtype=np.float64).reshape(-1, 2)
    theirs = np.asarray(true, dtype=np.float64).reshape(-1, 2)
    near = _matched_distances(ours, theirs, cutoff) < cutoff
    return LandmarkCounts(int(near.sum()), len(ours), len(theirs))


def matched_by_detections(
    answer: Association, truth: Association, *, shortest: int
) -> LandmarkCounts:
    """Match the landmarks of an answer with true ones by the detections they share.

    Two are partners when each has more than half of its detections in the other. Those with fewer
    than `shortest` detections are no landmarks of the answer, and nobody has to find those of the
    truth, though a landmark of the answer may be one of them.
    """
    sizes = (answer.table != MISSED).sum(axis=1)
    true_sizes = (truth.table != MISSED).sum(axis=1)
    mine, theirs = answer.flat_labels(), truth.flat_labels()
    both = (mine != MISSED) & (theirs != MISSED)
    pairs, shared = np.unique(np.stack([mine[both], theirs[both]]), axis=1, return_counts=True)
    partners = (2 * shared > sizes[pairs[0]]) & (2 * shared > true_sizes[pairs[1]])
    confirmed = partners & (sizes[pairs[0]] >= shortest)
    found = set(pairs[1][confirmed].tolist())
    wanted = set(np.flatnonzero(true_sizes >= shortest).tolist())
    return LandmarkCounts(
        matched=len(found), estimated=int((sizes >= shortest).sum()), true=len(wanted | found)
    )


def _matched_distances(estimated: FloatArray, true: FloatArray, cutoff: float) -> FloatArray:
    """Distances in the best matching, at most `cutoff`.

    A pair beyond the cutoff costs as much as two landmarks left alone.
    """
    distances = np.minimum(np.linalg.norm(estimated[:, None] - true, axis=2), cutoff)
    return np.asarray(distances[linear_sum_assignment(distances)])
