"""Scored associations: what the polygon method ranks and what the factor graph weighs.

A *ranked association* carries its polygon score; a *hypothesis* is an association with its
estimate, likelihood, evidence and probability. `Ranking` and `Posterior` are the ordered lists.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray, finite_number, freeze
from mht_slam.association import MISSED, Association
from mht_slam.errors import NoEstimateError
from mht_slam.models import ObservationModel

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry


@dataclass(frozen=True)
class MapRegion:
    """Where one thing lies in the landmark frame, as each pair of scans sees it.

    Attributes
    ----------
    name : "landmark 0", ... (the association's row), or "O1", "O2", ... (observation points).
    by_pair : the region of each pair of scans that sees the thing, keyed by the pair's scans; a
        base landmark is a point.
    intersection : what all those regions share; may be empty.
    """

    name: str
    by_pair: tuple[tuple[tuple[int, int], BaseGeometry], ...]
    intersection: BaseGeometry


@dataclass(frozen=True)
class LandmarkFrameMap:
    """A map in F_L, the frame with two base landmarks at (0, 0) and (1, 0).

    Attributes
    ----------
    base : rows of the association's table that are the two base landmarks.
    landmarks : a `MapRegion` for each row that is seen in every pair.
    observation_points : a `MapRegion` for each observation point.
    cut : whether any cell behind the regions was unbounded and cut at `max_range`.
    """

    base: tuple[int, int]
    landmarks: tuple[MapRegion, ...]
    observation_points: tuple[MapRegion, ...]
    cut: bool


@dataclass(frozen=True)
class RankedAssociation:
    """An association with the score of the polygon method.

    Attributes
    ----------
    association : over the ranking's scans.
    score : geometric mean of the intersection ratios, in [0, 1].
    base : detections of the middle scan (of s2 for a `RunPair`) whose landmarks carried F_L; None
        where the hypothesis has no such two, seen in every scan beside a third. Their rows of the
        table are `map_in_landmark_frame`'s `base`.
    zero_reason : why the score is zero, or None when it is not.
    """

    association: Association
    score: float
    base: tuple[int, int] | None
    zero_reason: str | None = None
    _draw_map: Callable[[], LandmarkFrameMap] | None = field(
        default=None, repr=False, compare=False
    )

    @property
    def map_in_landmark_frame(self) -> LandmarkFrameMap | None:
        """Regions of landmarks and observation points from both pairs, and what they share.

        Drawn on demand; None where the base cells are missing or overlap, so that F_L does not
        exist.
        """
        return None if self._draw_map is None else self._draw_map()


@dataclass(frozen=True)
class Ranking(Sequence[RankedAssociation]):
    """Associations ranked by the polygon method, best first.

    Attributes
    ----------
    hypotheses : best first. Order: landmarks seen in every scan (more first), score rounded to
        1e-12 (higher first), table row by row.
    scans : indices of the run's scans that the associations' columns stand for.
    base : detection indices, in the middle scan of a run (in s2 of a `RunPair`), of the base
        landmarks that were chosen for full tables or given by the caller.
    complete : whether nothing unlisted comes before the last one in this order.
    gap : upper bound on the score of anything unlisted that would come before the last one, minus
        the last listed score; 0.0 if complete.
    epsilon : the vision error, radians.
    options : the remaining options of the call, by name.
    n_scored : how many times an association was scored on its own.
    n_steps : steps of an exact search: choices of base cells bounded, intersection ratios computed,
        partial hypotheses extended and hypotheses scored.
    """

    hypotheses: tuple[RankedAssociation, ...]
    scans: tuple[int, ...]
    base: tuple[int, int]
    complete: bool
    gap: float
    epsilon: float
    options: dict[str, Any] = field(default_factory=dict)
    n_scored: int = 0
    n_steps: int = 0

    def __len__(self) -> int:
        return len(self.hypotheses)

    @overload
    def __getitem__(self, index: int) -> RankedAssociation: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[RankedAssociation, ...]: ...
    def __getitem__(self, index: int | slice) -> RankedAssociation | tuple[RankedAssociation, ...]:
        return self.hypotheses[index]

    def __iter__(self) -> Iterator[RankedAssociation]:
        return iter(self.hypotheses)


@dataclass(frozen=True)
class Hypothesis:
    """An association with its scores and its estimate from the factor graph.

    Arrays are None where `failure` is not None, and where only the evidence was asked for. Frame:
    the run's (of a `RunPair` the first one's), O1 = (0, 0) and O2 one baseline along +x; the unit
    is the posterior's.

    Attributes
    ----------
    association : over the posterior's scans.
    score : the polygon score, or None when the candidate came without one.
    log_likelihood : normalised bearing and false-alarm terms at the estimate, priors left out; None
        where no estimate was made.
    log_evidence : evidence with every normaliser, taken as asked for; -inf for a failure.
    probability : over the candidates given.
    failure : why there is no estimate, or None.
    poses : (m, 3) x, y, theta of each scan.
    landmarks : (n, 2), one row per row of the association's table.
    landmark_covariances : (n, 2, 2) marginals. A landmark seen once has the prior's.
    pose_covariances : (m, 3, 3) marginals in run axes, order x, y, theta.
    log_evidence_error : standard error of `log_evidence`: 0.0 where the integral is a sum that is
        exact to rounding, from the sample where it was sampled, None where it is plain Laplace.
    ranged : (n,) bool, False for a landmark seen once: its distance is the prior's.
    """

    association: Association
    score: float | None
    log_likelihood: float | None
    log_evidence: float
    probability: float
    failure: str | None = None
    poses: FloatArray | None = field(default=None, repr=False, compare=False)
    landmarks: FloatArray | None = field(default=None, repr=False, compare=False)
    landmark_covariances: FloatArray | None = field(default=None, repr=False, compare=False)
    pose_covariances: FloatArray | None = field(default=None, repr=False, compare=False)
    ranged: BoolArray | None = field(default=None, repr=False, compare=False)
    log_evidence_error: float | None = None
    _build_graph: Callable[[], tuple[Any, Any, Any]] | None = field(
        default=None, repr=False, compare=False
    )

    def to_gtsam(self) -> tuple[Any, Any, Any]:
        """Return (NonlinearFactorGraph, Values, keys): go on in GTSAM from here.

        ``keys.scans[i]`` is the key of scan i's Pose2 and ``keys.landmarks[l]`` that of landmark
        l's Point2; the values are the estimate. Raises `NoEstimateError` for a failed hypothesis.
        """
        if self._build_graph is None:
            reason = self.failure or "only its evidence was taken; refine makes estimates"
            raise NoEstimateError(f"the hypothesis has no estimate: {reason}")
        return self._build_graph()


@dataclass(frozen=True)
class Posterior(Sequence[Hypothesis]):
    """Hypotheses with probabilities over the candidates given, most probable first.

    Attributes
    ----------
    hypotheses : sorted by probability, failures last.
    scans : indices of the run's scans that the associations' columns stand for.
    model : the `ObservationModel` behind every number.
    unit : "baseline" or "metre".
    covered : bound on the probability outside the candidates, or None when nothing is known.
    complete : whether nothing unlisted has more evidence than the last one listed, proven for the
        discretised evidence; None where nobody searched.
    """

    hypotheses: Sequence[Hypothesis]
    scans: tuple[int, ...]
    model: ObservationModel
    unit: str = "baseline"
    covered: float | None = None
    complete: bool | None = None

    def __len__(self) -> int:
        return len(self.hypotheses)

    @overload
    def __getitem__(self, index: int) -> Hypothesis: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Hypothesis, ...]: ...
    def __getitem__(self, index: int | slice) -> Hypothesis | tuple[Hypothesis, ...]:
        return tuple(self.hypotheses[index]) if isinstance(index, slice) else self.hypotheses[index]

    def __iter__(self) -> Iterator[Hypothesis]:
        return iter(self.hypotheses)

    @property
    def detections(self) -> IntArray:
        """(N, 2) pairs (scan, detection) in the order of `marginal_same_landmark`, scan-major.

        Scan counts the run's scans, so that it indexes the caller's own list.
        """
        if not self.hypotheses:
            return np.empty((0, 2), dtype=np.int64)
        counts = self.hypotheses[0].association.n_detections
        rows = [
            (scan, detection)
            for scan, count in zip(self.scans, counts, strict=True)
            for detection in range(count)
        ]
        return np.array(rows, dtype=np.int64).reshape(-1, 2)

    def marginal_same_landmark(self) -> FloatArray:
        """(N, N) probability that two detections are one landmark, over the candidates.

        The diagonal is 1. Where every candidate failed, the rest is 0.
        """
        n = len(self.detections)
        marginal = np.zeros((n, n))
        for hypothesis in self.hypotheses:
            labels = hypothesis.association.flat_labels()
            same = (labels[:, None] == labels) & (labels != MISSED)
            marginal += hypothesis.probability * same
        np.fill_diagonal(marginal, 1.0)
        return freeze(np.minimum(marginal, 1.0))

    def undecided_pairs(self, level: float = 0.95) -> IntArray:
        """(k, 2) pairs of detections that are one landmark with neither high nor low probability.

        Rows hold two indices into `detections`, the first smaller, whose marginal probability lies
        between 1 - `level` and `level`: landmarks too close for the model to tell, or detections
        that may be false. Raises `OptionError` unless 0.5 < level < 1.
        """
        finite_number(level, "level", above=0.5, below=1.0)
        marginal = self.marginal_same_landmark()
        open_ = np.triu((marginal > 1.0 - level) & (marginal < level), 1)
        return np.argwhere(open_).astype(np.int64)

    def credible_set(self, level: float = 0.95) -> tuple[Hypothesis, ...]:
        """Return the fewest hypotheses whose probabilities sum to at least `level`.

        Raises `OptionError` unless 0 < level <= 1. Empty when every candidate failed.
        """
        finite_number(level, "level", above=0.0, at_most=1.0)
        total = 0.0
        chosen = []
        for hypothesis in self.hypotheses:
            if total >= level or hypothesis.probability == 0.0:
                break
            chosen.append(hypothesis)
            total += hypothesis.probability
        return tuple(chosen)

    def entropy(self) -> float:
        """Entropy of the probabilities, nats: exp of it is the effective number of hypotheses."""
        p = np.array([h.probability for h in self.hypotheses if h.probability > 0.0])
        return float(-(p * np.log(p)).sum()) if len(p) else 0.0
