"""The measured side of a factor graph: bearings, their noise, and the model they come with."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray, finite_number, freeze
from mht_slam.association import MISSED
from mht_slam.errors import OptionError
from mht_slam.measurements import BearingScan, Odometry, RunPair, StraightRun
from mht_slam.models import ObservationModel

ZERO_SIGMA = 1e-4
"""What a heading or lateral sigma of zero means in the graph: radians, baselines.

Loose enough for the linear algebra, tight enough that no evidence notices (docs/method.md, 4).
"""

SHORTEST_BASELINE, LONGEST_BASELINE = 1e-3, 1e4
"""Metres within which the graph's gauges are tight and its free directions free."""


@dataclass(frozen=True)
class Problem:
    """Scans to solve together, with everything assumed about them.

    Attributes
    ----------
    scans : m scans.
    sigmas : for each scan the (n_detections,) standard deviations of its bearings, radians.
    model : lengths in the problem's unit.
    baseline : |O1 O2| in the problem's unit.
    second_run : index of the first scan of a second straight run, or None.
    """

    scans: tuple[BearingScan, ...]
    sigmas: tuple[FloatArray, ...]
    model: ObservationModel
    baseline: float = 1.0
    second_run: int | None = None

    @property
    def heading_sigma(self) -> float:
        """Standard deviation of a heading in the graph, radians; never zero."""
        return max(self.model.heading_sigma, ZERO_SIGMA)

    @property
    def lateral_sigma(self) -> float:
        """Deviation of scans 3 and later from the line; never zero."""
        return max(self.model.lateral_sigma, ZERO_SIGMA * self.baseline)

    @property
    def free_steps(self) -> tuple[tuple[int, int], ...]:
        """Pairs of consecutive scans of one run whose distance has a prior in logarithms."""
        if self.model.motion == "odometry":
            return ()
        m = len(self.scans)
        return tuple((k, k + 1) for k in range(1, m - 1) if k + 1 != self.second_run)

    def free_lengths(self, poses: FloatArray) -> FloatArray:
        """Return the distances of `free_steps` in (m, 3) poses."""
        steps = [poses[b, :2] - poses[a, :2] for a, b in self.free_steps]
        lengths: FloatArray = np.linalg.norm(np.array(steps).reshape(-1, 2), axis=1)
        return lengths

    @property
    def odometry(self) -> tuple[Odometry, ...]:
        """Motion before each scan but the first."""
        return tuple(scan.odometry for scan in self.scans[1:] if scan.odometry is not None)

    def part(self, start: int, stop: int) -> Problem:
        """Return the problem of scans `start` to `stop` - 1 alone, of one run."""
        return replace(self, scans=self.scans[start:stop], sigmas=self.sigmas[start:stop])

    def sightings(self, table: IntArray) -> Sightings:
        """Return the bearings of an (n, m) association table, row by row."""
        seen = table != MISSED
        bearings = np.zeros(table.shape)
        sigmas = np.ones(table.shape)
        for k, (scan, sigma) in enumerate(zip(self.scans, self.sigmas, strict=True)):
            rows = seen[:, k]
            bearings[rows, k] = scan.bearings[table[rows, k]]
            sigmas[rows, k] = sigma[table[rows, k]]
        return Sightings(bearings, sigmas, seen)


@dataclass(frozen=True)
class Sightings:
    """Bearings by landmark and scan, all (n, m); entries where `seen` is False mean nothing."""

    bearings: FloatArray
    sigmas: FloatArray
    seen: BoolArray


def make_problem(
    run: StraightRun | RunPair,
    scans: tuple[int, ...],
    model: ObservationModel,
    scale: float | None = None,
) -> Problem:
    """Select scans of a run and bring the model into the problem's unit.

    `scale` is the length of the first baseline in metres; without it the unit is the baseline.
    Raises `OptionError` unless it is a number from 1e-3 to 1e4.
    """
    chosen = tuple(run.scans[i] for i in scans)
    if model.motion != "straight" and isinstance(run, RunPair):
        raise OptionError(f"motion is {model.motion!r}: a RunPair is two runs of motion 'straight'")
    if model.motion == "odometry":
        _check_odometry(chosen, scans, scale)
    baseline = 1.0
    if scale is not None:
        baseline = finite_number(
            scale, "scale", at_least=SHORTEST_BASELINE, at_most=LONGEST_BASELINE
        )
    in_unit = replace(
        model,
        lateral_sigma=model.lateral_sigma * baseline,
        landmark_sigma=model.landmark_sigma * baseline,
        landmark_centre=(model.landmark_centre[0] * baseline, model.landmark_centre[1] * baseline),
        log_step_mean=model.log_step_mean + math.log(baseline),
    )
    return Problem(
        scans=chosen,
        sigmas=tuple(
            freeze(np.full(len(scan), model.sigma)) if scan.sigma is None else scan.sigma
            for scan in chosen
        ),
        model=in_unit,
        baseline=baseline,
        second_run=2 if isinstance(run, RunPair) else None,
    )


def _check_odometry(
    chosen: tuple[BearingScan, ...], scans: tuple[int, ...], scale: float | None
) -> None:
    if scale is not None:
        raise OptionError(f"scale is {scale!r}: with motion 'odometry' the odometry gives it")
    if any(b != a + 1 for a, b in pairwise(scans)):
        raise OptionError(
            f"scans is {scans}: motion 'odometry' takes consecutive scans, whose odometry is known"
        )
    for i, scan in zip(scans[1:], chosen[1:], strict=True):
        if scan.odometry is None or scan.odometry.covariance is None:
            raise OptionError(
                f"scan {i} has no odometry with a covariance: motion 'odometry' needs one in "
                "every scan but the first"
            )
