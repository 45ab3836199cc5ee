"""A sensor reports what it can see, in an order that tells nothing."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.errors import OptionError
from mht_slam.measurements import wrap_angle
from mht_slam.models import ObservationModel
from mht_slam.simulation import Sensor
from mht_slam.simulation.sensors import bearings_and_ranges

ORIGIN = np.zeros(3)
SEEDS = st.integers(0, 2**32 - 1)


def errors_of(sensor, pose, landmarks, seed):
    seen = sensor.observe(pose, landmarks, np.random.default_rng(seed))
    real = seen.landmark_of_detection >= 0
    away = landmarks[seen.landmark_of_detection[real]] - pose[:2]
    expected = np.arctan2(away[:, 1], away[:, 0]) - pose[2]
    return wrap_angle(seen.scan.bearings[real] - expected)


@given(SEEDS, st.floats(1e-6, 0.5), st.floats(-3.0, 3.0))
def test_uniform_noise_stays_strictly_inside_its_bound(seed, epsilon, heading):
    rng = np.random.default_rng(seed)
    landmarks = rng.uniform(-5.0, 5.0, (30, 2))
    pose = np.array([0.3, -0.2, heading])
    errors = errors_of(Sensor(epsilon, "uniform"), pose, landmarks, seed)
    assert len(errors) == 30
    assert (np.abs(errors) < epsilon).all()


def test_gaussian_and_heavy_tailed_noise_have_the_stated_spread():
    landmarks = np.random.default_rng(0).uniform(-5.0, 5.0, (20_000, 2))
    gaussian = errors_of(Sensor(0.02), ORIGIN, landmarks, 1)
    heavy = errors_of(Sensor(0.02, "heavy_tailed"), ORIGIN, landmarks, 1)
    assert gaussian.std() == pytest.approx(0.02, rel=0.03)
    # Quartiles of Student's t with three degrees of freedom: +-0.7649 of its scale.
    assert np.mean(np.abs(heavy) < 0.7649 * 0.02) == pytest.approx(0.5, abs=0.02)
    assert np.mean(np.abs(heavy) > 4 * 0.02) > 20 * np.mean(np.abs(gaussian) > 4 * 0.02)


def test_a_noiseless_bearing_is_the_angle_in_the_robot_frame():
    bearings, ranges = bearings_and_ranges(
        np.array([1.0, 1.0, math.pi / 2]), np.array([[1.0, 3.0], [0.0, 1.0], [1.0, 0.0]])
    )
    np.testing.assert_allclose(bearings, [0.0, math.pi / 2, math.pi], atol=1e-12)
    np.testing.assert_allclose(ranges, [2.0, 1.0, 1.0])


@given(SEEDS)
def test_view_and_range_limits_decide_by_the_true_geometry(seed):
    rng = np.random.default_rng(seed)
    landmarks = rng.uniform(-5.0, 5.0, (40, 2))
    sensor = Sensor(0.1, field_of_view=2.0, min_range=1.0, max_range=4.0)
    seen = sensor.observe(ORIGIN, landmarks, rng).landmark_of_detection
    distance = np.hypot(landmarks[:, 0], landmarks[:, 1])
    angle = np.arctan2(landmarks[:, 1], landmarks[:, 0])
    expected = (np.abs(angle) <= 1.0) & (distance >= 1.0) & (distance <= 4.0)
    assert sorted(seen.tolist()) == np.flatnonzero(expected).tolist()


def test_misses_and_false_alarms_come_at_their_rates():
    rng = np.random.default_rng(5)
    landmarks = rng.uniform(-5.0, 5.0, (10, 2))
    sensor = Sensor(
        0.01, field_of_view=3.0, max_range=100.0, detection_probability=0.7, false_alarm_rate=0.4
    )
    looks = [sensor.observe(ORIGIN, landmarks, rng) for _ in range(4000)]
    in_view = int((np.abs(np.arctan2(landmarks[:, 1], landmarks[:, 0])) <= 1.5).sum())
    assert in_view > 0
    real = np.array([(look.landmark_of_detection >= 0).sum() for look in looks])
    false = np.array([(look.landmark_of_detection < 0).sum() for look in looks])
    assert real.mean() == pytest.approx(0.7 * in_view, rel=0.03)
    assert false.mean() == pytest.approx(0.4 * 3.0, rel=0.05)
    assert false.var() == pytest.approx(0.4 * 3.0, rel=0.1), "Poisson"
    alarms = np.concatenate([k.scan.bearings[k.landmark_of_detection < 0] for k in looks])
    assert np.abs(alarms).max() <= 1.5
    assert np.mean(np.abs(alarms) < 0.75) == pytest.approx(0.5, abs=0.03)


def test_a_nearer_disc_hides_the_landmark_behind_it_and_not_the_one_beside():
    landmarks = np.array([[2.0, 0.0], [5.0, 0.2], [5.0, 1.0], [-5.0, 0.0]])
    seen = Sensor(0.0, landmark_radius=0.2).observe(ORIGIN, landmarks, np.random.default_rng(0))
    assert sorted(seen.landmark_of_detection.tolist()) == [0, 2, 3]
    open_view = Sensor(0.0).observe(ORIGIN, landmarks, np.random.default_rng(0))
    assert len(open_view.scan) == 4


def test_occlusion_works_across_the_cut_behind_the_robot():
    landmarks = np.array([[-2.0, 0.01], [-5.0, -0.01]])
    seen = Sensor(0.0, landmark_radius=0.1).observe(ORIGIN, landmarks, np.random.default_rng(0))
    assert seen.landmark_of_detection.tolist() == [0]


def test_the_order_of_detections_tells_nothing():
    landmarks = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
    rng = np.random.default_rng(2)
    orders = [tuple(Sensor(0.0).observe(ORIGIN, landmarks, rng).landmark_of_detection)
              for _ in range(3000)]  # fmt: skip
    counts = np.unique(orders, axis=0, return_counts=True)[1]
    assert len(counts) == 6
    assert counts.min() > 400


def test_the_sensor_of_a_model_has_its_noise_and_detection_terms():
    plain = Sensor.of_model(ObservationModel(sigma=0.03))
    assert (plain.noise, plain.spread) == ("gaussian", 0.03)
    assert (plain.detection_probability, plain.false_alarm_rate) == (1.0, 0.0)
    stated = Sensor.of_model(
        ObservationModel(sigma=0.03, detection_probability=0.8, false_alarm_rate=0.2)
    )
    assert (stated.detection_probability, stated.false_alarm_rate) == (0.8, 0.2)
    forward = Sensor.of_model(ObservationModel(sigma=0.03, bearing_dof=5.0, field_of_view=2.0))
    assert (forward.noise, forward.dof, forward.field_of_view) == ("heavy_tailed", 5.0, 2.0)


def test_heavier_tails_have_fewer_degrees_of_freedom():
    landmarks = np.random.default_rng(0).uniform(-5.0, 5.0, (20_000, 2))
    far = [
        np.mean(np.abs(errors_of(Sensor(0.02, "heavy_tailed", dof=dof), ORIGIN, landmarks, 1)) > t)
        for dof, t in ((2.0, 0.02 * 4.3027), (8.0, 0.02 * 2.3060))  # their 97.5 % quantiles
    ]
    assert far == pytest.approx([0.05, 0.05], abs=0.005)


@pytest.mark.parametrize(
    "options",
    [
        {"spread": -0.1},
        {"spread": 0.1, "noise": "laplace"},
        {"spread": 0.1, "field_of_view": 7.0},
        {"spread": 0.1, "min_range": 3.0, "max_range": 2.0},
        {"spread": 0.1, "detection_probability": 1.1},
        {"spread": 0.1, "false_alarm_rate": -1.0},
        {"spread": 0.1, "landmark_radius": math.nan},
        {"spread": 0.1, "dof": 0.0},
    ],
)
def test_an_option_out_of_range_is_named(options):
    with pytest.raises(OptionError, match=list(options)[-1]):
        Sensor(**options)
