"""The measured side of a factor graph: bearings, their noise, and the model they come with."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray, finite_number, freeze
from mht_slam.association import MISSED
from mht_slam.errors import OptionError
from mht_slam.graph.standstill import standstills
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
    still : for each step whether the robot stood still; empty where it never does.
    """

    scans: tuple[BearingScan, ...]
    sigmas: tuple[FloatArray, ...]
    model: ObservationModel
    baseline: float = 1.0
    second_run: int | None = None
    still: tuple[bool, ...] = ()

    @property
    def heading_sigma(self) -> float:
        """Standard deviation of a heading in the graph, radians; never zero."""
        return max(self.model.heading_sigma, ZERO_SIGMA)

    @property
    def lateral_sigma(self) -> float:
        """Deviation of scans 3 and later from the line; never zero."""
        return max(self.model.lateral_sigma, ZERO_SIGMA * self.baseline)

    @cached_property
    def labelled(self) -> bool:
        """Whether any detection has a known identity."""
        return any(scan.labels is not None for scan in self.scans)

    @cached_property
    def free_steps(self) -> tuple[tuple[int, int], ...]:
        """Pairs of consecutive scans of one run whose distance has a prior in logarithms."""
        if self.model.motion == "odometry":
            return ()
        return tuple((k, k + 1) for k in self.moves[1:] if k + 1 != self.second_run)

    @cached_property
    def moves(self) -> tuple[int, ...]:
        """The scans from which the robot moved on, but for the last scan."""
        return tuple(k for k in range(len(self.scans) - 1) if not (self.still and self.still[k]))

    @property
    def second_place(self) -> int:
        """The scan at O2, the first that was taken elsewhere than O1."""
        return self.moves[0] + 1 if self.moves else len(self.scans) - 1

    def free_lengths(self, poses: FloatArray) -> FloatArray:
        """Return the distances of `free_steps` in (m, 3) poses."""
        places = poses[:, :2].tolist()  # too few for array operations to be worth their calls
        return np.array([math.dist(places[a], places[b]) for a, b in self.free_steps])

    @property
    def odometry(self) -> tuple[Odometry, ...]:
        """Motion before each scan but the first."""
        return tuple(scan.odometry for scan in self.scans[1:] if scan.odometry is not None)

    def part(self, start: int, stop: int) -> Problem:
        """Return the problem of scans `start` to `stop` - 1 alone, of one run."""
        return replace(
            self,
            scans=self.scans[start:stop],
            sigmas=self.sigmas[start:stop],
            still=self.still[start : stop - 1],
        )

    def sightings(self, table: IntArray) -> Sightings:
        """Return the bearings of an (n, m) association table, row by row."""
        bearings, sigmas = self._padded
        scans = np.arange(len(self.scans))
        return Sightings(bearings[scans, table], sigmas[scans, table], table != MISSED)

    @cached_property
    def _padded(self) -> tuple[FloatArray, FloatArray]:
        """Bearings and sigmas (m, 1 + most detections); the last, for `MISSED`, mean nothing."""
        width = 1 + max((len(scan) for scan in self.scans), default=0)
        bearings = np.zeros((len(self.scans), width))
        sigmas = np.ones((len(self.scans), width))
        for k, (scan, sigma) in enumerate(zip(self.scans, self.sigmas, strict=True)):
            bearings[k, : len(scan)] = scan.bearings
            sigmas[k, : len(scan)] = sigma
        return bearings, sigmas


@dataclass(frozen=True)
class Sightings:
    """Bearings by landmark and scan, all (n, m); entries where `seen` is False mean nothing."""

    bearings: FloatArray
    sigmas: FloatArray
    seen: BoolArray

    def of_scans(self, part: slice) -> Sightings:
        """Return the columns of some scans."""
        return Sightings(
            np.ascontiguousarray(self.bearings[:, part]),
            np.ascontiguousarray(self.sigmas[:, part]),
            np.ascontiguousarray(self.seen[:, part]),
        )


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
    sigmas = tuple(
        freeze(np.full(len(scan), model.sigma)) if scan.sigma is None else scan.sigma
        for scan in chosen
    )
    may_stop = model.stops and model.motion == "smooth"
    return Problem(
        scans=chosen,
        sigmas=sigmas,
        model=in_unit,
        baseline=baseline,
        second_run=2 if isinstance(run, RunPair) else None,
        still=standstills(chosen, sigmas) if may_stop else (),
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
