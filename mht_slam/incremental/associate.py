"""Children of a branch: the best associations of the next scan over all proposed poses."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray
from mht_slam.association import MISSED
from mht_slam.incremental.branch import Branch, Window, extended
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.prediction import (
    best_choices,
    bounds_of,
    match_gains,
    pair_gains,
    relative_landmarks,
)
from mht_slam.incremental.steps import Proposals
from mht_slam.matchings import Matches, ranked_matchings
from mht_slam.models import Motion

CERTAIN = 1.0 - 1e-9
"""The greatest chance of a detection: misses stay possible."""
ARRIVING = 0.02
"""Share of the landmarks in view that are new in a scan, at least: where none leaves for good, the
robot's motion still brings others into view."""
MOST_NODES = 2000
"""Steps of the depth-first search for the best matchings before Murty's ranking takes over."""
NEAREST_BASELINES, NEAREST_METRES = 0.3, 0.03
"""Shortest range tried for a landmark seen once, by the unit of the run."""


@dataclass(frozen=True, eq=False)
class Weights:
    """Log weights of detections by scan, from the observation model.

    A detection on its own is a landmark seen once or a false alarm, a constant weight in both
    readings (docs/method.md, section 5). `first` holds for the first scan of a run, where every
    landmark in view is new, `later` for all others.
    """

    first_landmark: float
    first_alone: float
    later_landmark: float
    later_alone: float

    @classmethod
    def of(cls, config: SlamConfig) -> Weights:
        """Return the weights of a configuration."""
        model = config.observation_model
        chance, rate = model.detection_probability, model.false_alarm_rate
        expected = model.expected_landmarks
        assert chance is not None and rate is not None and expected is not None  # noqa: S101
        coming = expected * max(1.0 - model.stay_probability, ARRIVING)
        return cls(
            first_landmark=math.log(expected * chance),
            first_alone=math.log(expected * chance / (2.0 * math.pi) + rate),
            later_landmark=math.log(coming * chance),
            later_alone=math.log(coming * chance / (2.0 * math.pi) + rate),
        )

    def landmark(self, scan: int) -> float:
        """Log of the expected number of landmarks first detected in a scan."""
        return self.later_landmark if scan else self.first_landmark

    def alone(self, scan: int) -> float:
        """Log weight, per radian, of a detection on its own."""
        return self.later_alone if scan else self.first_alone


@dataclass(frozen=True, eq=False)
class Option:
    """A child to be.

    Attributes
    ----------
    log_score : expected.
    prediction : of its parent.
    matches : rows are landmarks, then earlier single detections; columns detections.
    proposal : the motion at which it does best.
    """

    log_score: float
    prediction: Prediction
    matches: Matches
    proposal: int


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a branch expects of the next scan.

    Attributes
    ----------
    branch : the parent.
    proposals : motions tried.
    relative : (n, 2) landmarks in the frame of the last pose.
    chances : (n,) of detection, if in view.
    visible : (n,) chance of being in view.
    if_missed : (n,) that chance after a scan that should have seen the landmark and did not.
    singles : open scan and detection of those that may become landmarks.
    table : (G, n + s, d) log gains; offsets : (G,) log scores without any match.
    log_together : (s,) what a pair's pattern adds.
    """

    branch: Branch
    proposals: Proposals
    relative: FloatArray
    chances: FloatArray
    visible: FloatArray
    if_missed: FloatArray
    singles: list[tuple[int, int]]
    table: FloatArray
    offsets: FloatArray
    log_together: FloatArray


class Floor:
    """The score below which a child is not worth listing: too far behind, or one too many.

    Parameters
    ----------
    count : children that will be solved.
    drop : nats behind the best.
    """

    def __init__(self, count: int, drop: float) -> None:
        self._best: list[float] = []
        self._count, self._drop = count, drop
        self.value = -math.inf

    def raise_by(self, score: float) -> None:
        """Take note of a child's score."""
        if len(self._best) < self._count:
            heapq.heappush(self._best, score)
        else:
            heapq.heappushpop(self._best, score)
        weakest = self._best[0] if len(self._best) == self._count else -math.inf
        self.value = max(self.value, weakest, score - self._drop)


