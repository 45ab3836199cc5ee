"""Peer: iterative landmark initialisation with delayed decisions, in the manner of Costa et al.

Written from the description of the idea, not from their code: keep every place where rays may meet,
decide only what is unambiguous, and let each decision sharpen what is known of the robot's motion,
so that more becomes unambiguous. The steps below, and all numbers, are ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from peer_registry import peer

from mht_slam import Association, StraightRun
from mht_slam.arrays import FloatArray
from mht_slam.evaluation.bench.case import Assumptions
from mht_slam.models import ObservationModel

GATE = 3.0
"""Standard deviations within which two log steps agree."""


@dataclass
class _LogStep:
    """What is known of the logarithm of the second step: mean and variance."""

    mean: float
    variance: float

    def distance(self, candidate: _Candidate) -> float:
        """Distance of the log step that a candidate implies, in standard deviations of both."""
        spread = np.sqrt(self.variance + candidate.variance)
        return float(abs(candidate.log_step - self.mean) / spread)

    def sharpened(self, candidate: _Candidate) -> _LogStep:
        """Both together."""
        gain = self.variance / (self.variance + candidate.variance)
        mean = self.mean + gain * (candidate.log_step - self.mean)
        return _LogStep(mean, (1.0 - gain) * self.variance)


@dataclass(frozen=True)
class _Candidate:
    """A detection of each scan that may be one landmark, and the log step that this implies."""

    detections: tuple[int, int, int]
    log_step: float
    variance: float

    def excludes(self, other: _Candidate) -> bool:
        """Whether both cannot be true: they share a detection."""
        return any(a == b for a, b in zip(self.detections, other.detections, strict=True))


@peer('delayed decisions, "in the manner of Costa et al."')
def delayed_decisions(
    run: StraightRun, assumptions: Assumptions
) -> list[tuple[Association, float]]:
    """Decide landmark after landmark, the unambiguous ones first; one association comes out.

    Two rays that meet, seen from O3 under a third bearing, imply the step from O2 to O3. A
    candidate stays while its step agrees with what is known. A detection that one candidate alone
    explains is decided, and its step is fused into what is known. Where none is, the candidate
    decides whose step the candidates of most other landmarks share, the closest agreement where
    several tie.
    """
    model = assumptions.model
    known = _LogStep(model.log_step_mean, model.log_step_sigma**2)
    open_ones = _candidates(run, model)
    decided = []
    while open_ones := [c for c in open_ones if known.distance(c) <= GATE]:
        choice = _unambiguous(open_ones, known) or _best_supported(open_ones, known)
        decided.append(choice.detections)
        known = known.sharpened(choice)
        open_ones = [c for c in open_ones if not choice.excludes(c)]
    return [(Association(np.array(decided).reshape(-1, 3), run.n_detections), 1.0)]


def _candidates(run: StraightRun, model: ObservationModel) -> list[_Candidate]:
    found = []
    bearings = [scan.bearings for scan in run.scans]
    for i, first in enumerate(bearings[0]):
        for j, second in enumerate(bearings[1]):
            for k, third in enumerate(bearings[2]):
                angles = np.array([first, second, third])
                if _meet(angles):
                    slopes = _log_step_slopes(angles)
                    variance = float(model.sigma**2 * slopes @ slopes)
                    found.append(_Candidate((i, j, k), _log_step(angles), variance))
    return found


def _meet(angles: FloatArray) -> bool:
    """Whether the rays of O1 and O2 meet, and that of an O3 ahead of O2 can pass there.

    On the left of the path bearings only grow while a landmark is passed, on the right they fall.
    """
    side = np.sign(angles)
    return bool((side == side[0]).all() and (np.diff(side * angles) > 0.0).all() and side[0] != 0.0)


def _log_step(angles: FloatArray) -> float:
    """Ln |O2 O3| at which rays with these three bearings share a point (docs/method.md, 2)."""
    c1, c2, c3 = 1.0 / np.tan(angles)
    return float(np.log((c2 - c3) / (c1 - c2)))


def _log_step_slopes(angles: FloatArray) -> FloatArray:
    """(3,) change of the log step with each bearing."""
    c1, c2, c3 = 1.0 / np.tan(angles)
    by_cotangent = np.array([-1.0 / (c1 - c2), 1.0 / (c2 - c3) + 1.0 / (c1 - c2), -1.0 / (c2 - c3)])
    return np.asarray(-by_cotangent / np.sin(angles) ** 2)


def _unambiguous(candidates: list[_Candidate], known: _LogStep) -> _Candidate | None:
    """Of the candidates that alone explain a detection, the one that agrees best; None if none."""
    alone = []
    for scan in range(3):
        by_detection: dict[int, list[_Candidate]] = {}
        for candidate in candidates:
            by_detection.setdefault(candidate.detections[scan], []).append(candidate)
        alone += [group[0] for group in by_detection.values() if len(group) == 1]
    return min(alone, key=known.distance, default=None)


def _best_supported(candidates: list[_Candidate], known: _LogStep) -> _Candidate:
    def support(candidate: _Candidate) -> tuple[int, float]:
        fused = known.sharpened(candidate)
        nearest: dict[int, float] = {}
        for other in candidates:
            if not candidate.excludes(other):
                first, distance = other.detections[0], fused.distance(other)
                nearest[first] = min(nearest.get(first, GATE), distance)
        agreeing = [distance for distance in nearest.values() if distance < GATE]
        return -len(agreeing), sum(agreeing)

    return min(candidates, key=support)
