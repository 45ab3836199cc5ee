"""Given the true poses and map, only landmarks in one direction are confused."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.association import MISSED, Association
from mht_slam.datasets.drive import Drive
from mht_slam.errors import OptionError
from mht_slam.evaluation.ceilings import assignment_given_truth, seen_span
from mht_slam.measurements import BearingScan, StraightRun

POSES = np.array([[0.0, 0.0, 0.3], [1.0, 0.2, 0.1], [2.0, 0.1, -0.2], [3.0, 0.0, 3.0]])
LANDMARKS = np.array([[1.5, 4.0], [1.6, 8.0], [2.0, -3.0], [-4.0, 1.0]])
SIGMA = math.radians(0.5)


def scene(
    labels: list[list[int]], noise: float = 0.0, seed: int = 0
) -> tuple[StraightRun, Association]:
    """-1 is a false alarm, 0.5 radians clockwise of landmark 2."""
    rng = np.random.default_rng(seed)
    scans = []
    for (x, y, theta), ids in zip(POSES, labels, strict=True):
        bearings = np.arctan2(LANDMARKS[ids, 1] - y, LANDMARKS[ids, 0] - x) - theta
        bearings[np.array(ids, dtype=int) == -1] = (
            math.atan2(LANDMARKS[2, 1] - y, LANDMARKS[2, 0] - x) - theta - 0.5
        )
        scans.append(BearingScan(bearings + rng.uniform(-noise, noise, len(ids))))
    return StraightRun(scans), Association.from_labels(
        [[None if i == -1 else i for i in ids] for ids in labels]
    )


@given(
    st.lists(st.lists(st.integers(-1, 3), unique=True, max_size=5), min_size=4, max_size=4),
    st.integers(0, 100),
)
def test_noise_inside_the_gate_leaves_the_truth(labels: list[list[int]], seed: int) -> None:
    run, truth = scene(labels, noise=SIGMA, seed=seed)
    assert assignment_given_truth(run, POSES, LANDMARKS, SIGMA, gate=2.0) == truth


def test_the_visual_order_may_change() -> None:
    run, truth = scene([[0, 1]] * 4)
    assert np.diff(run.scans[0].bearings) * np.diff(run.scans[2].bearings) < 0.0
    assert assignment_given_truth(run, POSES, LANDMARKS, SIGMA, gate=3.0) == truth


@pytest.mark.parametrize(("gate", "n_landmarks"), [(2.9, 0), (3.1, 1)])
def test_the_gate_counts_standard_deviations(gate: float, n_landmarks: int) -> None:
    run, _ = scene([[2], [], [], []])
    off = StraightRun([BearingScan(run.scans[0].bearings + 3.0 * SIGMA), *run.scans[1:]])
    association = assignment_given_truth(off, POSES, LANDMARKS, SIGMA, gate)
    assert association.n_landmarks == n_landmarks


@given(st.integers(0, 2**32), st.integers(0, 4), st.integers(0, 3), st.floats(0.5, 3.0))
def test_each_scan_assigns_by_least_squares(seed: int, n: int, count: int, gate: float) -> None:
    rng = np.random.default_rng(seed)
    landmarks, poses = rng.normal(0.0, 5.0, (n, 2)), rng.normal(0.0, 1.0, (3, 3))
    run = StraightRun([BearingScan(rng.uniform(-1.0, 1.0, count)) for _ in range(3)])
    association = assignment_given_truth(run, poses, landmarks, 0.3, gate)
    for k, (x, y, theta) in enumerate(poses):
        expected = np.arctan2(landmarks[:, 1] - y, landmarks[:, 0] - x) - theta
        turn = np.angle(np.exp(1j * (expected[:, None] - run.scans[k].bearings))) / 0.3
        cost = np.minimum(turn**2, gate**2)
        cheapest = min(
            sum(cost[i, j] for i, j in zip(rows, columns, strict=True))
            + gate**2 * (min(n, count) - len(rows))
            for size in range(min(n, count) + 1)
            for rows in itertools.combinations(range(n), size)
            for columns in itertools.permutations(range(count), size)
        )
        # Rows are nameless: the best naming of those assigned must cost what is cheapest.
        assigned = [j for j in association.table[:, k].tolist() if j != MISSED]
        named = min(
            sum(cost[i, j] for i, j in zip(rows, assigned, strict=True))
            for rows in itertools.permutations(range(n), len(assigned))
        )
        assert named + gate**2 * (min(n, count) - len(assigned)) == pytest.approx(cheapest)


def test_a_hidden_landmark_takes_no_detection_where_the_view_is_known() -> None:
    landmarks = np.array([[4.0, 4.0], [8.0, 8.01]])
    poses = np.zeros((3, 3))
    run = StraightRun([BearingScan([math.pi / 4 + 0.001])] * 3)
    truth = Association([[0, 0, 0]], (1, 1, 1))
    blind = assignment_given_truth(run, poses, landmarks, SIGMA, 3.0)
    seeing = assignment_given_truth(
        run, poses, landmarks, SIGMA, 3.0, in_view=[[True] * 3, [False] * 3]
    )
    assert blind == truth
    assert seeing == truth
    split = [[True, True, False], [False, False, True]]
    parted = assignment_given_truth(run, poses, landmarks, SIGMA, 3.0, in_view=split)
    assert parted.table.tolist() == [[0, 0, -1], [-1, -1, 0]]


def test_a_landmark_is_in_view_from_its_first_to_its_last_detection() -> None:
    truth = Association([[0, -1, 0, -1], [-1, 0, -1, 0]], (1, 1, 1, 1))
    assert seen_span(truth).tolist() == [[True, True, True, False], [False, True, True, True]]


def test_a_truth_of_another_shape_is_refused() -> None:
    run, _ = scene([[0, 1]] * 4)
    with pytest.raises(OptionError, match="poses has shape"):
        assignment_given_truth(run, POSES[:3], LANDMARKS, SIGMA, 3.0)
    with pytest.raises(OptionError, match="landmarks has shape"):
        assignment_given_truth(run, POSES, LANDMARKS[:, :1], SIGMA, 3.0)
    with pytest.raises(OptionError, match="in_view has shape"):
        assignment_given_truth(run, POSES, LANDMARKS, SIGMA, 3.0, in_view=[[True] * 4])
    with pytest.raises(OptionError, match="gate"):
        assignment_given_truth(run, POSES, LANDMARKS, SIGMA, 0.0)


@given(
    st.lists(st.lists(st.booleans(), min_size=7, max_size=7), min_size=1, max_size=3),
    st.integers(1, 8),
)
def test_a_landmark_is_in_view_between_detections_that_are_near(
    seen: list[list[bool]], max_gap: int
) -> None:
    flags = np.array([row for row in seen if any(row)], dtype=bool).reshape(-1, 7)
    rows, order = flags.tolist(), np.cumsum(flags, axis=0) - 1
    table = np.where(flags, order, MISSED)
    truth = Association(table, [len(rows)] * 7)
    oracle = [
        [
            any(
                a <= k <= b and row[a] != MISSED and row[b] != MISSED and b - a <= max_gap
                for a in range(7)
                for b in range(a, 7)
            )
            for k in range(7)
        ]
        for row in truth.table.tolist()
    ]
    assert seen_span(truth, max_gap).tolist() == oracle


def test_a_drive_is_read_like_a_run() -> None:
    run, truth = scene([[0, 1, 2, 3]] * 4)
    drive = Drive("here", run.scans, tuple(np.arange(4) for _ in run.scans))
    assert assignment_given_truth(drive, POSES, LANDMARKS, SIGMA, gate=3.0) == truth