def predict(
    branch: Branch, window: Window, proposals: Proposals, config: SlamConfig, weights: Weights
) -> Prediction:
    """Score every match of the newest scan of the window, at every motion worth trying."""
    model = config.observation_model
    newest = len(window.bearings) - 1
    bearings, sigmas = window.bearings[newest], window.sigmas[newest]
    dof = math.inf if model.bearing_dof is None else model.bearing_dof
    stay, back = model.stay_probability, config.return_probability
    assert model.detection_probability is not None  # noqa: S101 - checked by the configuration
    visible = stay * branch.visible + (1.0 - branch.visible) * back
    chances = np.minimum(visible * model.detection_probability, CERTAIN)
    relative, covariances = relative_landmarks(
        branch.poses[-1], branch.places, branch.centres, branch.last_root
    )
    singles = _singles(branch, newest, config.pair_within)
    count = len(proposals.motions)
    n = len(branch.ids)
    table = np.empty((count, n + len(singles), len(bearings)))
    missed = np.empty(count)
    alone = weights.alone(window.first + newest)
    match_gains(
        proposals.motions,
        proposals.turn_spread,
        proposals.side_spreads,
        relative,
        covariances,
        chances,
        0.5 * model.field_of_view,
        math.inf if config.sight is None else config.sight,
        bearings,
        sigmas,
        alone,
        dof,
        table,
        missed,
    )
    log_together = np.empty(len(singles))
    if singles:
        here = branch.poses[-1]
        rays, spreads = np.empty((len(singles), 3)), np.empty(len(singles))
        for i, (scan, detection) in enumerate(singles):
            pose = branch.poses[scan + 2]
            rays[i] = pose[0], pose[1], pose[2] + window.bearings[scan][detection]
            spreads[i] = window.sigmas[scan][detection]
            number = window.first + scan
            gap = newest - scan
            log_together[i] = (
                weights.landmark(number)
                - weights.alone(number)
                - math.log(2.0 * math.pi)
                + log_seen_again(model.detection_probability, stay, back, gap)
                - alone
            )
        c, s = math.cos(here[2]), math.sin(here[2])
        away = rays[:, :2] - here[:2]
        rays[:, 0], rays[:, 1] = c * away[:, 0] + s * away[:, 1], c * away[:, 1] - s * away[:, 0]
        rays[:, 2] -= here[2]
        pair_gains(
            proposals.motions,
            proposals.turn_spread,
            proposals.side_spreads,
            rays,
            spreads,
            log_together,
            model.landmark_sigma,
            shortest_range(model.motion),
            bearings,
            sigmas,
            dof,
            table,
            n,
        )
    offsets = proposals.log_prior + missed + branch.log_score + len(bearings) * alone
    return Prediction(
        branch=branch,
        proposals=proposals,
        relative=relative,
        chances=chances,
        visible=visible,
        if_missed=np.maximum((visible - chances) / (1.0 - chances), 0.0),
        singles=singles,
        table=table,
        offsets=offsets,
        log_together=log_together,
    )


def _options(
    prediction: Prediction, bounds: FloatArray, config: SlamConfig, floor: Floor
) -> list[Option]:
    """Return the children of a branch that may be worth solving, in no order.

    Given the pose, matches are independent but for sharing: at each proposal the best matching is
    sought, at the best few of them also the next ones. A matching that several proposals find
    counts once, where it does best.
    """
    best: dict[Matches, tuple[float, int]] = {}
    for rank, g in enumerate(np.argsort(-bounds, kind="stable").tolist()):
        if bounds[g] < floor.value:
            break
        offset = float(prediction.offsets[g])
        depth = config.depth if rank < config.ranked else 1
        for named, gain in _best_matchings(prediction.table[g], depth, floor.value - offset):
            score = offset + gain
            if score < floor.value:
                break
            if named not in best:
                floor.raise_by(score)
                best[named] = score, g
            elif score > best[named][0]:
                best[named] = score, g
    return [Option(score, prediction, named, g) for named, (score, g) in best.items()]


def _best_matchings(gains: FloatArray, depth: int, floor: float) -> Iterator[tuple[Matches, float]]:
    """Yield the best matchings with their gains, by Murty's ranking where there is much choice."""
    count, totals, rows = best_choices(gains, depth, floor, MOST_NODES)
    if count < 0:
        positive = np.maximum(gains, 0.0)
        some = np.flatnonzero(positive.any(axis=1))
        for matches, gain in islice(ranked_matchings(positive[some]), depth):
            yield tuple((int(some[r]), d) for r, d in matches), gain
        return
    for total, chosen in zip(totals[:count].tolist(), rows[:count].tolist(), strict=True):
        yield tuple(sorted((r, d) for d, r in enumerate(chosen) if r >= 0)), total


def best_options(predictions: Sequence[Prediction], config: SlamConfig, count: int) -> list[Option]:
    """Return the `count` most promising children of all branches, the best first."""
    bounds = [bounds_of(p.table, p.offsets) for p in predictions]
    greatest = np.array([b.max(initial=-math.inf) for b in bounds])
    found: list[Option] = []
    floor = Floor(count, config.drop)
    for i in np.argsort(-greatest, kind="stable").tolist():
        if greatest[i] >= floor.value:
            found += _options(predictions[i], bounds[i], config, floor)
    found.sort(key=lambda option: (-option.log_score, option.matches))
    return found[:count]


