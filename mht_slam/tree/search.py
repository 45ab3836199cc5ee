"""From scans to the best associations of all of them: grow the tree, then move its finalists."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.association import MISSED, Association, refuse_unequal, respects_labels
from mht_slam.graph.problem import Problem
from mht_slam.hypotheses import Hypothesis
from mht_slam.models import ObservationModel
from mht_slam.progress import Progress
from mht_slam.tree.branch import Branch, LostError, anew
from mht_slam.tree.effort import Effort
from mht_slam.tree.grow import grow, pruned
from mht_slam.tree.moves import improved
from mht_slam.tree.pattern import seen_once_weights
from mht_slam.tree.setting import Setting

RARE = 1e-9
"""Chance of a miss, and rate of false alarms, where the model says nothing and none may be."""
RAREST = 1e-12
"""What the search takes them for where the model says that there are none."""


@dataclass(frozen=True)
class Finalist:
    """An association of all scans, where its graph is to start, and what its reading leaves open.

    Attributes
    ----------
    association : detections in no pair are listed as landmarks seen once or as false alarms,
        whichever is likelier.
    poses, landmarks : (m, 3) and (n, 2), one row per row of the association's table.
    log_other_readings : log of how much likelier it is with those detections read either way.
    """

    association: Association
    poses: FloatArray
    landmarks: FloatArray
    log_other_readings: float


def search_all_scans(
    problem: Problem,
    effort: Effort,
    seeds: Sequence[Hypothesis] = (),
    progress: Progress | None = None,
) -> list[Finalist]:
    """Return the best associations of all scans that were found, the likeliest first.

    `seeds` are solved hypotheses over the first scans; their extensions compete with those of the
    associations that the tree grows itself. Under a model that does not compare sizes every
    landmark is seen in every scan; raises `UnequalScansError` where that cannot be.

    Source: docs/method.md, section 5.
    """
    stated = problem.model
    if not stated.compares_sizes:
        refuse_unequal([len(scan) for scan in problem.scans], 0, 0)
    setting = Setting(replace(problem, model=_comparing_sizes(stated, problem)))
    planted = [branch for seed in seeds if (branch := _planted(setting, seed)) is not None]
    leaves = grow(setting, effort, n_scans=len(planted[0].poses) if planted else 1)
    different = {branch.table.tobytes(): branch for branch in [*planted, *leaves]}
    leaves = pruned(list(different.values()), effort)
    leaves = improved(setting, grow(setting, effort, leaves, progress=progress), effort)
    finalists = [_finalist(setting, branch) for branch in leaves]
    return [
        finalist
        for finalist in finalists
        if (stated.compares_sizes or finalist.association.is_full)
        and respects_labels(finalist.association, problem.scans)
    ]


def _comparing_sizes(model: ObservationModel, problem: Problem) -> ObservationModel:
    """Return the model with every chance of misses and false alarms above zero.

    Where it leaves one of the three numbers out, misses and false alarms are all but ruled out;
    where it rules them out itself, what they would cost stays finite, and the stated model judges
    in the end.
    """
    if model.compares_sizes:
        chance, rate = model.detection_probability, model.false_alarm_rate
        return replace(
            model,
            detection_probability=min(chance or 0.0, 1.0 - RAREST),
            false_alarm_rate=max(rate or 0.0, RAREST),
        )
    return replace(
        model,
        detection_probability=1.0 - RARE,
        false_alarm_rate=RARE,
        expected_landmarks=float(max(1, *(len(scan) for scan in problem.scans))),
    )


def _planted(setting: Setting, seed: Hypothesis) -> Branch | None:
    """Return the branch of a hypothesis over the first scans, or None where it has none."""
    if seed.poses is None or seed.landmarks is None:
        return None
    table = seed.association.table
    paired = (table != MISSED).sum(axis=1) >= 2
    once = np.argwhere((table != MISSED) & ~paired[:, None])
    singles = [(int(scan), int(table[row, scan])) for row, scan in once]
    singles += seed.association.false_alarms
    try:
        return anew(
            setting,
            table[paired],
            np.array(sorted(singles), dtype=np.int64).reshape(-1, 2),
            seed.poses,
            seed.landmarks[paired],
        )
    except LostError:
        return None


def _finalist(setting: Setting, branch: Branch) -> Finalist:
    model = setting.problem.model
    k = len(branch.poses)
    points = zip(map(tuple, branch.table.tolist()), branch.points, strict=True)
    rows: dict[tuple[int, ...], FloatArray] = dict(points)
    log_other_readings = 0.0
    weights = seen_once_weights(setting, branch.poses, branch.singles).tolist()
    false = setting.log_false_alarm
    for (scan, detection), once in zip(branch.singles.tolist(), weights, strict=True):
        labels = setting.problem.scans[scan].labels
        known = labels is not None and labels[detection] is not None
        if once >= false or known:
            pose = branch.poses[scan]
            row = [MISSED] * k
            row[scan] = detection
            angle = pose[2] + setting.problem.scans[scan].bearings[detection]
            ray = np.array([math.cos(angle), math.sin(angle)])
            rows[tuple(row)] = pose[:2] + model.landmark_sigma * ray
        if not known:  # a known landmark is no false alarm
            log_other_readings += math.log1p(math.exp(-abs(once - false)))
    association = Association(
        np.array(list(rows), dtype=np.int64).reshape(-1, k),
        [len(scan) for scan in setting.problem.scans],
    )
    landmarks = np.array([rows[tuple(row)] for row in association.table.tolist()]).reshape(-1, 2)
    return Finalist(association, branch.poses, landmarks, log_other_readings)
