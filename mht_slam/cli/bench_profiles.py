"""The sweeps that `mht-slam bench compare` runs when no settings are named."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal, TypeAlias

if TYPE_CHECKING:
    from mht_slam.evaluation.bench.sweep import Sweep

Profile: TypeAlias = Literal["quick", "standard", "long"]

SCENES = {"quick": 4, "standard": 25, "long": 100}
"""Scenes of each cell."""


def profile_sweeps(profile: Profile) -> tuple[list[Sweep], int]:
    """Return the sweeps of a profile and its scenes a cell.

    Every profile has the noise of both kinds; standard adds a second number of landmarks, headings
    that wander, misses with clutter, and longer runs; long adds sizes and layouts.
    """
    from mht_slam.evaluation.bench.sweep import Sweep

    degrees = math.radians
    wide = profile == "long"
    if profile == "quick":
        return [Sweep(landmarks=(3,), epsilons=(degrees(3), degrees(6)))], SCENES[profile]
    noise = Sweep(
        kinds=("annulus", "one_sided", "corridor", "clusters", "model")
        if wide
        else ("annulus", "model"),
        landmarks=(3, 4, 5, 6) if wide else (3, 4),
        epsilons=tuple(map(degrees, (1, 2, 3, 5, 7) if wide else (1, 3, 6))),
    )
    headings = Sweep(
        kinds=("annulus",),
        landmarks=(3, 4) if wide else (3,),
        noises=("gaussian",),
        epsilons=(degrees(3),),
        heading_sigmas=(degrees(1), degrees(3)),
    )
    clutter = Sweep(
        kinds=("model",),
        landmarks=(3, 4) if wide else (4,),
        epsilons=(degrees(3),),
        detection_probabilities=(0.9,),
        false_alarms=(0.3,),
        landmark_sigma=5.0,
    )
    longer = Sweep(
        kinds=("annulus",),
        landmarks=(4,),
        noises=("gaussian",),
        epsilons=(degrees(6),),
        n_scans=(5, 8) if wide else (5,),
    )
    return [noise, headings, clutter, longer], SCENES[profile]
