"""Observation models to start from, with where their numbers come from."""

from __future__ import annotations

import math

from mht_slam.models import ObservationModel


def panoramic_robot() -> ObservationModel:
    """Return a model of a slowly driving robot that sees all around, without odometry.

    Generic values that make sense, fitted to nothing: bearings good to a degree with tails, an
    unhurried path, ten landmarks in view within some fifteen baselines, one in ten missed, a false
    alarm in every third scan or so.

    >>> panoramic_robot().compares_sizes
    True
    """
    return ObservationModel(
        sigma=math.radians(1.0),
        bearing_dof=4.0,
        motion="smooth",
        turn_sigma=math.radians(4.0),
        drift_sigma=math.radians(5.0),
        step_change_sigma=0.2,
        landmark_sigma=15.0,
        detection_probability=0.9,
        false_alarm_rate=0.05,
        expected_landmarks=10.0,
        stay_probability=0.97,
    )


def forward_camera() -> ObservationModel:
    """Return a model of a robot with a camera that looks ahead, without odometry.

    Fitted to the tuning half of the DLR recording's ``relaxed`` segments, those of at most 20
    scans, and rounded (``benchmarks/recordings/fit_models.py``); the tails are chosen there by F1.
    The first two scans are .16 m apart there at the median, which is the unit of its lengths.
    """
    return ObservationModel(
        sigma=math.radians(0.145),
        bearing_dof=8.0,
        motion="smooth",
        turn_sigma=math.radians(3.2),
        drift_sigma=math.radians(3.5),
        step_change_sigma=0.085,
        landmark_sigma=13.0,
        detection_probability=0.98,
        false_alarm_rate=0.045,
        expected_landmarks=19.0,
        stay_probability=0.91,
        field_of_view=math.radians(110.0),
    )


def laser() -> ObservationModel:
    """Return a model of a vehicle with a laser that sees the half circle ahead, without odometry.

    Fitted to the tuning half of the straight windows of the Victoria Park recording, those of at
    most 20 scans, and rounded (``benchmarks/recordings/fit_models.py``); detection and visibility
    lie between that fit and what the labels count, and the tails are chosen. The vehicle may stand
    still. The first two scans are .6 m apart there at the median, which is the unit of its
    lengths; its false alarms are whatever is no tree trunk that stays.
    """
    return ObservationModel(
        sigma=math.radians(0.12),
        bearing_dof=4.0,
        motion="smooth",
        turn_sigma=math.radians(1.0),
        drift_sigma=math.radians(5.5),
        step_change_sigma=0.06,
        stops=True,
        landmark_sigma=35.0,
        detection_probability=0.8,
        false_alarm_rate=0.15,
        expected_landmarks=22.0,
        stay_probability=0.97,
        field_of_view=math.radians(182.0),
    )
