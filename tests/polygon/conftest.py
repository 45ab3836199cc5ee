"""Runs that the tests of the ranking see, and how they compare its scores."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import strategies as st

from mht_slam.association import Association
from mht_slam.measurements import BearingScan, RunPair, StraightRun
from mht_slam.polygon.ranking import rank

Floats = npt.NDArray[np.float64]
SEEDS = st.integers(0, 2**32 - 1)
EPSILON = np.deg2rad(3)
STEPS = (0.0, 1.0, 2.3)


def landmarks_of(seed: int, n: int) -> Floats:
    rng = np.random.default_rng(seed)
    return np.column_stack(
        [rng.uniform(-1.0, 4.0, n), rng.choice([-1, 1], n) * rng.uniform(1, 4, n)]
    )


def seen_from(landmarks: Floats, x: float, y: float, heading: float, noise: Floats) -> Floats:
    return np.arctan2(landmarks[:, 1] - y, landmarks[:, 0] - x) - heading + noise


def straight_bearings(seed: int, n: int, epsilon: float = EPSILON) -> list[Floats]:
    """Bearings of n landmarks in the same order in every scan, errors inside epsilon."""
    rng = np.random.default_rng(seed + 1)
    landmarks = landmarks_of(seed, n)
    return [
        seen_from(landmarks, x, 0.0, 0.0, 0.95 * rng.uniform(-epsilon, epsilon, n)) for x in STEPS
    ]


def pair_bearings(seed: int, n: int, epsilon: float = EPSILON) -> list[Floats]:
    rng = np.random.default_rng(seed + 1)
    landmarks = landmarks_of(seed, n)
    poses = (
        (0.0, 0.0, 0.0),
        (1.0, 0.0, 0.0),
        (3.0, -0.5, 2.0),
        (3.0 + 1.4 * np.cos(2.0), -0.5 + 1.4 * np.sin(2.0), 2.0),
    )
    return [
        seen_from(landmarks, x, y, heading, 0.95 * rng.uniform(-epsilon, epsilon, n))
        for x, y, heading in poses
    ]


def as_run(bearings: Sequence[Floats]) -> StraightRun:
    return StraightRun(BearingScan(b) for b in bearings)


def as_pair(bearings: Sequence[Floats]) -> RunPair:
    scans = [BearingScan(b) for b in bearings]
    return RunPair(scans[:2], scans[2:])


def scores_of(run: StraightRun | RunPair, **options: Any) -> dict[Association, float]:
    ranking = rank(run, epsilon=EPSILON, top_k=None, **options)
    return {h.association: h.score for h in ranking}


def easy_run(n: int = 4) -> StraightRun:
    landmarks = np.array([[0.5, 2.0], [2.0, -2.0], [3.0, 1.5], [1.0, -3.0]])[:n]
    return as_run([np.arctan2(landmarks[:, 1], landmarks[:, 0] - x) for x in STEPS])


def assert_same_scores(one: dict[Association, float], other: dict[Association, float]) -> None:
    for association in one.keys() | other.keys():
        assert one.get(association, 0.0) == pytest.approx(other.get(association, 0.0), abs=1e-9)