def nothing_matched(prediction: Prediction) -> Option:
    """Return the child in which every detection stands alone."""
    g = int(np.argmax(prediction.offsets))
    return Option(float(prediction.offsets[g]), prediction, (), g)


def child(option: Option, window: Window, config: SlamConfig, weights: Weights) -> Branch:
    """Return the branch that an option stands for, not yet solved."""
    prediction, g = option.prediction, option.proposal
    parent = prediction.branch
    model = config.observation_model
    motion = prediction.proposals.motions[g]
    newest = len(window.bearings) - 1
    n = len(parent.ids)
    matches = [(row, d) for row, d in option.matches if row < n]
    matched = np.zeros(n, np.bool_)
    matched[[row for row, _ in matches]] = True
    misses = ~matched
    if model.field_of_view < 2.0 * math.pi or config.sight is not None:
        misses &= _in_view(prediction.relative, motion, 0.5 * model.field_of_view, config.sight)
    log_pattern = parent.log_pattern + float(np.log(prediction.chances[matched]).sum())
    log_pattern += float(np.log1p(-prediction.chances[misses]).sum())
    visible = np.where(misses, prediction.if_missed, prediction.visible)
    visible[matched] = 1.0
    alone = weights.alone(window.first + newest)
    pairs = []
    for row, d in option.matches:
        if row >= n:
            scan, earlier = prediction.singles[row - n]
            place = _crossing(parent, window, scan, earlier, d, motion, model.landmark_sigma)
            pairs.append((scan, earlier, d, place))
            log_pattern += float(prediction.log_together[row - n]) + alone + math.log(2.0 * math.pi)
    left = len(window.bearings[newest]) - len(option.matches)
    return extended(
        parent,
        window,
        motion,
        matches,
        pairs,
        log_pattern + left * alone,
        visible,
        [1.0] * len(pairs),
    )


def _singles(branch: Branch, newest: int, within: int) -> list[tuple[int, int]]:
    return [
        (scan, detection)
        for scan in range(max(0, newest - within), newest)
        for detection, owner in enumerate(branch.owners[scan].tolist())
        if owner == MISSED
    ]


@lru_cache
def log_seen_again(chance: float, stay: float, back: float, gap: int) -> float:
    """Log chance that a landmark just seen is next seen after so many scans."""
    visible, total = 1.0, 0.0
    for i in range(gap):
        visible = stay * visible + (1.0 - visible) * back
        if i == gap - 1:
            return total + math.log(visible * chance)
        total += math.log1p(-min(visible * chance, CERTAIN))
        visible = visible * (1.0 - chance) / max(1.0 - visible * chance, 1e-9)
    return total


def shortest_range(motion: Motion) -> float:
    """Return the shortest range tried for a landmark seen once, in the unit of the run."""
    return NEAREST_METRES if motion == "odometry" else NEAREST_BASELINES


def _in_view(
    relative: FloatArray, motion: FloatArray, half_view: float, sight: float | None
) -> BoolArray:
    away = relative - motion[:2]
    turned = np.arctan2(away[:, 1], away[:, 0]) - motion[2]
    turned = (turned + np.pi) % (2.0 * np.pi) - np.pi
    inside = np.abs(turned) <= half_view
    if sight is not None:
        inside &= np.hypot(away[:, 0], away[:, 1]) <= sight
    return np.asarray(inside)


def _crossing(
    parent: Branch,
    window: Window,
    scan: int,
    earlier: int,
    detection: int,
    motion: FloatArray,
    landmark_sigma: float,
) -> FloatArray:
    """Direction and log range, from the earlier place, of where two bearings cross.

    One landmark sigma away where they do not cross ahead.
    """
    there = parent.poses[scan + 2]
    here = parent.poses[-1]
    c, s = math.cos(here[2]), math.sin(here[2])
    x = here[0] + c * motion[0] - s * motion[1] - there[0]
    y = here[1] + s * motion[0] + c * motion[1] - there[1]
    old = there[2] + float(window.bearings[scan][earlier])
    new = here[2] + motion[2] + float(window.bearings[-1][detection])
    sine = math.sin(new - old)
    reach = (x * math.sin(new) - y * math.cos(new)) / sine if abs(sine) > 1e-9 else landmark_sigma
    if not 1e-3 * landmark_sigma < reach < 2.0 * landmark_sigma:
        reach = landmark_sigma
    return np.array([old, math.log(reach)])
