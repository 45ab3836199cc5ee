"""Grow the tree scan by scan: propose, associate, solve, prune."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mht_slam.association import Association
from mht_slam.progress import Progress
from mht_slam.tree.assign import best_matchings
from mht_slam.tree.branch import Branch, LostError, extend, first_branch
from mht_slam.tree.gains import match_gains
from mht_slam.tree.proposals import propose
from mht_slam.tree.setting import Setting


@dataclass(frozen=True)
class Effort:
    """How hard the tree searches.

    Attributes
    ----------
    keep : branches kept after each scan.
    solve : children solved at each scan, the most promising first.
    drop : nats below the best at which a branch or child is given up.
    alternatives : proposals at which single matches are forbidden in turn.
    """

    keep: int = 10
    solve: int = 24
    drop: float = 15.0
    alternatives: int = 3


def grow(
    setting: Setting,
    effort: Effort,
    branches: Sequence[Branch] = (),
    progress: Progress | None = None,
) -> list[Branch]:
    """Return branches over all scans, the best first; `branches` to start from, or none."""
    leaves = list(branches) or [first_branch(setting)]
    total = len(setting.problem.scans)
    while len(leaves[0].poses) < total:
        leaves = next_scan(setting, effort, leaves)
        if not leaves:
            return []
        if progress is not None:
            progress(len(leaves[0].poses), total)
    return leaves


def next_scan(setting: Setting, effort: Effort, leaves: Sequence[Branch]) -> list[Branch]:
    """Return the best children of all branches."""
    options = []
    for branch in leaves:
        proposals = propose(setting.problem, branch.poses)
        gains = match_gains(setting, branch, proposals)
        candidates = best_matchings(
            gains.table,
            proposals.log_prior + gains.alone,
            drop=effort.drop,
            alternatives=effort.alternatives,
        )
        options += [
            (branch.log_score + c.log_gain, branch, c, proposals.motions[c.proposal])
            for c in candidates
        ]
    options.sort(key=lambda option: -option[0])
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
    return pruned(children, effort)


def pruned(branches: Sequence[Branch], effort: Effort) -> list[Branch]:
    """Return the best branches, best first."""
    ordered = sorted(branches, key=lambda b: (-b.log_score, b.table.tolist()))
    return [b for b in ordered[: effort.keep] if b.log_score >= ordered[0].log_score - effort.drop]


def association_of(setting: Setting, branch: Branch) -> Association:
    """Return a branch's association: what is in no row counts as false alarms."""
    return Association(branch.table, [len(s) for s in setting.problem.scans[: len(branch.poses)]])
