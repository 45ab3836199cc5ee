"""Hindsight: a smoothed run read again, as long as its evidence rises."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.motion_terms import ODOMETRY, STILL
from mht_slam.incremental.remapping import disjoint, find_tracks, owners_of
from mht_slam.incremental.rereading import scans_reread
from mht_slam.incremental.reunions import find_reunions, reunited
from mht_slam.incremental.run_evidence import log_run_evidence
from mht_slam.incremental.steps import Step
from mht_slam.incremental.strays import strays_reread
from mht_slam.incremental.whole_run import WholeRun

READINGS = 6
"""Rounds of strays, reunions and scans, at most."""
MOST_TRIED = 12
"""Reunions tried one by one in a round, where all together lower the evidence."""
SHARPEST = 0.25
"""Slack of the trajectory below which it is not taken to be better known."""


def in_hindsight(
    whole: WholeRun,
    smoothed: Callable[[Sequence[IntArray], WholeRun], WholeRun],
    bearings: Sequence[FloatArray],
    sigmas: Sequence[FloatArray],
    config: SlamConfig,
) -> WholeRun:
    """Return the run under the best reading that is found from the one it has.

    The past is settled scan after scan, without what comes later. In hindsight strays are read as
    other landmarks, landmarks that are one are united, and every scan is assigned anew to the map
    that all of them make, in turn. After each of these moves the run is smoothed; a move that does
    not raise the evidence of the run (`log_run_evidence`) is taken back.

    Parameters
    ----------
    whole : the run smoothed as it was settled.
    smoothed : smooths other owners, from a run to start from.
    bearings, sigmas : of each scan.

    Source: docs/incremental.md.
    """
    best = log_run_evidence(whole, bearings, sigmas, config)

    def taken(owners: Sequence[IntArray] | None) -> bool:
        nonlocal whole, best
        if owners is None:
            return False
        try:
            tried = smoothed(owners, whole)
        except RuntimeError:  # of GTSAM: no solution
            return False
        log_evidence = log_run_evidence(tried, bearings, sigmas, config)
        if not log_evidence > best:
            return False
        whole, best = tried, log_evidence
        return True

    for _ in range(READINGS):
        before = best
        taken(strays_reread(whole, bearings, sigmas, config))
        found = find_reunions(whole, config)
        if found and not taken(reunited(whole.owners, found)) and len(found) > 1:
            for reunion in found[:MOST_TRIED]:
                taken(reunited(whole.owners, [reunion]))
        taken(scans_reread(whole, bearings, sigmas, config))
        if best == before:
            break
    return whole


def drawn_anew(
    whole: WholeRun,
    smoothed: Callable[[Sequence[IntArray], WholeRun], WholeRun],
    steps: Sequence[Step],
    bearings: Sequence[FloatArray],
    sigmas: Sequence[FloatArray],
    config: SlamConfig,
) -> WholeRun:
    """Return the best of the run and of `SlamConfig.remaps` runs whose maps are drawn anew.

    Where a map went wrong from its start no reading of one landmark or scan mends it. So all
    landmarks are drawn from the scans at once (`find_tracks`), along the trajectory; that run is
    smoothed and read in hindsight, its trajectory gives the next map, with less slack. The first
    trajectory is the odometer's, which no association has bent, or without one the run's own.
    Evidence (`log_run_evidence`) chooses: the run that was there is replaced by a better one only.

    Parameters
    ----------
    whole : the run as read in hindsight.
    smoothed : smooths other owners, from a run to start from.
    steps, bearings, sigmas : of each scan.

    Source: docs/incremental.md.
    """
    best, most = whole, log_run_evidence(whole, bearings, sigmas, config)
    counts = [len(z) for z in bearings]
    fresh = 1 + max((int(owner.max(initial=-1)) for owner in whole.owners), default=-1)
    try:
        if all(step.kind in (ODOMETRY, STILL) for step in steps[1:]):
            whole = smoothed(owners_of([], counts, fresh), whole)
        for number in range(config.remaps):
            slack = max(1.0 / (1 + number), SHARPEST)
            tracks = disjoint(find_tracks(whole.poses, bearings, sigmas, config, slack))
            if not tracks:
                break
            start = replace(
                whole,
                numbers=np.arange(fresh, fresh + len(tracks)),
                points=np.array([track.point for track in tracks]),
            )
            drawn = smoothed(owners_of(tracks, counts, fresh), start)
            whole = in_hindsight(drawn, smoothed, bearings, sigmas, config)
            log_evidence = log_run_evidence(whole, bearings, sigmas, config)
            if log_evidence > most:
                best, most = whole, log_evidence
    except RuntimeError:  # of GTSAM: no solution
        pass
    return best
