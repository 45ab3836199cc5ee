"""What a match is said to be worth, against what solving says and against slow integrals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import mht_slam as ms
from mht_slam.graph.problem import make_problem
from mht_slam.simulation import simulate_scene
from mht_slam.tree.branch import Branch, extend
from mht_slam.tree.effort import Effort
from mht_slam.tree.gains import match_gains
from mht_slam.tree.grow import grow
from mht_slam.tree.moves import _keeps_labels, moves_of
from mht_slam.tree.proposals import propose
from mht_slam.tree.setting import Setting

SIGMA = math.radians(0.5)
MODEL = ms.ObservationModel(
    sigma=SIGMA,
    motion="smooth",
    turn_sigma=math.radians(2.0),
    step_change_sigma=0.3,
    detection_probability=0.8,
    false_alarm_rate=0.05,
    expected_landmarks=5.0,
    stay_probability=0.9,
)


def setting_of(seed: int, model: ms.ObservationModel = MODEL, n_scans: int = 5) -> Setting:
    scene = simulate_scene("corridor", 4, np.random.default_rng(seed), sigma=SIGMA, n_scans=n_scans)
    return Setting(make_problem(scene.run, tuple(range(n_scans)), model))


def branches_of(setting: Setting) -> list[Branch]:
    return grow(setting, Effort(keep=6), n_scans=4)


@pytest.mark.parametrize("view_deg", [360.0, 200.0])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_child_that_matches_nothing_scores_what_was_said(seed: int, view_deg: float) -> None:
    """Its graph gains only a motion prior, which integrates to one."""
    setting = setting_of(seed, replace(MODEL, field_of_view=math.radians(view_deg)))
    for branch in branches_of(setting):
        proposals = propose(setting.problem, branch.poses)
        gains = match_gains(setting, branch, proposals)
        middle = len(proposals.motions) // 2
        child = extend(setting, branch, proposals.motions[middle], [], [])
        expected = branch.log_score + gains.alone[middle]
        assert child.log_score == pytest.approx(expected, abs=0.1)


def test_a_pair_at_a_known_pose_is_worth_its_integral_over_the_range() -> None:
    """Against a sum over a fine row of ranges on the first ray, at one pose without any spread."""
    model = replace(
        MODEL, motion="straight", landmark_sigma=8.0, stay_probability=1.0, sigma=math.radians(2.0)
    )
    run = ms.StraightRun(ms.BearingScan([b]) for b in (0.6, 0.75, 0.9))
    setting = Setting(make_problem(run, (0, 1, 2), model))
    branch = grow(setting, Effort(), n_scans=1)[0]
    proposals = propose(setting.problem, branch.poses)
    assert len(proposals.motions) == 1
    gains = match_gains(setting, branch, proposals)

    ranges = np.geomspace(0.01, 80.0, 20_000)

    def prior_along(origin: float, bearing: float) -> tuple[np.ndarray, np.ndarray]:
        """Places on a ray, and the prior's density over log ranges there."""
        places = ranges[:, None] * [math.cos(bearing), math.sin(bearing)] + [origin, 0.0]
        away = (places - model.landmark_centre) / model.landmark_sigma
        density = np.exp(-0.5 * (away**2).sum(1)) / (2.0 * math.pi * model.landmark_sigma**2)
        return places, density * ranges**2

    places, prior = prior_along(0.0, 0.6)
    dx, dy = places[:, 0] - 1.0, places[:, 1]
    slope = (dx * places[:, 0] + dy**2) / (dx**2 + dy**2)  # of the second bearing by the first
    spread = model.sigma * np.sqrt(1.0 + slope**2)
    error = (0.75 - np.arctan2(dy, dx)) / spread
    second = np.exp(-0.5 * error**2) / (math.sqrt(2.0 * math.pi) * spread)
    together = 5.0 * 0.8**2 * np.trapezoid(prior * second, np.log(ranges))
    alone = [
        0.05 + 5.0 * 0.8 * 0.2 * np.trapezoid(prior_along(*ray)[1], np.log(ranges))
        for ray in ((0.0, 0.6), (1.0, 0.75))
    ]
    expected = math.log(together / (alone[0] * alone[1]))
    # Sixteen log-spaced ranges stand for the row.
    assert gains.table[0, 0, 0] == pytest.approx(expected, abs=0.25)


def test_moves_leave_known_identities_as_they_are() -> None:
    scene = simulate_scene("corridor", 3, np.random.default_rng(9), sigma=SIGMA, n_scans=4)
    scans = [
        ms.BearingScan(scan.bearings, labels=[f"l{row}" if row < 2 else None for row in rows])
        for scan, rows in zip(scene.scans, scene.truth.landmark_of_detection(), strict=True)
    ]
    setting = Setting(make_problem(ms.StraightRun(scans), (0, 1, 2, 3), MODEL))
    branch = grow(setting, Effort())[0]
    moves = list(moves_of(setting, branch))
    kept = [move for move in moves if _keeps_labels(setting, branch, move)]
    assert 0 < len(kept) < len(moves)
    rows = [tuple(row) for row in branch.table.tolist()]
    for move in kept:
        table = [row for i, row in enumerate(rows) if i not in move.gone]
        table += [row for row in move.new if sum(d >= 0 for d in row) >= 1]
        labels = [scan.labels for scan in scans]
        for row in table:
            named = {labels[k][d] for k, d in enumerate(row) if d >= 0} - {None}
            assert len(named) <= 1
        for name in ("l0", "l1"):
            holders = [
                i
                for i, row in enumerate(table)
                if any(d >= 0 and labels[k][d] == name for k, d in enumerate(row))
            ]
            assert len(holders) == 1
