"""The posterior over the open scans, made when somebody looks at it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import overload

import numpy as np

from mht_slam.arrays import FloatArray, freeze
from mht_slam.hypotheses import Hypothesis, Posterior
from mht_slam.incremental.branch import Branch, Window
from mht_slam.incremental.history import association_of
from mht_slam.incremental.past import point_jacobians, points_of
from mht_slam.incremental.smoother import inverse_root
from mht_slam.models import ObservationModel

RANGED = 1.0
"""Deviation of its log range beyond which a landmark's distance is the prior's."""


class OnDemand(Sequence[Hypothesis]):
    """Hypotheses of which each is made when it is first asked for."""

    def __init__(self, count: int, make: Callable[[int], Hypothesis]) -> None:
        self._make = make
        self._made: list[Hypothesis | None] = [None] * count

    def __len__(self) -> int:
        return len(self._made)

    @overload
    def __getitem__(self, index: int) -> Hypothesis: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Hypothesis, ...]: ...
    def __getitem__(self, index: int | slice) -> Hypothesis | tuple[Hypothesis, ...]:
        if isinstance(index, slice):
            return tuple(self._at(i) for i in range(len(self))[index])
        return self._at(range(len(self))[index])

    def __iter__(self) -> Iterator[Hypothesis]:
        return (self._at(i) for i in range(len(self)))

    def _at(self, index: int) -> Hypothesis:
        made = self._made[index]
        if made is None:
            made = self._made[index] = self._make(index)
        return made


def live_posterior(
    branches: Sequence[Branch], window: Window, model: ObservationModel
) -> Posterior:
    """Return the branches as hypotheses over the open scans, the best first.

    Probabilities are over the branches kept. Rows of an association are the landmarks that two open
    scans see; estimates are those given everything before, in the frame of the first pose. Evidence
    is up to a constant that all of them share.
    """
    probabilities = _probabilities(branches)

    def make(index: int) -> Hypothesis:
        return _hypothesis(branches[index], float(probabilities[index]))

    return Posterior(
        hypotheses=OnDemand(len(branches), make),
        scans=tuple(range(window.first, window.first + len(window.bearings))),
        model=model,
        unit="metre" if model.motion == "odometry" else "baseline",
    )


def _probabilities(branches: Sequence[Branch]) -> FloatArray:
    if not branches:
        return np.empty(0)
    scores = np.array([branch.log_score for branch in branches])
    scores -= np.round(scores.max(), -6)  # of millions of nats no digits are left for differences
    return np.asarray(np.exp(scores - np.logaddexp.reduce(scores)))


def _hypothesis(branch: Branch, probability: float) -> Hypothesis:
    association, numbers = association_of(branch.owners)
    at = {number: i for i, number in enumerate(branch.ids.tolist())}
    chosen = np.array([at[number] for number in numbers.tolist()], np.int64)
    spread = inverse_root(branch.root)
    covariance = spread @ spread.T
    poses = len(branch.poses)
    first = 3 * (poses - 1)
    jacobians = point_jacobians(branch.places[chosen])
    blocks = np.array(
        [covariance[i : i + 2, i : i + 2] for i in (first + 2 * chosen).tolist()]
    ).reshape(-1, 2, 2)
    starts = [3 * k for k in range(2, poses - 1)] + [len(covariance) - 3]
    return Hypothesis(
        association=association,
        score=None,
        log_likelihood=None,
        log_evidence=branch.log_score,
        probability=probability,
        poses=freeze(branch.poses[2:].copy()),
        landmarks=freeze(points_of(branch.places[chosen], branch.centres[chosen])),
        landmark_covariances=freeze(jacobians @ blocks @ jacobians.transpose(0, 2, 1)),
        pose_covariances=freeze(np.array([covariance[i : i + 3, i : i + 3] for i in starts])),
        ranged=freeze(branch.log_range_deviations[chosen] < RANGED),
    )


def marginal_owners(branches: Sequence[Branch], scan: int) -> list[dict[int, float]]:
    """Return, for each detection of an open scan, the probability of each landmark, -1 for none."""
    if not branches[0].owners:  # before the first scan
        return []
    probabilities = _probabilities(branches)
    found: list[dict[int, float]] = [{} for _ in branches[0].owners[scan]]
    for branch, p in zip(branches, probabilities.tolist(), strict=True):
        for detection, number in enumerate(branch.owners[scan].tolist()):
            found[detection][number] = found[detection].get(number, 0.0) + p
    return found
