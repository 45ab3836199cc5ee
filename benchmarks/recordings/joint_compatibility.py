"""Baseline: EKF-SLAM that takes the largest set of jointly compatible pairs of each scan.

J. Neira, J. D. Tardos, "Data association in stochastic mapping using the joint compatibility test",
IEEE Transactions on Robotics and Automation 17(6), 2001.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import ekf_slam
import numpy as np
from drive_scores import Answer
from scipy.stats import chi2

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.datasets import Drive
from mht_slam.models import ObservationModel

OPTIONS = tuple(
    f"level {level}, parallax {parallax} deg"
    for level in (0.95, 0.99, 0.999)
    for parallax in ekf_slam.PARALLAXES_DEG
)
"""Chance that true pairs pass the test, alone and together, and parallax of a new landmark."""
MOST_NODES = 2000
"""Partial pairings looked at in a scan, the nearest first; the best so far is taken then."""
MOST_DETECTIONS = 40


def answer(drive: Drive, model: ObservationModel, option: str) -> Answer:
    """Branch and bound over the detections of each scan."""
    _, level, _, parallax, _ = option.replace(",", "").split()
    gates = chi2.ppf(float(level), np.arange(1, MOST_DETECTIONS + 1))

    def pair(innovations: FloatArray, joint: FloatArray) -> IntArray:
        return Search(innovations, joint, gates).best

    return ekf_slam.run(drive, model, pair, np.deg2rad(float(parallax)))


@dataclass
class Search:
    """One scan's search: most pairs first, then the least joint distance.

    Attributes
    ----------
    innovations, joint : of `ekf_slam.Pairing`.
    gates : (MOST_DETECTIONS,) largest joint distance of one pair, two pairs, ...
    best : (d,) the landmark of each detection, -1 for none.
    """

    innovations: FloatArray
    joint: FloatArray
    gates: FloatArray
    best: IntArray = field(init=False)

    def __post_init__(self) -> None:
        alone = self.innovations**2 / (np.diag(self.joint) + 1.0)
        self._options = [
            [int(i) for i in np.argsort(row) if row[i] < self.gates[0]] for row in alone
        ]
        # The detections with the fewest options first: there the branches are few.
        self._order = sorted(range(len(alone)), key=lambda j: len(self._options[j]))
        self._order = [j for j in self._order if self._options[j]][:MOST_DETECTIONS]
        self._key = (0, 0.0)
        self._nodes = 0
        self.best = np.full(len(alone), MISSED, dtype=np.int64)
        self._branch(0, [], 0.0)

    def _branch(self, depth: int, pairs: list[tuple[int, int]], distance: float) -> None:
        self._nodes += 1
        if (len(pairs), -distance) > self._key:
            self._key = len(pairs), -distance
            self.best[:] = MISSED
            for j, landmark in pairs:
                self.best[j] = landmark
        left = len(self._order) - depth
        if left == 0 or self._nodes > MOST_NODES or len(pairs) + left < self._key[0]:
            return
        j = self._order[depth]
        taken = {landmark for _, landmark in pairs}
        for landmark in self._options[j]:
            if landmark not in taken:
                longer = [*pairs, (j, landmark)]
                joint = self._joint_distance(longer)
                if joint < self.gates[len(pairs)]:
                    self._branch(depth + 1, longer, joint)
        self._branch(depth + 1, pairs, distance)

    def _joint_distance(self, pairs: list[tuple[int, int]]) -> float:
        detections, landmarks = (list(part) for part in zip(*pairs, strict=True))
        innovation = self.innovations[detections, landmarks]
        covariance = self.joint[np.ix_(landmarks, landmarks)] + np.eye(len(pairs))
        return float(innovation @ np.linalg.solve(covariance, innovation))
