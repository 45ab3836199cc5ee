"""How a panoramic camera is mounted: which bearing each column of its panorama shows.

A panorama has W columns for a whole turn, rows from top to bottom. A catadioptric camera sees the
panorama as a *ring*, which `mht_slam.vision.unwrapping` opens.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np
import numpy.typing as npt

from mht_slam.arrays import FloatArray, finite_array, finite_number, one_of
from mht_slam.errors import OptionError
from mht_slam.measurements import wrap_angle

Direction: TypeAlias = Literal["clockwise", "counter-clockwise"]

_TURN = 2.0 * math.pi


@dataclass(frozen=True)
class Ring:
    """Where the ring lies in a catadioptric picture. Pixels; pixel (i, j) has its centre there.

    The panorama's column 0 is the ray from the centre to the right of the picture, and columns go
    round as the picture shows it, from the right by the bottom to the left. The outer circle is
    the panorama's top row.

    Raises `OptionError` naming the field, for a ring that is none.
    """

    centre_row: float
    """Row of the centre."""
    centre_column: float
    """Column of the centre."""
    inner_radius: float
    """Radius of the inner circle, where the panorama's lowest row lies."""
    outer_radius: float
    """Radius of the outer circle, where its top row lies."""

    def __post_init__(self) -> None:
        finite_number(self.centre_row, "ring centre_row")
        finite_number(self.centre_column, "ring centre_column")
        finite_number(self.inner_radius, "ring inner_radius", at_least=1.0)
        finite_number(self.outer_radius, "ring outer_radius", at_least=self.inner_radius + 1.0)


@dataclass(frozen=True)
class PanoramaCamera:
    """Calibration of a panoramic camera on a robot.

    Raises `OptionError` naming the field, for a value out of its range.

    >>> camera = PanoramaCamera(mounting_angle=math.pi)
    >>> camera.bearings([0, 180, 270], width=720).round(3).tolist()
    [3.142, 1.571, 0.785]
    """

    mounting_angle: float = 0.0
    """Bearing of the centre of column 0, radians, robot frame, counter-clockwise from forward.
    Where forward is column W / 2, in the middle, it is pi."""
    direction: Direction = "clockwise"
    """How bearings run from left to right, seen from above. Someone who turns to the right turns
    clockwise; a mirror image runs the other way."""
    offset: tuple[float, float] = (0.0, 0.0)
    """Where the camera is in the robot frame: forward and leftward, in the unit of the poses. It
    changes no bearing: the bearings, and all poses estimated from them, are those of the camera's
    own point, and `robot_poses` moves the poses to the robot's."""
    ring: Ring | None = None
    """The ring of a catadioptric picture; None for a panorama."""

    def __post_init__(self) -> None:
        finite_number(self.mounting_angle, "mounting_angle")
        one_of(self.direction, "direction", get_args(Direction))
        if not isinstance(self.offset, tuple) or len(self.offset) != 2:
            raise OptionError(f"offset is {self.offset!r}: give (forward, leftward)")
        for axis, value in zip(("forward", "leftward"), self.offset, strict=True):
            finite_number(value, f"offset {axis}")
        if self.ring is not None and not isinstance(self.ring, Ring):
            raise OptionError(f"ring is {self.ring!r}: give a Ring, or None for a panorama")

    def bearings(self, columns: npt.ArrayLike, width: int) -> FloatArray:
        """Bearings (n,), radians in (-pi, pi], of columns (n,) of a panorama `width` columns wide.

        Column j has its centre at j; fractions are points between centres.
        """
        places = finite_array(columns, "columns", OptionError, remedy="give pixels")
        return wrap_angle(self.mounting_angle + self._sign * _TURN * places / width)

    def columns(self, bearings: npt.ArrayLike, width: int) -> FloatArray:
        """Columns (n,) in [0, width) of a panorama that show these bearings (n,), radians."""
        angles = finite_array(bearings, "bearings", OptionError, remedy="give radians")
        columns = np.mod(self._sign * (angles - self.mounting_angle) * width / _TURN, width)
        return np.where(columns == width, 0.0, columns)

    def robot_poses(self, camera_poses: npt.ArrayLike) -> FloatArray:
        """Poses (m, 3) of the robot's origin from poses (m, 3) estimated with this camera.

        Headings are the same. Positions need a scale: with `offset` in metres, give metres; for a
        run in baselines, state the offset in baselines. Raises `OptionError` for another shape.
        """
        return self._moved(camera_poses, "camera_poses", -1.0)

    def camera_poses(self, robot_poses: npt.ArrayLike) -> FloatArray:
        """Poses (m, 3) of the camera from those of the robot: the inverse of `robot_poses`."""
        return self._moved(robot_poses, "robot_poses", 1.0)

    @property
    def _sign(self) -> float:
        return -1.0 if self.direction == "clockwise" else 1.0

    def _moved(self, value: npt.ArrayLike, name: str, sign: float) -> FloatArray:
        poses = finite_array(value, name, OptionError, remedy="give x, y, theta")
        if poses.ndim != 2 or poses.shape[1] != 3:
            raise OptionError(f"{name} has shape {poses.shape}: give (m, 3): x, y, theta")
        x, y, heading = poses.T
        forward, leftward = self.offset
        return np.column_stack(
            [
                x + sign * (forward * np.cos(heading) - leftward * np.sin(heading)),
                y + sign * (forward * np.sin(heading) + leftward * np.cos(heading)),
                heading,
            ]
        )
