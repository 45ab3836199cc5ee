"""Which cells the calibration study has, in the order in which they are run."""

from __future__ import annotations

from calibration_cells import Cell, Kind

SIZES = (3, 4, 5, 6)
EPSILONS_DEG = (1.0, 3.0, 5.0, 7.0)
NEAR, FAR = 5.0, 30.0
"""Standard deviations of the landmark prior, baselines: landmarks close by, and the default."""

JITTER_DEG = (1.0, 3.0)
MISMATCH: tuple[Kind, ...] = ("uniform noise", "annulus", "one_sided")


def all_cells() -> list[Cell]:
    """Every cell of the study: those drawn from the model first."""
    near = [Cell("model", n, epsilon, NEAR) for n in SIZES for epsilon in EPSILONS_DEG]
    far = [Cell("model", n, 5.0, FAR) for n in SIZES]
    jitter = [
        Cell("model", n, 3.0, NEAR, heading_sigma_deg=heading)
        for heading in JITTER_DEG
        for n in (3, 4)
    ]
    clutter = [Cell("model", 3, 3.0, prior, detections=True) for prior in (NEAR, FAR)]
    others = [
        Cell(kind, n, epsilon, NEAR if kind == "uniform noise" else FAR)
        for kind in MISMATCH
        for n in (3, 5)
        for epsilon in (3.0, 5.0)
    ]
    return near + far + jitter + clutter + others
