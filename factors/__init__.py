"""GTSAM factors of bearing-only geometry, for any GTSAM user.

Each function returns one factor (or a tuple of factors) that GTSAM already has in C++: no Python
callback runs inside the optimiser, everything pickles, and the GIL costs nothing extra. Poses are
``Pose2``, landmarks ``Point2``; angles are radians, lengths are whatever the caller's are.

This package imports gtsam and numpy only. It is installed as ``mht_slam.factors``.
"""

from mht_slam.factors.density import FREE_SIGMA as FREE_SIGMA
from mht_slam.factors.density import log_density as log_density
from mht_slam.factors.density import log_normaliser as log_normaliser
from mht_slam.factors.gauge import first_baseline as first_baseline
from mht_slam.factors.gauge import known_distance as known_distance
from mht_slam.factors.gauge import landmark_prior as landmark_prior
from mht_slam.factors.gauge import position_prior as position_prior
from mht_slam.factors.motion import drift as drift
from mht_slam.factors.motion import heading_prior as heading_prior
from mht_slam.factors.motion import log_step as log_step
from mht_slam.factors.motion import odometry as odometry
from mht_slam.factors.motion import on_line as on_line
from mht_slam.factors.motion import smooth_motion as smooth_motion
from mht_slam.factors.motion import standstill as standstill
from mht_slam.factors.motion import step_change as step_change
from mht_slam.factors.motion import straight_segment as straight_segment
from mht_slam.factors.motion import turn as turn
from mht_slam.factors.sightings import bearing as bearing
from mht_slam.factors.sightings import bearing_and_range as bearing_and_range
from mht_slam.factors.sightings import landmark_range as landmark_range
from mht_slam.factors.sightings import log_range_volume as log_range_volume

__all__ = [
    "FREE_SIGMA",
    "bearing",
    "bearing_and_range",
    "drift",
    "first_baseline",
    "heading_prior",
    "known_distance",
    "landmark_prior",
    "landmark_range",
    "log_density",
    "log_normaliser",
    "log_range_volume",
    "log_step",
    "odometry",
    "on_line",
    "position_prior",
    "smooth_motion",
    "standstill",
    "step_change",
    "straight_segment",
    "turn",
]
