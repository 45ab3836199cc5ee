"""One scene as a comparison sees it: a run, what may be assumed of it, and what is true of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

from mht_slam.arrays import FloatArray
from mht_slam.association import Association
from mht_slam.measurements import StraightRun
from mht_slam.models import ObservationModel
from mht_slam.pipeline import HEADING_COVERAGE, LARGEST_EPSILON


@dataclass(frozen=True)
class Assumptions:
    """All that a method may assume of a run besides its bearings.

    Attributes
    ----------
    epsilon : bound on a bearing's error, radians.
    model : noise, motion, landmarks and detections (`mht_slam.ObservationModel`).
    max_missed, max_false : the most missed and false detections of a table; 0 and 0 where every
        landmark is seen in every scan.
    candidates : associations that our graph and quadrature methods weigh, alike for all of them,
        in the order of their tables. Any method may use them, none has to. Empty for runs of more
        than three scans, and while candidates are not yet known.
    """

    epsilon: float
    model: ObservationModel
    max_missed: int = 0
    max_false: int = 0
    candidates: tuple[Association, ...] = ()

    @property
    def heading_wander(self) -> float:
        """Standard deviation of a heading from the direction of travel, radians."""
        smooth = self.model.motion == "smooth"
        return self.model.turn_sigma if smooth else self.model.heading_sigma

    @property
    def enlarged_epsilon(self) -> float:
        """Epsilon enlarged to cover wandering headings, radians: the paper's remedy for them.

        As `mht_slam.solve` does it: sqrt(epsilon^2 + (2 sigma_h)^2), up to 45 degrees.
        """
        wide = math.hypot(self.epsilon, HEADING_COVERAGE * self.heading_wander)
        return max(self.epsilon, min(wide, LARGEST_EPSILON))


@dataclass(frozen=True, eq=False)
class Case:
    """A run to associate, and the truth, which no method sees.

    Attributes
    ----------
    run, assumptions : what methods are given.
    truth : the true association over all scans of the run.
    poses : (m, 3) true x, y, theta in the run's frame: O1 = (0, 0), O2 = (1, 0).
    landmarks : (n, 2) true positions in that frame, one for each row of the truth's table.
    """

    run: StraightRun
    truth: Association
    assumptions: Assumptions
    poses: FloatArray
    landmarks: FloatArray


class CaseSource(Protocol):
    """Where cases come from: a cell of a sweep, or a set of recorded runs. Picklable."""

    @property
    def key(self) -> str:
        """One line that names the source in a store; different sources have different keys."""

    @property
    def name(self) -> str:
        """What the source is, for a reader."""

    @property
    def columns(self) -> dict[str, Any]:
        """The source's columns in tables, the name as "cell" among them."""

    def case(self, scene: int) -> Case:
        """Return the case of this number, the same one every time."""
