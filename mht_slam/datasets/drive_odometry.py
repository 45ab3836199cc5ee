"""From a vehicle's speeds to odometry between scans, with a stated covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.measurements import Odometry, wrap_angle


@dataclass(frozen=True)
class StepNoise:
    """Standard deviations of a step as a floor and a share: independent errors, Gaussian."""

    floor: float
    """Of forward and sideways motion, metres, whatever the distance."""
    forward_share: float
    """Of forward motion, metres a metre."""
    lateral_share: float
    """Of sideways motion, metres a metre."""
    turn_floor: float
    """Of a change of heading, radians, whatever the motion."""
    turn_per_metre: float
    """Of a change of heading, radians a metre."""
    turn_share: float
    """Of a change of heading, radians a radian."""

    def odometry(self, motion: FloatArray) -> Odometry:
        """Return a motion (dx, dy, dtheta) with the covariance of its length and turn."""
        dx, dy, dtheta = motion.tolist()
        distance = math.hypot(dx, dy)
        sigmas = (
            math.hypot(self.floor, self.forward_share * distance),
            math.hypot(self.floor, self.lateral_share * distance),
            math.hypot(self.turn_floor, self.turn_per_metre * distance, self.turn_share * dtheta),
        )
        return Odometry(dx, dy, dtheta, np.square(sigmas))


@dataclass(frozen=True)
class CarGeometry:
    """Where a steered car measures its speed and carries its sensor, metres."""

    wheelbase: float
    """From the rear axle to the front axle."""
    wheel_offset: float
    """From the middle of the rear axle to its left wheel, which measures the speed."""
    sensor_ahead: float
    """From the middle of the rear axle forward to the sensor."""
    sensor_left: float
    """And to the left."""

    def twists(self, speeds: FloatArray, steering: FloatArray) -> FloatArray:
        """Speeds of the sensor from (k,) speeds of the left wheel and (k,) steering angles.

        Returns (k, 3): forward and to the left, metres a second, and turn rate, radians a second.
        The model of a bicycle: the left wheel is nearer to the centre of a left turn than the
        middle of the axle, and the sensor swings out.
        """
        curvature = np.tan(steering) / self.wheelbase
        of_axle = speeds / (1.0 - self.wheel_offset * curvature)
        turn = of_axle * curvature
        return np.column_stack([of_axle - self.sensor_left * turn, self.sensor_ahead * turn, turn])


UTILITY_VEHICLE = CarGeometry(2.83, 0.76, 3.78, 0.5)
"""The car of the Victoria Park recording: L, H, a and b as the ACFR publishes them.

J. Guivant and E. Nebot, "Optimization of the simultaneous localization and map-building algorithm
for real-time implementation", IEEE Transactions on Robotics and Automation 17(3), 2001, with the
notes to the recording.
"""
UTILITY_VEHICLE_NOISE = StepNoise(
    floor=0.005,
    forward_share=0.015,
    lateral_share=0.03,
    turn_floor=0.0005,
    turn_per_metre=0.003,
    turn_share=0.05,
)
"""Rounded from odometry minus reference in the straight windows at even places (tuning half).

Its steering angle has an offset, about a third of a degree of heading for ten metres, which is in
the turn's share of the distance.
"""


def integrated_motions(times: FloatArray, twists: FloatArray, at: FloatArray) -> FloatArray:
    """Integrate speeds from scan to scan.

    Parameters
    ----------
    times : (k,) seconds, not decreasing.
    twists : (k, 3) speed forward and to the left, metres a second, and turn rate, radians a second,
        each held from its time to the next; the first one holds before it too.
    at : (m,) times of the scans, seconds, increasing.

    Returns
    -------
    (m - 1, 3) motions dx, dy, dtheta, in the frame of the earlier scan.
    """
    moments = np.union1d(times, at)
    held = np.maximum(np.searchsorted(times, moments[:-1], side="right") - 1, 0)
    steps = twists[held] * np.diff(moments)[:, None]
    headings = np.r_[0.0, np.cumsum(steps[:, 2])]
    # A chord lies half way between the headings at its ends.
    middle = 0.5 * (headings[:-1] + headings[1:])
    c, s = np.cos(middle), np.sin(middle)
    moved = np.column_stack([c * steps[:, 0] - s * steps[:, 1], s * steps[:, 0] + c * steps[:, 1]])
    places = np.vstack([np.zeros((1, 2)), np.cumsum(moved, axis=0)])
    of_scans = np.searchsorted(moments, at)
    return relative_motions(np.column_stack([places, headings])[of_scans])


def relative_motions(poses: FloatArray) -> FloatArray:
    """Motions (m - 1, 3) from pose to pose of (m, 3), in the frame of the earlier one."""
    moved = np.diff(poses, axis=0)
    c, s = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    forward, left = c * moved[:, 0] + s * moved[:, 1], c * moved[:, 1] - s * moved[:, 0]
    return np.column_stack([forward, left, wrap_angle(moved[:, 2])])
