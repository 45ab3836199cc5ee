"""The calibration: columns to bearings and back, direction, mounting and offset."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.errors import OptionError
from mht_slam.measurements import wrap_angle
from mht_slam.vision import PanoramaCamera, Ring

ANGLES = st.floats(-10.0, 10.0)
DIRECTIONS = st.sampled_from(["clockwise", "counter-clockwise"])


@given(ANGLES, DIRECTIONS, st.floats(-math.pi, math.pi), st.integers(8, 5000))
def test_columns_and_bearings_are_each_others_inverse(
    mounting: float, direction: str, bearing: float, width: int
) -> None:
    camera = PanoramaCamera(mounting_angle=mounting, direction=direction)
    column = camera.columns([bearing], width)
    assert 0.0 <= column[0] < width
    assert abs(wrap_angle(float(camera.bearings(column, width)[0]) - bearing)) < 1e-9


def test_clockwise_bearings_fall_from_left_to_right() -> None:
    assert np.degrees(PanoramaCamera().bearings([0, 90], 360)).tolist() == [0.0, -90.0]
    mirrored = PanoramaCamera(direction="counter-clockwise")
    assert np.degrees(mirrored.bearings([0, 90], 360)).tolist() == [0.0, 90.0]


def test_the_mounting_angle_is_the_bearing_of_column_0() -> None:
    camera = PanoramaCamera(mounting_angle=math.radians(30.0))
    assert np.degrees(camera.bearings([0.0, 30.0], 360)) == pytest.approx([30.0, 0.0])


@given(ANGLES, ANGLES, ANGLES, st.tuples(ANGLES, ANGLES))
def test_robot_poses_undo_camera_poses(
    x: float, y: float, heading: float, offset: tuple[float, float]
) -> None:
    camera = PanoramaCamera(offset=offset)
    back = camera.robot_poses(camera.camera_poses([[x, y, heading]]))
    assert back == pytest.approx(np.array([[x, y, heading]]), abs=1e-9)


def test_a_camera_ahead_of_the_robot_leaves_the_robot_behind() -> None:
    camera = PanoramaCamera(offset=(0.5, 0.0))
    poses = camera.robot_poses([[1.0, 2.0, math.pi / 2]])
    assert poses == pytest.approx(np.array([[1.0, 1.5, math.pi / 2]]))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"mounting_angle": math.nan}, "mounting_angle"),
        ({"direction": "left"}, "direction is 'left'"),
        ({"offset": 1.0}, "offset"),
        ({"offset": (1.0, math.inf)}, "offset leftward"),
        ({"ring": (1, 2, 3, 4)}, "give a Ring"),
    ],
)
def test_a_calibration_that_makes_no_sense_is_refused(options: dict, words: str) -> None:
    with pytest.raises(OptionError, match=words):
        PanoramaCamera(**options)


def test_a_ring_has_two_circles() -> None:
    with pytest.raises(OptionError, match="outer_radius"):
        Ring(100.0, 100.0, 50.0, 40.0)
    with pytest.raises(OptionError, match="inner_radius"):
        Ring(100.0, 100.0, 0.0, 40.0)


def test_poses_of_another_shape_are_refused() -> None:
    with pytest.raises(OptionError, match=r"camera_poses has shape \(3,\)"):
        PanoramaCamera().robot_poses([1.0, 2.0, 3.0])
