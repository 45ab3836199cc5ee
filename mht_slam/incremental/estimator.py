"""`MultiHypothesisSlam`: scan after scan, many hypotheses over an open window and one past."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.graph.standstill import standstills
from mht_slam.incremental.associate import (
    Option,
    Weights,
    child,
    options,
    predict,
    upper_bound,
)
from mht_slam.incremental.branch import Branch, Window, empty_branch, carried_along, rearranged, solved
from mht_slam.incremental.loops import find_loop
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.past import Committed, Sighted, commit, merged, nothing_committed, recentred
from mht_slam.incremental.smoother import inverse_root
from mht_slam.incremental.steps import Step, frame_step, next_step
from mht_slam.measurements import BearingScan

ROUNDS = 10


class MultiHypothesisSlam:
    """The incremental estimator."""

    def __init__(self, config: SlamConfig | None = None) -> None:
        self.config = SlamConfig() if config is None else config
        model = self.config.observation_model
        self._weights = Weights.of(self.config)
        self._dof = math.inf if model.bearing_dof is None else model.bearing_dof
        self._past = nothing_committed(
            model.heading_sigma if model.motion == "straight" else 0.0
        )
        self._branches: list[Branch] = [empty_branch()]
        self._window = _first_window(self._past)
        self._scans = 0
        self.owners: list[IntArray] = []
        self.poses: list[FloatArray] = []
        self.renamed: dict[int,int] = {}
        self.loops: list = []
        self._last_scan: BearingScan | None = None
        self._moved: float | None = None

    def update(self, scan: BearingScan) -> None:
        config = self.config
        model = config.observation_model
        sigma = np.full(len(scan), model.sigma) if scan.sigma is None else scan.sigma
        still = False
        if self._scans == 0:
            step = frame_step()
        else:
            if model.stops and model.motion == "smooth" and self._scans > 1:
                assert self._last_scan is not None
                last = self._last_scan
                last_sigma = np.full(len(last), model.sigma) if last.sigma is None else last.sigma
                still = standstills((last, scan), (last_sigma, sigma))[0]
            step = next_step(model, scan, self._scans, still, self._moved)
            if still and self._moved is None:
                best = self._branches[0].poses
                self._moved = math.dist(best[-1, :2], best[-2, :2])
            elif not still:
                self._moved = None
        self._window = replace(
            self._window,
            bearings=(*self._window.bearings, scan.bearings),
            sigmas=(*self._window.sigmas, sigma),
            kinds=np.append(self._window.kinds, step.kind),
            motion=np.concatenate([self._window.motion, step.parameters[None]]),
        )
        if self._scans == 0:
            self._branches = [self._first(scan)]
        else:
            self._grow(step)
        self._scans += 1
        self._last_scan = scan
        if len(self._window.bearings) > config.lag:
            self._commit()

    def _first(self, scan: BearingScan) -> Branch:
        branch = self._branches[0]
        alone = replace(
            branch,
            owners=(np.full(len(scan), MISSED, np.int64),),
            poses=np.concatenate([branch.poses, np.zeros((1, 3))]),
        )
        found = self._solved(alone, ROUNDS)
        assert found is not None
        return found

    def _solved(self, branch: Branch, rounds: int) -> Branch | None:
        return solved(
            branch,
            self._window,
            self._dof,
            self.config.observation_model.landmark_sigma,
            rounds,
        )

    def _grow(self, step: Step) -> None:
        config = self.config
        predictions = [
            predict(branch, self._window, step, config, self._weights)
            for branch in self._branches
        ]
        bounds = [upper_bound(prediction) for prediction in predictions]
        found: list[Option] = []
        best = -math.inf
        for i in np.argsort(-np.array(bounds), kind="stable").tolist():
            if bounds[i] >= best - config.drop:
                found += options(predictions[i], config, best)
                best = max(option.log_score for option in found)
        found.sort(key=lambda option: -option.log_score)
        children: dict[bytes, Branch] = {}
        for option in found[: 2 * config.hypotheses]:
            if option.log_score < found[0].log_score - config.drop:
                break
            branch = self._solved(child(option, self._window, config, self._weights), ROUNDS)
            if branch is not None and branch.key not in children:
                children[branch.key] = branch
        self._branches = self._kept(list(children.values()))

    def _kept(self, branches: list[Branch]) -> list[Branch]:
        branches.sort(key=lambda branch: (-branch.log_score, branch.key))
        best = branches[0].log_score
        return [
            b
            for b in branches[: self.config.hypotheses]
            if b.log_score >= best - self.config.drop
        ]

    def _commit(self) -> None:
        best = self._branches[0]
        window, config = self._window, self.config
        oldest = best.owners[0]
        agreeing = [b for b in self._branches if np.array_equal(b.owners[0], oldest)]
        n_settled = len(window.settled)
        spread = inverse_root(best.root)
        n = len(best.ids)
        deviations = np.sqrt((spread[1 : 2 * n : 2] ** 2).sum(axis=1))
        taken = []
        for o in np.flatnonzero(best.sightings[:, 0] == 2).tolist():
            j = int(best.sightings[o, 1])
            if j < n_settled or deviations[j] < config.settled:
                taken.append((o, j))
        obs, lms = [o for o, _ in taken], [j for _, j in taken]
        self.owners.append(oldest)
        self.poses.append(best.poses[2].copy())
        # what is known of landmarks that leave the window
        for i, number in enumerate(window.settled.tolist()):
            where = np.flatnonzero(self._past.ids == number)[0]
            self._past.visible[where] = best.visible[i]
        self._past = commit(
            self._past,
            int(window.kinds[0]),
            window.motion[0],
            best.poses[:3],
            Sighted(
                ids=best.ids[lms],
                bearings=best.bearings[obs],
                sigmas=best.sigmas[obs],
                places=best.places[lms],
                centres=best.centres[lms],
            ),
            self._dof,
            window.first,
        )
        self._past = recentred(self._past, 0.1)
        if window.first % 10 == 0 and len(self._past.ids) > 6:
            agreeing = self._close_loop(agreeing)
        chosen = self._active(agreeing)
        mean, information = self._past.marginal(chosen)
        self._window = replace(
            window,
            first=window.first + 1,
            bearings=window.bearings[1:],
            sigmas=window.sigmas[1:],
            kinds=window.kinds[1:],
            motion=window.motion[1:],
            prior_mean=mean,
            prior_information=information,
            settled=self._past.ids[chosen],
            centres=self._past.centres[chosen],
        )
        renewed = []
        for branch in agreeing:
            again = self._solved(
                rearranged(branch, self._window, self._past, committed_scan=True), ROUNDS
            )
            if again is not None:
                renewed.append(again)
        self._branches = self._kept(renewed)

    def _close_loop(self, branches: list[Branch]) -> list[Branch]:
        while True:
            loop = find_loop(self._past, self._window.first - 100, 10.0)
            if loop is None:
                return branches
            before = self._past.mean[3:6]
            renamed = dict(
                zip(self._past.ids[loop.new].tolist(), self._past.ids[loop.old].tolist(), strict=True)
            )
            self._past = merged(self._past, loop.new, loop.old, 0.03)
            self.renamed.update(renamed)
            self.loops.append((self._window.first, loop.log_odds, renamed))
            branches = [
                carried_along(b, before, self._past.mean[3:6], renamed) for b in branches
            ]

    def _active(self, branches: list[Branch]) -> IntArray:
        past = self._past
        here = branches[0].poses[-1, :2]
        away = np.hypot(*(past.points - here).T)
        seen: set[int] = set()
        for branch in branches:
            for owner in branch.owners[1:]:
                seen.update(owner.tolist())
        away[np.isin(past.ids, np.array(sorted(seen), np.int64))] = -1.0
        import os
        old = past.last_seen < self._window.first - int(os.environ.get("OLD","100000"))
        away[old & (away>=0)] = np.inf
        count = min(max(self.config.active, int((away < 0).sum())), int(np.isfinite(away).sum()))
        return np.sort(np.argsort(away, kind="stable")[:count])


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
