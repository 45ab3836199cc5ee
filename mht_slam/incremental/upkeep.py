"""The care of the committed past: scans settled, false landmarks let go, loops closed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mht_slam.arrays import IntArray
from mht_slam.incremental.branch import Branch, Window, carried_along
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.history import History, SeenApart
from mht_slam.incremental.loops import FEWEST, INFLATION, find_loop, find_twins, spacing_of
from mht_slam.incremental.past import Committed, Sighted, commit, merged, recentred, without

KNOWN_LOG_RANGE = 0.1
"""Deviation of its log range below which a landmark's coordinates become Cartesian."""
DOUBTFUL = 3
"""Scans that have to see a landmark for it to stay in the map when it is out of sight: false alarms
meet in pairs, seldom in threes."""
LOOP_SIGMA = 0.04
"""How far two estimates of one landmark may differ when a loop is closed, in spacings."""


def with_oldest_scan(
    past: Committed, window: Window, best: Branch, config: SlamConfig, dof: float
) -> Committed:
    """Take the oldest open scan into the past, as the best branch reads it.

    A landmark enters the map once its log range is known to `SlamConfig.settled`; the bearings of
    those that wait are dropped, which loses information and adds none.
    """
    at = {number: i for i, number in enumerate(past.ids.tolist())}
    visible = past.visible.copy()
    for i, number in enumerate(window.settled.tolist()):
        visible[at[number]] = best.visible[i]
    deviations = best.log_range_deviations
    sighted = np.flatnonzero(best.sightings[:, 0] == 2)
    rows = best.sightings[sighted, 1]
    ready = (rows < len(window.settled)) | (deviations[rows] < config.settled)
    sighted, rows = sighted[ready], rows[ready]
    committed = commit(
        replace(past, visible=visible),
        int(window.kinds[0]),
        window.motion[0],
        best.poses[:3],
        Sighted(
            ids=best.ids[rows],
            bearings=best.bearings[sighted],
            sigmas=best.sigmas[sighted],
            places=best.places[rows],
            centres=best.centres[rows],
        ),
        dof,
        window.first,
    )
    return recentred(committed, KNOWN_LOG_RANGE)


def tidied(past: Committed, branches: Sequence[Branch], scan: int, config: SlamConfig) -> Committed:
    """Let go of landmarks that were false alarms, and of the oldest where there are too many.

    Two false alarms that met once are not seen again. Landmarks of the open scans stay.
    """
    closed = ~np.isin(past.ids, _open_landmarks(branches, 0))
    unseen = closed & (past.last_seen < scan - config.lag)
    doubtful = unseen & (past.sightings < DOUBTFUL)
    gone = doubtful & (past.last_seen < scan - config.loop_scans)
    oldest_first = np.argsort(np.where(unseen & ~gone, past.last_seen, scan + 1), kind="stable")
    too_many = max(0, len(past.ids) - int(gone.sum()) - config.most_landmarks)
    gone[oldest_first[: min(too_many, int((unseen & ~gone).sum()))]] = True
    return without(past, np.flatnonzero(gone)) if gone.any() else past


def loops_closed(
    past: Committed, branches: Sequence[Branch], history: History, scan: int, config: SlamConfig
) -> tuple[Committed, list[Branch]]:
    """Recognise old landmarks in new ones until there are none, and return what that changes.

    The history takes note of the new names.
    """
    chance = config.observation_model.detection_probability
    assert chance is not None  # noqa: S101 - checked by the configuration
    branches = list(branches)
    while True:
        apart = SeenApart(history, branches)
        since = scan - config.loop_scans
        loop = find_loop(past, since, config.loop_odds, apart)
        if loop is None and history.tears and history.tears[-1] > since:
            anywhere = {"farthest": math.inf, "most_turn": math.pi}
            loop = find_loop(past, history.tears[-1], config.loop_odds, apart, **anywhere)
        if loop is None:
            chosen = active_landmarks(past, branches, scan, config)
            loop = find_twins(past, chosen, apart, chance, config.twin_odds)
        if loop is None:
            return past, branches
        names = zip(past.ids[loop.new].tolist(), past.ids[loop.old].tolist(), strict=True)
        renamed = dict(names)
        before, sigma = past.mean[3:6], LOOP_SIGMA * spacing_of(past.points)
        past = merged(past, loop.new, loop.old, sigma)
        history.renamed.update(renamed)
        history.loops.append((scan, len(renamed), loop.log_odds))
        branches = [carried_along(b, before, past.mean[3:6], renamed) for b in branches]


def active_landmarks(
    past: Committed, branches: Sequence[Branch], scan: int, config: SlamConfig
) -> IntArray:
    """Return the indices of the settled landmarks that the next scans may see.

    Those of the open scans, then the nearest ones. A landmark out of sight for longer counts only
    where its place, seen from the robot, is certain: else single detections would recognise
    whatever lies nearest, where only several landmarks together can tell. What the filter says of
    that certainty is trusted the less, the longer the landmark was out of sight.

    Parameters
    ----------
    branches : the best one first.
    scan : the one that was committed last.
    """
    away = np.hypot(*(past.points - branches[0].poses[-1, :2]).T)
    unseen_for = scan - past.last_seen
    out_of_sight = unseen_for > config.lag
    if out_of_sight.any():
        recent = past.first_seen > scan - config.loop_scans
        spacing = spacing_of(past.points[recent] if recent.sum() >= FEWEST else past.points)
        inflation = INFLATION * (1.0 + unseen_for / config.loop_scans)
        unsure = inflation * past.deviations_from_robot() > config.familiar * spacing
        away[out_of_sight & unsure] = np.inf
    away[np.isin(past.ids, _open_landmarks(branches, 1))] = -1.0
    count = min(config.active + int((away < 0).sum()), int(np.isfinite(away).sum()))
    return np.sort(np.argsort(away, kind="stable")[:count])


def next_window(window: Window, past: Committed, chosen: IntArray) -> Window:
    """Return the window without its oldest scan, given the new past and its active landmarks."""
    mean, information = past.marginal(chosen)
    return replace(
        window,
        first=window.first + 1,
        bearings=window.bearings[1:],
        sigmas=window.sigmas[1:],
        kinds=window.kinds[1:],
        motion=window.motion[1:],
        prior_mean=mean,
        prior_information=information,
        settled=past.ids[chosen],
        centres=past.centres[chosen],
    )


def _open_landmarks(branches: Sequence[Branch], since: int) -> IntArray:
    """Numbers of the landmarks that any branch sees in the open scans from `since` on."""
    owners = [owner for branch in branches for owner in branch.owners[since:]]
    return np.unique(np.concatenate(owners)) if owners else np.empty(0, np.int64)
