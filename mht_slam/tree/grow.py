"""Grow the tree scan by scan: propose, associate, solve, prune."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.progress import Progress
from mht_slam.tree.assign import Candidate, best_matchings
from mht_slam.tree.branch import Branch, LostError, extend, first_branch
from mht_slam.tree.effort import Effort
from mht_slam.tree.gains import match_gains
from mht_slam.tree.proposals import propose
from mht_slam.tree.setting import Setting

Option: TypeAlias = tuple[float, Branch, Candidate, FloatArray]
"""A child to be: its expected score, its parent, the matching, and the motion proposed."""


def grow(
    setting: Setting,
    effort: Effort,
    branches: Sequence[Branch] = (),
    *,
    n_scans: int | None = None,
    progress: Progress | None = None,
) -> list[Branch]:
    """Return branches over the first `n_scans` scans, None for all, the best first.

    `branches` of equally many scans are where the tree starts; without any, at the first scan. The
    list is empty where no branch has a usable optimum.
    """
    leaves = list(branches) or [first_branch(setting)]
    total = len(setting.problem.scans)
    while leaves and len(leaves[0].poses) < (total if n_scans is None else n_scans):
        leaves = next_scan(setting, effort, leaves)
        if leaves and progress is not None:
            progress(len(leaves[0].poses), total)
    return leaves


def next_scan(setting: Setting, effort: Effort, leaves: Sequence[Branch]) -> list[Branch]:
    """Return the best children of all branches."""
    effort = effort.at(len(leaves[0].poses) + 1)
    with np.errstate(all="ignore"):  # extreme models overflow; what is not finite is left out
        options = _options(setting, effort, leaves)
        children = _solved(setting, effort, options)
    return pruned(children, effort)


def _options(setting: Setting, effort: Effort, leaves: Sequence[Branch]) -> list[Option]:
    """Children worth solving, the most promising first."""
    options = []
    for branch in leaves:
        proposals = propose(setting.problem, branch.poses)
        gains = match_gains(setting, branch, proposals)
        candidates = best_matchings(
            gains.table,
            proposals.log_prior + gains.alone,
            drop=effort.drop,
            n_ranked=effort.ranked,
            depth=effort.depth,
        )
        options += [
            (branch.log_score + c.log_gain, branch, c, proposals.motions[c.proposal])
            for c in candidates
        ]
    options.sort(key=lambda option: -option[0])
    return options


def _solved(setting: Setting, effort: Effort, options: Sequence[Option]) -> list[Branch]:
    children: list[Branch] = []
    for expected, branch, candidate, motion in options[: effort.solve]:
        if expected < options[0][0] - effort.drop:
            break
        n = len(branch.table)
        try:
            children.append(
                extend(
                    setting,
                    branch,
                    motion,
                    [(r, d) for r, d in candidate.matches if r < n],
                    [(r - n, d) for r, d in candidate.matches if r >= n],
                )
            )
        except LostError:
            continue
    return children


def pruned(branches: Sequence[Branch], effort: Effort) -> list[Branch]:
    """Return the best branches, best first."""
    ordered = sorted(branches, key=lambda b: (-b.log_score, b.table.tolist()))
    return [b for b in ordered[: effort.keep] if b.log_score >= ordered[0].log_score - effort.drop]
