"""`MultiHypothesisSlam`: scan after scan, many hypotheses over the open scans and one past."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from mht_slam.arrays import FloatArray, IntArray, freeze
from mht_slam.association import MISSED, Association
from mht_slam.errors import MeasurementError
from mht_slam.graph.standstill import standstills
from mht_slam.hypotheses import Posterior
from mht_slam.incremental import associate, checkpoint, upkeep
from mht_slam.incremental.branch import (
    Branch,
    Window,
    empty_branch,
    rearranged,
    solved,
    unsolved,
)
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.doubts import trusted
from mht_slam.incremental.hindsight import drawn_anew, in_hindsight
from mht_slam.incremental.history import History, association_of
from mht_slam.incremental.live import live_posterior, marginal_owners
from mht_slam.incremental.monitor import FRESH, TORN, Monitor, opened
from mht_slam.incremental.motion_terms import ODOMETRY, STILL
from mht_slam.incremental.past import Committed, nothing_committed, points_of
from mht_slam.incremental.run_evidence import log_run_evidence
from mht_slam.incremental.slam_map import SlamMap
from mht_slam.incremental.steps import Step, frame_step, next_step, propose
from mht_slam.incremental.whole_run import WholeRun, smooth_whole_run
from mht_slam.measurements import BearingScan, wrap_angle

Status: TypeAlias = Literal["initialising", "tracking", "lost"]

ROUNDS = 10
"""Gauss-Newton steps at most for one branch and scan; most need two."""
STARTED = 3
"""Scans before there is a posterior: fewer tell nothing apart."""


@dataclass(frozen=True)
class Dropped:
    """A hypothesis that did not survive the last scan.

    Attributes
    ----------
    reason : "improbable" (further behind than `SlamConfig.drop`), "one too many" (as many as
        `SlamConfig.hypotheses` allows were better), "no optimum", or "settled otherwise" (it reads
        the scan that has just been committed in another way than the best hypothesis does).
    behind : nats behind the best one.
    """

    reason: Literal["improbable", "one too many", "no optimum", "settled otherwise"]
    behind: float


class MultiHypothesisSlam:
    """The incremental multi-hypothesis estimator.

    Every scan, each hypothesis is extended by the best associations at a row of proposed poses;
    the best children are solved over the open scans, given one Gaussian that stands for everything
    before; the best of those are kept. A scan that is `SlamConfig.lag` scans old is settled as the
    best hypothesis says. New landmarks that together look like old ones close loops.

    The frame is that of the first pose, x forward and y left, of a straight run that of its line;
    the unit is the metre with motion ``odometry``, the first step otherwise.

    Source: docs/method.md, section 5, and docs/incremental.md.

    >>> import numpy as np
    >>> slam = MultiHypothesisSlam(SlamConfig(motion="smooth"))
    >>> for x in range(4):
    ...     scan = BearingScan(np.arctan2([2.0, -3.0, 2.5], np.array([4.0, 5.0, 8.0]) - x))
    ...     posterior = slam.update(scan)
    >>> slam.status, slam.association.n_landmarks, slam.map.points.shape
    ('tracking', 3, (3, 2))
    """

    def __init__(self, config: SlamConfig | None = None) -> None:
        self.config = SlamConfig() if config is None else config
        model = self.config.observation_model
        self._weights = associate.Weights.of(self.config)
        self._dof = math.inf if model.bearing_dof is None else model.bearing_dof
        self._past = nothing_committed()
        self._window = _first_window(self._past)
        self._branches: tuple[Branch, ...] = (empty_branch(),)
        self._history = History()
        self._monitor = Monitor()
        self._moved: float | None = None
        self._dropped: list[Dropped] = []
        self._whole_run: tuple[int, WholeRun] | None = None

    # What goes in

    def update(self, scan: BearingScan) -> Posterior:
        """Take the next scan and return the posterior over the open scans.

        Raises `MeasurementError`, before anything has changed, for what is no scan, for known
        identities, for a time that does not come after the last one, and for missing odometry.
        """
        self._check(scan)
        model = self.config.observation_model
        number = self.n_scans
        sigmas = np.full(len(scan), model.sigma) if scan.sigma is None else scan.sigma
        step = self._step(scan, sigmas)
        if self.status == "lost":
            step = opened(step)
        self._dropped = []
        self._window = replace(
            self._window,
            bearings=(*self._window.bearings, scan.bearings),
            sigmas=(*self._window.sigmas, sigmas),
            kinds=np.append(self._window.kinds, step.kind),
            motion=np.concatenate([self._window.motion, step.parameters[None]]),
        )
        history = self._history
        history.bearings.append(scan.bearings)
        history.sigmas.append(sigmas)
        history.times.append(math.nan if scan.time is None else scan.time)
        history.steps.append(step)
        if number == 0:
            self._branches = (self._first(scan),)
        else:
            self._grow(step)
        self._monitor = self._monitor.after(self._branches[0].owners, self._window.settled)
        if self._monitor.tears:
            self._tear()
        if len(self._window.bearings) > self.config.lag:
            self._commit()
        return self.posterior

    # What comes out

    @property
    def n_scans(self) -> int:
        """Scans taken in so far."""
        return len(self._history.bearings)

    @property
    def status(self) -> Status:
        """``initialising`` before the third scan; ``lost`` while recent scans contradict the map.

        While lost, the motion prior is opened wide, so that the next scans may say where the robot
        is. See `mht_slam.incremental.monitor`.
        """
        if self.n_scans < STARTED:
            return "initialising"
        return "lost" if self._monitor.is_lost else "tracking"

    @property
    def posterior(self) -> Posterior:
        """The hypotheses over the open scans; none while initialising."""
        branches = () if self.status == "initialising" else self._branches
        return live_posterior(branches, self._window, self.config.observation_model)

    @property
    def association(self) -> Association:
        """Everything so far, as the best hypothesis has it: landmarks seen twice or more.

        Read again in the light of the whole run, which is smoothed for it (see
        `mht_slam.incremental.hindsight`).
        """
        return association_of(self.whole_run.owners)[0]

    @property
    def trajectory(self) -> FloatArray:
        """(m, 3) smoothed poses of all scans: the whole run solved as one graph, on demand."""
        return self.whole_run.poses

    @property
    def map(self) -> SlamMap:
        """Smoothed landmarks, in the order of the rows of `association`, on demand."""
        whole = self.whole_run
        _, numbers = association_of(whole.owners)
        at = np.searchsorted(whole.numbers, numbers)
        return SlamMap(numbers, freeze(whole.points[at]), whole.counts[at], at, whole)

    @property
    def whole_run(self) -> WholeRun:
        """The graph of the whole run, solved from the online estimate and read in hindsight.

        Takes time that grows with the run; made once per scan, when asked for.
        """
        if self._whole_run is None or self._whole_run[0] != self.n_scans:
            best, history = self._branches[0], self._history
            points = dict(zip(self._past.ids.tolist(), self._past.points, strict=True))
            open_points = points_of(best.places, best.centres)
            points.update(zip(best.ids.tolist(), open_points, strict=True))
            whole = self._smoothed(self._owners(), self.online_trajectory, points)
            scans = history.bearings, history.sigmas, self.config
            whole = in_hindsight(whole, self._smoothed_from, *scans)
            if self.config.remaps:
                whole = drawn_anew(whole, self._smoothed_from, history.steps, *scans)
            self._whole_run = self.n_scans, whole
        return self._whole_run[1]

    @property
    def log_evidence(self) -> float:
        """Log evidence of the whole run, as it is read in hindsight (`log_run_evidence`).

        What models of the same scans are compared by, where their motion and noise are the same.
        """
        history = self._history
        return log_run_evidence(self.whole_run, history.bearings, history.sigmas, self.config)

    @property
    def online_trajectory(self) -> FloatArray:
        """(m, 3) poses as they were known when they were settled, and the open ones as of now."""
        poses = np.array([*self._history.poses, *self._branches[0].poses[2:]]).reshape(-1, 3)
        poses[:, 2] = wrap_angle(poses[:, 2])
        return poses

    @property
    def marginal_associations(self) -> list[dict[int, float]]:
        """For each detection of the newest scan, the probability of each landmark, -1 for none.

        What is missing to 1 is the chance that it belongs to something else, because the map is
        mistaken (`mht_slam.incremental.doubts`).
        """
        owners = marginal_owners(self._branches, len(self._window.bearings) - 1)
        return trusted(owners, self._history, self._past, self._branches[0], self.config)

    @property
    def dropped(self) -> tuple[Dropped, ...]:
        """Which hypotheses did not survive the last scan, and why."""
        return tuple(self._dropped)

    @property
    def loops(self) -> tuple[tuple[int, int, float], ...]:
        """Loops closed so far: scan, landmarks recognised together, log odds."""
        return tuple(self._history.loops)

    @property
    def committed(self) -> Committed:
        """The settled past: two poses and all landmarks of the map, with their covariance."""
        return self._past

    def log_entries(self) -> Iterator[object]:
        """Yield what the append-only log holds besides the scans' own bearings: what grows."""
        history = self._history
        yield history.bearings
        for entries in (
            history.sigmas,
            history.owners,
            history.poses,
            history.steps,
            history.times,
        ):
            yield entries
            yield from entries
        for step in history.steps:
            yield step.parameters
            yield vars(step)

    def save(self, path: str | Path) -> None:
        """Write everything to a file, from which `load` goes on to the same results.

        Written beside and moved into place: a write that fails leaves an older file as it was.
        """
        checkpoint.write(
            Path(path), self.config, self._past, self._window, self._branches, self._history,
            self._monitor, self._moved,
        )  # fmt: skip

    @classmethod
    def load(cls, path: str | Path) -> MultiHypothesisSlam:
        """Read what `save` wrote; raises `CheckpointError` for any other file."""
        parts = checkpoint.read(Path(path))
        slam = cls(parts.config)
        slam._past, slam._window, slam._branches = parts.past, parts.window, parts.branches
        slam._history, slam._monitor, slam._moved = parts.history, parts.monitor, parts.moved
        return slam

    # How it works

    def _check(self, scan: BearingScan) -> None:
        number = self.n_scans
        if not isinstance(scan, BearingScan):
            raise MeasurementError(f"scan {number} is {scan!r}: give a BearingScan")
        if scan.labels is not None and any(label is not None for label in scan.labels):
            raise MeasurementError(
                f"scan {number} has labels: the incremental estimator knows no identities, leave "
                "them out, or solve the run as a whole"
            )
        if scan.time is None:
            return
        known = (time for time in reversed(self._history.times) if not math.isnan(time))
        last = next(known, -math.inf)
        if scan.time <= last:
            raise MeasurementError(
                f"scan {number} has time {scan.time:g}, the scan before {last:g}: leave out "
                "scans that come late or twice"
            )

    def _step(self, scan: BearingScan, sigmas: FloatArray) -> Step:
        number, model = self.n_scans, self.config.observation_model
        if number == 0:
            return frame_step(model.heading_sigma if model.motion == "straight" else 0.0)
        still = False
        if model.stops and model.motion == "smooth" and number > 1:
            # Compared with the first scan of the place, so that creeping away shows.
            place = number - 1
            while place > 0 and self._history.steps[place].kind == STILL:
                place -= 1
            there = BearingScan(self._history.bearings[place])
            still = standstills((there, scan), (self._history.sigmas[place], sigmas))[0]
        step = next_step(model, scan, number, still, self._moved)
        if not still:
            self._moved = None
        elif self._moved is None:
            poses = self._branches[0].poses
            self._moved = math.dist(poses[-1, :2], poses[-2, :2])
        return step

    def _first(self, scan: BearingScan) -> Branch:
        branch = self._branches[0]
        alone = replace(
            branch,
            owners=(np.full(len(scan), MISSED, np.int64),),
            poses=np.concatenate([branch.poses, np.zeros((1, 3))]),
        )
        return self._solved(alone) or unsolved(alone)

    def _solved(self, branch: Branch) -> Branch | None:
        sigma = self.config.observation_model.landmark_sigma
        return solved(branch, self._window, self._dof, sigma, ROUNDS)

    def _grow(self, step: Step) -> None:
        """Extend every branch by the newest scan and keep the best children."""
        config, window, weights = self.config, self._window, self._weights
        # What an odometer says, or standing still, is the same for all branches.
        same = propose(step, self._branches[0].poses) if step.kind in (ODOMETRY, STILL) else None
        predictions = [
            associate.predict(b, window, same or propose(step, b.poses), config, weights)
            for b in self._branches
        ]
        found = associate.best_options(predictions, config, 2 * self._most_hypotheses)
        children: dict[bytes, Branch] = {}
        for option in found:
            branch = self._solved(associate.child(option, window, config, weights))
            if branch is None:
                self._dropped.append(Dropped("no optimum", math.inf))
            else:
                children.setdefault(branch.key, branch)
        if not children:  # at worst the scan says nothing
            for prediction in predictions:
                alone = associate.child(
                    associate.nothing_matched(prediction), window, config, weights
                )
                children[alone.key] = self._solved(alone) or unsolved(alone)
        self._branches = self._kept(children.values())

    @property
    def _most_hypotheses(self) -> int:
        config = self.config
        starting = self.n_scans <= config.lag
        return max(config.hypotheses, config.start_hypotheses) if starting else config.hypotheses

    def _kept(self, branches: Iterable[Branch]) -> tuple[Branch, ...]:
        different: dict[bytes, Branch] = {}  # a loop may have made two readings one
        for branch in sorted(branches, key=lambda branch: (-branch.log_score, branch.key)):
            different.setdefault(branch.key, branch)
        ordered = list(different.values())
        best = ordered[0].log_score
        kept: list[Branch] = []
        for branch in ordered:
            behind = best - branch.log_score
            if behind > self.config.drop:
                self._dropped.append(Dropped("improbable", behind))
            elif len(kept) >= self._most_hypotheses:
                self._dropped.append(Dropped("one too many", behind))
            else:
                kept.append(branch)
        return tuple(kept)

    def _tear(self) -> None:
        """Open the steps at which the best branch left the map, and solve all branches anew."""
        window, history = self._window, self._history
        newest = self.n_scans - 1 - FRESH  # the first scan beyond the tear
        motion = window.motion.copy()
        for scan in range(max(newest - 1, window.first, 1), newest + 1):
            history.steps[scan] = opened(history.steps[scan], TORN)
            motion[scan - window.first] = history.steps[scan].parameters
        history.tears.append(newest)
        self._window = replace(window, motion=motion)
        found = [self._solved(branch) for branch in self._branches]
        usable = [branch for branch in found if branch is not None]
        self._branches = self._kept(usable or map(unsolved, self._branches))

    def _commit(self) -> None:
        """Settle the oldest open scan as the best branch says."""
        best, window = self._branches[0], self._window
        oldest = best.owners[0]
        agreeing = []
        for branch in self._branches:
            if np.array_equal(branch.owners[0], oldest):
                agreeing.append(branch)
            else:
                behind = best.log_score - branch.log_score
                self._dropped.append(Dropped("settled otherwise", behind))
        self._history.owners.append(oldest)
        self._history.poses.append(best.poses[2].copy())
        scan, config = window.first, self.config
        past = upkeep.with_oldest_scan(self._past, window, best, config, self._dof)
        past = upkeep.tidied(past, self._branches, scan, config)
        if scan % config.loop_every == 0:
            past, agreeing = upkeep.loops_closed(past, agreeing, self._history, scan, config)
        chosen = upkeep.active_landmarks(past, agreeing, scan, config)
        self._past, self._window = past, upkeep.next_window(window, past, chosen)
        renewed = rearranged(agreeing, self._window, self._past)
        found = [self._solved(branch) for branch in renewed]
        usable = [branch for branch in found if branch is not None]
        lost = len(renewed) - len(usable)
        self._dropped += [Dropped("no optimum", math.inf)] * (lost if usable else 0)
        self._branches = self._kept(usable or map(unsolved, renewed))

    def _smoothed(
        self, owners: Sequence[IntArray], poses: FloatArray, points: dict[int, FloatArray]
    ) -> WholeRun:
        history, model = self._history, self.config.observation_model
        return smooth_whole_run(
            history.steps,
            owners,
            history.bearings,
            history.sigmas,
            poses,
            points,
            dof=model.bearing_dof,
            landmark_sigma=model.landmark_sigma,
        )

    def _smoothed_from(self, owners: Sequence[IntArray], start: WholeRun) -> WholeRun:
        points = dict(zip(start.numbers.tolist(), start.points, strict=True))
        return self._smoothed(owners, start.poses, points)

    def _owners(self) -> list[IntArray]:
        return self._history.owners_now(self._branches[0].owners)


def _first_window(past: Committed) -> Window:
    mean, information = past.marginal(np.empty(0, np.int64))
    return Window(
        first=0,
        bearings=(),
        sigmas=(),
        kinds=np.empty(0, np.int64),
        motion=np.empty((0, 12)),
        prior_mean=mean,
        prior_information=information,
        settled=np.empty(0, np.int64),
        centres=np.empty((0, 2)),
    )
