"""Landmark layouts around a run: where the look-alike landmarks stand.

Every layout is an (n, 2) array in the run's frame, O1 = (0, 0) and O2 = (1, 0), in baselines.
`length` is the distance from O1 to the last observation point.
"""

from __future__ import annotations

import math

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, finite_number, whole_number
from mht_slam.models import ObservationModel

ANNULUS_RADII = (0.75, 2.0)
"""Inner and outer radius of `annulus`, in lengths of the run: the run lies inside the hole."""

LONG_STEPS = (4.0, 5.0)
"""Steps of the one-sided scene, in the unit of `ONE_SIDED_X` and `ONE_SIDED_Y`."""
ONE_SIDED_X = (-1.0, 10.0)
ONE_SIDED_Y = (2.0, 9.0)

CORRIDOR_MARGIN = 1.0
"""How far a corridor goes on before O1 and after the last observation point, baselines."""
CORRIDOR_Y = (0.5, 2.0)
"""Distance of a corridor's landmarks from the path, baselines, on either side."""

CLUSTER_SIZE = 3
"""Landmarks in a cluster, as far as n allows; there are always two clusters at least."""
CLUSTER_SPREAD = 0.1
"""Standard deviation per axis of a cluster, in lengths of the run."""


def annulus(n: int, rng: np.random.Generator, length: float = 2.0) -> FloatArray:
    """Landmarks uniform over the ring around the middle of the run, (n, 2) baselines.

    The radii are `ANNULUS_RADII` lengths of the run, so the robot stays inside the ring.
    """
    _check(n, length)
    inner, outer = (radius * length for radius in ANNULUS_RADII)
    # Uniform over an area means uniform in the square of the radius.
    radius = np.sqrt(rng.uniform(inner**2, outer**2, n))
    angle = rng.uniform(-math.pi, math.pi, n)
    return np.column_stack([0.5 * length + radius * np.cos(angle), radius * np.sin(angle)])


def one_sided(n: int, rng: np.random.Generator) -> FloatArray:
    """Landmarks on the left of a run with long steps, (n, 2) baselines.

    Uniform over `ONE_SIDED_X` x `ONE_SIDED_Y` in a unit in which the steps are `LONG_STEPS`: the
    first baseline is 4 of those units, so the layout here is a quarter of that rectangle.
    """
    _check(n)
    unit = 1.0 / LONG_STEPS[0]
    return unit * np.column_stack([rng.uniform(*ONE_SIDED_X, n), rng.uniform(*ONE_SIDED_Y, n)])


def corridor(n: int, rng: np.random.Generator, length: float = 2.0) -> FloatArray:
    """Landmarks on both sides of the path, alternating sides in a random order, (n, 2) baselines.

    Along the path they are uniform from `CORRIDOR_MARGIN` before O1 to as much after the end.
    """
    _check(n, length)
    x = rng.uniform(-CORRIDOR_MARGIN, length + CORRIDOR_MARGIN, n)
    side = rng.permutation(np.where(np.arange(n) % 2, -1.0, 1.0))
    return np.column_stack([x, side * rng.uniform(*CORRIDOR_Y, n)])


def clusters(n: int, rng: np.random.Generator, length: float = 2.0) -> FloatArray:
    """Landmarks in tight groups, the groups placed as in `annulus`, (n, 2) baselines.

    About `CLUSTER_SIZE` landmarks a group, spread by `CLUSTER_SPREAD` lengths of the run.
    """
    _check(n, length)
    n_groups = max(2, math.ceil(n / CLUSTER_SIZE))
    centres = annulus(n_groups, rng, length)
    members = np.arange(n) % n_groups
    return centres[members] + rng.normal(0.0, CLUSTER_SPREAD * length, (n, 2))


def from_prior(n: int, rng: np.random.Generator, model: ObservationModel) -> FloatArray:
    """Landmarks drawn from the model's landmark prior, (n, 2) baselines."""
    _check(n)
    return rng.normal(model.landmark_centre, model.landmark_sigma, (n, 2))


def stretches(n: int, n_scans: int, rng: np.random.Generator, *, leave: float) -> BoolArray:
    """Which of `n` landmarks is there in which scan, (n_scans, n): one stretch of scans each.

    A landmark leaves between two scans with probability `leave`, and as many come as leave, so that
    a stretch begins in the first scan with weight 1 and in every later one with weight `leave`.

    Source: docs/method.md, section 4.
    """
    _check(n)
    whole_number(n_scans, "n_scans", at_least=1)
    finite_number(leave, "leave", above=0.0, at_most=1.0)
    weights = np.r_[1.0, np.full(n_scans - 1, leave)]
    first = rng.choice(n_scans, size=n, p=weights / weights.sum())
    after = first + rng.geometric(leave, n)
    scan = np.arange(n_scans)[:, None]
    return np.asarray((scan >= first) & (scan < after))


def _check(n: int, length: float = 1.0) -> None:
    whole_number(n, "n_landmarks", at_least=0)
    finite_number(length, "length", above=0.0)
