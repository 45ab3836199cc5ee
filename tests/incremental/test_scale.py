"""A known length turns baselines into metres, with its uncertainty."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mht_slam.errors import OptionError
from mht_slam.incremental.scale import (
    Scale,
    combined,
    scale_from_distance,
    scale_from_odometry,
)


def test_the_uncertainty_of_a_distance_is_that_of_samples() -> None:
    rng = np.random.default_rng(0)
    away, covariance = np.array([3.0, 4.0]), np.array([[0.01, 0.004], [0.004, 0.02]])
    scale = scale_from_distance(np.zeros(2), away, 20.0, 0.3, covariance)
    drawn = rng.multivariate_normal(away, covariance, size=200_000)
    ratios = rng.normal(20.0, 0.3, 200_000) / np.hypot(*drawn.T)
    assert scale.value == pytest.approx(4.0)
    assert scale.sigma == pytest.approx(ratios.std(), rel=0.02)


def test_steps_that_were_not_measured_say_nothing() -> None:
    poses = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 2, 0]])
    scale = scale_from_odometry(poses, [3.0, 1.0, None], 0.1)
    assert scale.value == pytest.approx(3.0)
    assert scale.sigma == pytest.approx(0.3)


def test_measurements_combine_by_their_precision() -> None:
    together = combined([Scale(2.0, 0.02), Scale(3.0, 3.0)])
    assert together.value == pytest.approx(2.0, rel=1e-3)
    assert together.sigma < 0.02 + 1e-12


@pytest.mark.parametrize(
    "call",
    [
        lambda: scale_from_distance(np.zeros(2), np.zeros(2), 1.0, 0.1),
        lambda: scale_from_distance(np.zeros(2), np.array([1.0, math.nan]), 1.0, 0.1),
        lambda: scale_from_distance(np.zeros(2), np.ones(2), -1.0, 0.1),
        lambda: scale_from_odometry(np.zeros((3, 3)), [1.0], 0.1),
        lambda: scale_from_odometry(np.zeros((3, 3)), [1.0, 1.0], 0.1),
        lambda: combined([]),
        lambda: combined([Scale(1.0, 0.0)]),
    ],
)
def test_what_tells_no_scale_is_refused(call) -> None:
    with pytest.raises(OptionError):
        call()
