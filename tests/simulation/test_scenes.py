"""A scene's truth reproduces its geometry, and its seed reproduces the scene."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mht_slam.association import MISSED
from mht_slam.errors import OptionError
from mht_slam.measurements import RunPair, StraightRun, wrap_angle
from mht_slam.models import ObservationModel
from mht_slam.simulation import (
    Sensor,
    observe_scene,
    simulate_free,
    simulate_pair,
    simulate_scene,
)

WORLDS = ["annulus", "one_sided", "corridor", "clusters"]
SEEDS = st.integers(0, 2**32 - 1)
CLUTTERED = ObservationModel(
    sigma=0.02,
    heading_sigma=0.05,
    lateral_sigma=0.03,
    landmark_sigma=5.0,
    detection_probability=0.7,
    false_alarm_rate=0.3,
    expected_landmarks=6.0,
)


def bearing_errors(scene):
    """Measured minus true bearing of every detection that the truth gives to a landmark."""
    errors = []
    for row, landmark in zip(scene.truth.table, scene.landmarks, strict=True):
        for scan, detection in enumerate(row):
            if detection != MISSED:
                x, y, theta = scene.poses[scan]
                expected = math.atan2(landmark[1] - y, landmark[0] - x) - theta
                errors.append(wrap_angle(scene.scans[scan].bearings[detection] - expected))
    return np.array(errors)


def bytes_of(scene):
    arrays = [scene.truth.table, scene.poses, scene.landmarks, scene.unseen_landmarks]
    arrays += [scan.bearings for scan in scene.scans]
    return b"".join(array.tobytes() for array in arrays)


@given(st.sampled_from(WORLDS), st.integers(0, 8), SEEDS, st.integers(3, 6))
@settings(deadline=None)
def test_every_detection_lies_inside_epsilon_of_its_true_landmark(kind, n, seed, n_scans):
    scene = simulate_scene(kind, n, np.random.default_rng(seed), epsilon=0.05, n_scans=n_scans)
    assert scene.run.n_detections == scene.truth.n_detections == (n,) * n_scans
    assert scene.truth.is_full
    assert scene.landmarks.shape == (n, 2)
    assert (np.abs(bearing_errors(scene)) < 0.05).all()


@given(st.sampled_from(WORLDS), st.integers(3, 6), SEEDS)
@settings(deadline=None)
def test_a_straight_scene_has_the_runs_frame_and_a_common_heading(kind, n, seed):
    poses = simulate_scene(kind, n, np.random.default_rng(seed), sigma=0.02).poses
    np.testing.assert_array_equal(poses[:2], [[0, 0, 0], [1, 0, 0]])
    assert not poses[:, 1:].any()
    assert (np.diff(poses[:, 0]) > 0).all()


@given(SEEDS)
@settings(deadline=None)
def test_rows_of_landmarks_follow_the_truth_despite_misses_and_false_alarms(seed):
    scene = simulate_scene("model", None, np.random.default_rng(seed), model=CLUTTERED)
    assert len(scene.landmarks) == scene.truth.n_landmarks
    assert (np.abs(bearing_errors(scene)) < 8 * CLUTTERED.sigma).all()


@pytest.mark.parametrize(
    "simulate",
    [
        *(
            lambda rng, kind=kind: simulate_scene(kind, 5, rng, epsilon=0.05, heading_sigma=0.1)
            for kind in WORLDS
        ),
        lambda rng: simulate_scene("model", None, rng, model=CLUTTERED),
        lambda rng: simulate_pair("annulus", 4, rng, sigma=0.01),
        lambda rng: simulate_free(6, rng, sigma=0.01),
    ],
)
def test_one_seed_gives_the_same_bytes_and_another_seed_others(simulate):
    first, again, other = (simulate(np.random.default_rng(seed)) for seed in (7, 7, 8))
    assert bytes_of(first) == bytes_of(again)
    assert bytes_of(first) != bytes_of(other)


def test_one_seed_keeps_world_and_order_when_only_the_noise_grows():
    small, large = (
        simulate_scene("annulus", 5, np.random.default_rng(3), epsilon=epsilon)
        for epsilon in (0.01, 0.02)
    )
    np.testing.assert_array_equal(small.landmarks, large.landmarks)
    assert small.truth == large.truth
    np.testing.assert_allclose(2 * bearing_errors(small), bearing_errors(large), atol=1e-12)


@given(SEEDS)
@settings(deadline=None)
def test_mirroring_the_world_mirrors_the_bearings(seed):
    rng = np.random.default_rng(seed)
    poses = np.column_stack([[0.0, 1.0, 2.2], [0.0, 0.0, 0.1], rng.normal(0, 0.2, 3)])
    landmarks = rng.uniform(-5.0, 5.0, (5, 2))
    left, right = (
        observe_scene(
            "mirror",
            "straight",
            poses * [1, sign, sign],
            landmarks * [1, sign],
            Sensor(0.0),
            np.random.default_rng(seed),
        )
        for sign in (1, -1)
    )
    assert left.truth == right.truth
    for mine, mirrored in zip(left.scans, right.scans, strict=True):
        np.testing.assert_allclose(wrap_angle(mine.bearings + mirrored.bearings), 0.0, atol=1e-12)


def test_a_scene_of_a_model_has_its_statistics():
    rng = np.random.default_rng(0)
    scenes = [simulate_scene("model", None, rng, model=CLUTTERED, n_scans=4) for _ in range(1500)]
    everything = np.vstack([np.vstack([s.landmarks, s.unseen_landmarks]) for s in scenes])
    headings = np.concatenate([s.poses[:, 2] for s in scenes])
    lateral = np.concatenate([s.poses[2:, 1] for s in scenes])
    log_steps = np.log(np.concatenate([np.diff(s.poses[1:, 0]) for s in scenes]))
    false = np.mean([len(s.truth.false_alarms) / 4 for s in scenes])
    seen = sum((s.truth.table != MISSED).sum() for s in scenes) / (4 * len(everything))
    assert len(everything) / len(scenes) == pytest.approx(6.0, rel=0.03)
    assert everything.std(axis=0) == pytest.approx([5.0, 5.0], rel=0.03)
    assert headings.std() == pytest.approx(0.05, rel=0.03)
    assert lateral.std() == pytest.approx(0.03, rel=0.04)
    assert (log_steps.mean(), log_steps.std()) == pytest.approx((0.0, 1.0), abs=0.05)
    assert false == pytest.approx(0.3 * 2 * math.pi, rel=0.03)
    assert seen == pytest.approx(0.7, abs=0.01)
    errors = np.concatenate([bearing_errors(s) for s in scenes])
    assert errors.std() == pytest.approx(CLUTTERED.sigma, rel=0.03)


def test_a_smooth_model_scene_has_landmarks_that_come_and_leave_and_a_limited_view():
    model = ObservationModel(
        sigma=0.005,
        bearing_dof=4.0,
        motion="smooth",
        landmark_sigma=4.0,
        detection_probability=0.8,
        false_alarm_rate=0.1,
        expected_landmarks=9.0,
        stay_probability=0.7,
        field_of_view=math.pi,
    )
    rng = np.random.default_rng(3)
    scenes = [simulate_scene("model", None, rng, model=model, n_scans=5) for _ in range(600)]
    landmarks = np.mean([len(s.landmarks) + len(s.unseen_landmarks) for s in scenes])
    assert landmarks == pytest.approx(9.0 * (1.0 + 4 * 0.3), rel=0.03)
    bearings = np.concatenate([scan.bearings for s in scenes for scan in s.scans])
    assert (np.abs(bearings) < 0.5 * math.pi + 0.2).all()
    # The first scan sees the half of the plane before it; the centre lies half a baseline ahead.
    first = np.mean([(s.truth.table[:, 0] != MISSED).sum() for s in scenes])
    ahead = 0.5 * (1.0 + math.erf(0.5 / 4.0 / math.sqrt(2.0)))
    assert first == pytest.approx(0.8 * 9.0 * ahead, rel=0.05)
    false = np.mean([len(s.truth.false_alarms) / 5 for s in scenes])
    assert false == pytest.approx(0.1 * math.pi, rel=0.08)
    errors = np.concatenate([bearing_errors(s) for s in scenes])
    assert np.mean(np.abs(errors) < 0.7407 * 0.005) == pytest.approx(0.5, abs=0.02)  # t's quartile
    assert np.abs(np.concatenate([s.poses[2:, 1] for s in scenes])).max() > 0.0


def test_a_model_without_detection_terms_sees_every_landmark_and_nothing_else():
    scene = simulate_scene(
        "model", 4, np.random.default_rng(1), model=ObservationModel(sigma=0.01), n_scans=5
    )
    assert scene.truth.is_full
    assert scene.truth.n_landmarks == 4
    assert len(scene.unseen_landmarks) == 0


@given(st.sampled_from(WORLDS), SEEDS)
@settings(deadline=None)
def test_each_run_of_a_pair_is_straight_with_forward_its_direction_of_travel(kind, seed):
    scene = simulate_pair(kind, 4, np.random.default_rng(seed), epsilon=0.05)
    assert isinstance(scene.pair, RunPair)
    assert scene.truth.n_scans == 4
    assert (np.abs(bearing_errors(scene)) < 0.05).all()
    for one, two in (scene.poses[:2], scene.poses[2:]):
        travel = math.atan2(two[1] - one[1], two[0] - one[0])
        assert wrap_angle(travel - one[2]) == pytest.approx(0.0, abs=1e-9)
        assert one[2] == two[2]


def test_a_scene_is_read_only_as_what_it_is():
    rng = np.random.default_rng(0)
    straight = simulate_scene("annulus", 3, rng, sigma=0.01)
    pair = simulate_pair("annulus", 3, rng, sigma=0.01)
    free = simulate_free(3, rng, sigma=0.01)
    assert isinstance(straight.run, StraightRun)
    for scene, attribute in ((straight, "pair"), (pair, "run"), (free, "run"), (free, "pair")):
        with pytest.raises(OptionError, match="motion"):
            getattr(scene, attribute)
    with pytest.raises(ValueError, match="read-only"):
        straight.poses[0, 0] = 1.0


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"kind": "ring", "sigma": 0.1}, "kind"),
        ({}, "no noise"),
        ({"sigma": 0.1, "epsilon": 0.1}, "epsilon and sigma"),
        ({"sigma": 0.1, "n_scans": 2}, "n_scans"),
        ({"sigma": 0.1, "steps": [1.0, 2.0]}, "steps"),
        ({"sigma": 0.1, "steps": [-1.0]}, "steps"),
        ({"sigma": 0.1, "n_landmarks": None}, "n_landmarks"),
        ({"sigma": 0.1, "model": CLUTTERED}, "model"),
        ({"kind": "model"}, "model"),
        ({"kind": "model", "model": CLUTTERED, "sigma": 0.1}, "sigma"),
        ({"kind": "model", "model": ObservationModel(sigma=0.1), "n_landmarks": None}, "expected"),
        ({"kind": "model", "model": ObservationModel(sigma=0.1, motion="free")}, "motion"),
        (
            {
                "kind": "model",
                "model": ObservationModel(sigma=0.1, motion="smooth"),
                "steps": [1.0],
            },
            "steps",
        ),
    ],
)
def test_options_that_make_no_sense_are_named(options, named):
    options = {"kind": "annulus", "n_landmarks": 3, **options}
    with pytest.raises(OptionError, match=named):
        simulate_scene(rng=np.random.default_rng(0), **options)


def test_given_steps_are_taken():
    scene = simulate_scene(
        "annulus", 3, np.random.default_rng(0), sigma=0.1, n_scans=4, steps=[0.5, 2.0]
    )
    assert scene.poses[:, 0].tolist() == [0.0, 1.0, 1.5, 3.5]
