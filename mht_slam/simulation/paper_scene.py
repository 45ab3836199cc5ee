"""The paper's experiment: a lawnmower run past five landmarks, three of them in view.

The paper's numbers exist only in a figure; this layout has the shape it describes (docs/method.md,
section 8), with coordinates of our own. The constants are metres; O1 is the origin and the robot
travels along +x there.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

import numpy as np

from mht_slam.arrays import finite_number, freeze
from mht_slam.simulation import trajectories
from mht_slam.simulation.scenes import Scene, observe_scene
from mht_slam.simulation.sensors import Sensor

LAWNMOWER_TRACK: Final = freeze(
    np.array([[-30.0, 36.0], [20.0, 36.0], [20.0, 18.0], [-30.0, 18.0], [-30.0, 0.0], [20.0, 0.0]])
)
"""(6, 2) corners of the whole run; O1 to O3 lie on its last leg."""

OBSERVATION_POINTS: Final = freeze(np.array([[0.0, 0.0], [12.0, 0.0], [16.5, 0.0]]))
"""(3, 2) O1, O2 and O3. The second step is short, and O3 is the farthest from every landmark."""

METRES_PER_BASELINE: Final = float(OBSERVATION_POINTS[1, 0])
"""Length of the first baseline |O1 O2|, the unit of a scene."""

LANDMARKS: Final = MappingProxyType(
    {
        "La": (-24.0, 10.0),
        "Lb": (-20.0, 26.0),
        "Lc": (-1.0, 9.0),
        "Ld": (6.0, 8.0),
        "Le": (7.0, 15.0),
    }
)
"""Where the landmarks stand; |Lc Le| is ten metres, the unit of F_L."""

SEEN: Final = ("Lc", "Ld", "Le")
"""The landmarks in view of O1, O2 and O3; La and Lb are out of `SENSOR_RANGE` of all three."""

BASE: Final = ("Lc", "Le")
"""The two landmarks that carry the landmark-based frame F_L."""

SENSOR_RANGE: Final = 21.0
"""How far the robot sees, metres."""


def paper_scene(rng: np.random.Generator, epsilon: float, *, deviation: float = 0.0) -> Scene:
    """Simulate the paper's experiment: three scans of three landmarks, noise inside `epsilon`.

    Parameters
    ----------
    epsilon : vision error, radians: the noise is uniform strictly inside it.
    deviation : how far O3 lies left of the line through O1 and O2, metres. The paper's track is
        only nearly straight; at zero it is straight, and the truth lies inside all cones.

    Returns a `Scene` of kind "paper" in the run's frame, in baselines (`OBSERVATION_POINTS` says
    how long one is). Raises `OptionError`.

    >>> paper_scene(np.random.default_rng(0), epsilon=0.05).truth.n_landmarks
    3
    """
    finite_number(epsilon, "epsilon", at_least=0.0)
    finite_number(deviation, "deviation")
    poses = trajectories.straight([OBSERVATION_POINTS[2, 0] / METRES_PER_BASELINE - 1.0])
    poses[2, 1] = deviation / METRES_PER_BASELINE
    landmarks = np.array(list(LANDMARKS.values())) / METRES_PER_BASELINE
    sensor = Sensor(spread=epsilon, noise="uniform", max_range=SENSOR_RANGE / METRES_PER_BASELINE)
    return observe_scene("paper", "straight", poses, landmarks, sensor, rng)
