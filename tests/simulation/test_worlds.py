"""Landmark layouts stay where their names say."""

import numpy as np
import pytest

from mht_slam.errors import OptionError
from mht_slam.models import ObservationModel
from mht_slam.simulation import worlds

N = 500


@pytest.fixture
def rng():
    return np.random.default_rng(11)


@pytest.mark.parametrize("length", [1.0, 3.5])
def test_an_annulus_keeps_the_run_inside_its_hole(rng, length):
    landmarks = worlds.annulus(N, rng, length)
    radius = np.hypot(landmarks[:, 0] - 0.5 * length, landmarks[:, 1])
    inner, outer = worlds.ANNULUS_RADII
    assert landmarks.shape == (N, 2)
    assert radius.min() >= inner * length > 0.5 * length
    assert radius.max() <= outer * length


def test_an_annulus_is_uniform_over_its_area(rng):
    landmarks = worlds.annulus(20_000, rng, 2.0)
    radius = np.hypot(landmarks[:, 0] - 1.0, landmarks[:, 1])
    inner, outer = (2.0 * radius for radius in worlds.ANNULUS_RADII)
    half_area = np.sqrt(0.5 * (inner**2 + outer**2))
    assert np.mean(radius < half_area) == pytest.approx(0.5, abs=0.02)


def test_a_one_sided_world_is_the_stated_rectangle_in_first_steps(rng):
    landmarks = worlds.LONG_STEPS[0] * worlds.one_sided(N, rng)
    for axis, (low, high) in enumerate((worlds.ONE_SIDED_X, worlds.ONE_SIDED_Y)):
        assert low <= landmarks[:, axis].min() < low + 0.2
        assert high - 0.2 < landmarks[:, axis].max() <= high


@pytest.mark.parametrize("n", [1, 2, 5, 8])
def test_a_corridor_has_as_many_landmarks_on_either_side_up_to_one(rng, n):
    landmarks = worlds.corridor(n, rng, 2.0)
    assert abs(int(np.sign(landmarks[:, 1]).sum())) <= 1
    assert (np.abs(landmarks[:, 1]) >= worlds.CORRIDOR_Y[0]).all()
    assert (np.abs(landmarks[:, 1]) <= worlds.CORRIDOR_Y[1]).all()
    assert (landmarks[:, 0] >= -worlds.CORRIDOR_MARGIN).all()
    assert (landmarks[:, 0] <= 2.0 + worlds.CORRIDOR_MARGIN).all()


def test_landmarks_of_a_cluster_stand_closer_than_those_of_an_annulus():
    def mean_nearest(world):
        distances = []
        for seed in range(40):
            points = world(9, np.random.default_rng(seed), 2.0)
            apart = np.hypot(*(points[:, None] - points).transpose(2, 0, 1))
            np.fill_diagonal(apart, np.inf)
            distances.append(apart.min(axis=1).mean())
        return np.mean(distances)

    assert mean_nearest(worlds.clusters) < 0.4 * mean_nearest(worlds.annulus)


def test_the_prior_has_its_centre_and_its_scale(rng):
    model = ObservationModel(sigma=0.01, landmark_sigma=7.0, landmark_centre=(2.0, -3.0))
    landmarks = worlds.from_prior(20_000, rng, model)
    np.testing.assert_allclose(landmarks.mean(axis=0), (2.0, -3.0), atol=0.25)
    np.testing.assert_allclose(landmarks.std(axis=0), 7.0, rtol=0.03)


def test_counts_and_lengths_that_make_no_sense_are_refused(rng):
    with pytest.raises(OptionError, match="n_landmarks"):
        worlds.annulus(-1, rng)
    with pytest.raises(OptionError, match="length"):
        worlds.corridor(3, rng, 0.0)


def test_stretches_keep_as_many_landmarks_in_view_as_leave(rng):
    there = worlds.stretches(40_000, 6, rng, leave=0.2)
    ever = 1.0 + 5 * 0.2
    np.testing.assert_allclose(there.mean(axis=1), np.full(6, 1.0 / ever), rtol=0.04)
    stayed = (there[1:] & there[:-1]).sum() / there[:-1].sum()
    assert stayed == pytest.approx(0.8, abs=0.005)
    begun = np.diff(there.astype(int), axis=0, prepend=0) == 1
    assert (begun.sum(axis=0) == 1).all(), "a landmark that left does not come back"
