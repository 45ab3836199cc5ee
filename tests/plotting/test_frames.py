"""Estimates in F_L: the similarity and the first-order covariance that comes with it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam import Hypothesis, refine
from mht_slam.plotting.frames import (
    TrueLayout,
    between,
    estimate_in_landmark_frame,
    true_base,
)
from mht_slam.simulation import Scene, simulate_pair, simulate_scene

BASE = (0, 2)
coordinate = st.floats(-10.0, 10.0)


def best(scene: Scene) -> Hypothesis:
    run = scene.run if scene.motion == "straight" else scene.pair
    return refine(run, [scene.truth], sigma=np.deg2rad(1.0), heading_sigma=np.deg2rad(2.0))[0]


@pytest.fixture(scope="module", params=["straight", "pair"])
def scene(request: pytest.FixtureRequest) -> Scene:
    rng = np.random.default_rng(4)
    if request.param == "pair":
        return simulate_pair("annulus", 4, rng, epsilon=0.01)
    return simulate_scene("annulus", 4, rng, epsilon=0.01)


@given(st.tuples(*[coordinate] * 4), st.tuples(coordinate, coordinate))
def test_the_similarity_keeps_ratios_of_distances_and_angles(
    ends: tuple[float, ...], point: tuple[float, float]
) -> None:
    a, b, p = np.array(ends[:2]), np.array(ends[2:]), np.array([point])
    length = np.linalg.norm(b - a)
    if length < 1e-2:
        return
    image = between(p, a, b)[0]
    assert np.linalg.norm(image) * length == pytest.approx(np.linalg.norm(p[0] - a), abs=1e-9)
    assert np.linalg.norm(image - [1, 0]) * length == pytest.approx(
        np.linalg.norm(p[0] - b), abs=1e-9
    )
    left = (b - a)[0] * (p[0] - a)[1] - (b - a)[1] * (p[0] - a)[0]
    assert image[1] * length**2 == pytest.approx(left, abs=1e-8)


def test_the_estimate_is_the_graphs_under_the_similarity(scene: Scene) -> None:
    hypothesis = best(scene)
    assert hypothesis.landmarks is not None
    assert hypothesis.poses is not None
    estimate = estimate_in_landmark_frame(hypothesis, BASE)
    ends = hypothesis.landmarks[list(BASE)]
    assert np.allclose(estimate.landmarks, between(hypothesis.landmarks, *ends))
    assert np.allclose(estimate.points, between(hypothesis.poses[:, :2], *ends))


def test_the_base_landmarks_are_certain_and_everything_else_is_not(scene: Scene) -> None:
    estimate = estimate_in_landmark_frame(best(scene), BASE)
    for row, covariance in enumerate(estimate.landmark_covariances):
        if row in BASE:
            assert np.allclose(covariance, 0.0, atol=1e-12)
        else:
            assert np.linalg.eigvalsh(covariance).min() > 0.0
    for covariance in estimate.point_covariances:
        assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_the_covariances_are_those_of_samples_of_the_joint_gaussian(scene: Scene) -> None:
    hypothesis = best(scene)
    assert hypothesis.landmarks is not None
    assert hypothesis.poses is not None
    graph, values, _ = hypothesis.to_gtsam()
    joint = np.linalg.inv(graph.linearize(values).hessian()[0])
    n, m = len(hypothesis.landmarks), len(hypothesis.poses)
    rng = np.random.default_rng(0)
    small = 1e-3  # so that the first order is all there is
    samples = small * rng.multivariate_normal(np.zeros(2 * n + 3 * m), joint, size=20_000)
    images = []
    for sample in samples:
        landmarks = hypothesis.landmarks + sample[: 2 * n].reshape(n, 2)
        moved = []
        for pose, tangent in zip(hypothesis.poses, sample[2 * n :].reshape(m, 3), strict=True):
            c, s = np.cos(pose[2]), np.sin(pose[2])
            moved.append(pose[:2] + np.array([[c, -s], [s, c]]) @ tangent[:2])
        points = np.vstack([landmarks, moved])
        images.append(between(points, landmarks[BASE[0]], landmarks[BASE[1]]))
    spread = np.array(images)
    estimate = estimate_in_landmark_frame(hypothesis, BASE)
    expected = np.concatenate([estimate.landmark_covariances, estimate.point_covariances])
    for k, covariance in enumerate(expected):
        sampled = np.cov(spread[:, k].T) / small**2
        assert np.allclose(sampled, covariance, atol=0.06 * np.trace(covariance) + 1e-9)


def test_a_failed_hypothesis_has_no_estimate(scene: Scene) -> None:
    failed = Hypothesis(scene.truth, None, -np.inf, -np.inf, 0.0, failure="it is parallel")
    with pytest.raises(ValueError, match="parallel"):
        estimate_in_landmark_frame(failed, BASE)


def test_the_true_base_is_what_the_middle_scan_saw(scene: Scene) -> None:
    layout = TrueLayout(scene.poses, scene.landmarks, scene.truth)
    assert true_base(layout, scene.truth, BASE) == list(BASE)
