"""What was seen: bearing scans, odometry steps, straight runs and pairs of runs.

A *detection* is one bearing in one *scan*; a scan is the unordered set of detections taken at one
pose. Bearings are radians in the robot frame, counter-clockwise from forward. Nothing here knows
which detection is which landmark; that is `mht_slam.association`.
"""

from __future__ import annotations

import operator
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import overload

import numpy as np
import numpy.typing as npt

from mht_slam.arrays import FloatArray, finite_array, finite_number, freeze
from mht_slam.errors import MeasurementError

SMALLEST_SIGMA = 1e-15
"""The smallest standard deviation of a bearing, radians: doubles near pi are no denser."""
MIN_RUN_SCANS = 3
"""Two scans of a straight run fit every association; the third one tells them apart."""


@overload
def wrap_angle(angle: float) -> float: ...
@overload
def wrap_angle(angle: FloatArray) -> FloatArray: ...
def wrap_angle(angle: float | FloatArray) -> float | FloatArray:
    """Return the angle (radians, any shape) moved by whole turns into (-pi, pi].

    Angles already inside are returned bit for bit, so wrapping twice changes nothing.

    >>> wrap_angle(-np.pi) == np.pi
    True
    """
    array = np.asarray(angle, dtype=np.float64)
    turned = np.pi - np.mod(np.pi - array, 2.0 * np.pi)
    # The modulo may round up to a whole turn just above -pi; that is the angle pi itself.
    turned = np.where(turned <= -np.pi, np.pi, turned)
    wrapped = np.where((array > -np.pi) & (array <= np.pi), array, turned)
    return float(wrapped) if array.ndim == 0 else wrapped


@dataclass(frozen=True, eq=False)
class Odometry:
    """The robot's motion since the previous scan, in the frame of the previous pose.

    Attributes
    ----------
    dx, dy : forward and leftward motion, metres.
    dtheta : change of heading, radians, counter-clockwise.
    covariance : (3, 3) of (dx, dy, dtheta) in metres and radians, symmetric and positive definite;
        three variances are taken as its diagonal. None when the odometer states none.

    Raises `MeasurementError` for numbers that are not finite or a covariance that is none.
    """

    dx: float
    dy: float
    dtheta: float
    covariance: FloatArray | None = field(default=None)

    def __init__(
        self, dx: float, dy: float, dtheta: float, covariance: npt.ArrayLike | None = None
    ) -> None:
        for name, value in (("dx", dx), ("dy", dy), ("dtheta", dtheta)):
            object.__setattr__(
                self, name, finite_number(value, f"odometry {name}", error=MeasurementError)
            )
        matrix = None if covariance is None else _covariance(covariance)
        object.__setattr__(self, "covariance", matrix)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Odometry):
            return NotImplemented
        return (self.dx, self.dy, self.dtheta) == (other.dx, other.dy, other.dtheta) and (
            _same_array(self.covariance, other.covariance)
        )

    def __hash__(self) -> int:
        return hash((self.dx, self.dy, self.dtheta))

    def __setstate__(self, state: dict[str, object]) -> None:
        _restore(self, state)


@dataclass(frozen=True, eq=False)
class BearingScan:
    """The unordered bearings taken at one pose.

    Attributes
    ----------
    bearings : (n,) radians in (-pi, pi], robot frame, counter-clockwise from forward. Detection i
        is ``bearings[i]`` as the caller gave it; bearings outside the interval are wrapped.
    time : seconds, or None.
    sigma : (n,) standard deviations, radians, or None when the caller leaves them to the model. A
        scalar holds for every detection.
    labels : one ``str | None`` per detection, or None. A label is a known identity and a hard
        constraint wherever associations are formed: equal labels are one landmark, different
        labels are two, None says nothing.
    odometry : motion since the previous scan, or None.

    Raises `MeasurementError`, naming the field, the entry and the remedy.

    >>> BearingScan([0.5, -1.0, 2.0]).n_detections
    3
    """

    bearings: FloatArray
    time: float | None = None
    sigma: FloatArray | None = None
    labels: tuple[str | None, ...] | None = None
    odometry: Odometry | None = None

    def __init__(
        self,
        bearings: npt.ArrayLike,
        *,
        time: float | None = None,
        sigma: npt.ArrayLike | None = None,
        labels: Sequence[str | None] | None = None,
        odometry: Odometry | None = None,
    ) -> None:
        array = finite_array(
            bearings,
            "bearings",
            MeasurementError,
            remedy="every bearing is a finite number of radians; drop the detection otherwise",
        )
        if array.ndim != 1:
            raise MeasurementError(
                f"bearings has shape {array.shape}: give one dimension, one bearing per detection"
            )
        set_field = object.__setattr__
        set_field(self, "bearings", freeze(wrap_angle(array)))
        set_field(
            self,
            "time",
            None if time is None else finite_number(time, "time", error=MeasurementError),
        )
        set_field(self, "sigma", None if sigma is None else _sigmas(sigma, len(array)))
        set_field(self, "labels", None if labels is None else _labels(labels, len(array)))
        if odometry is not None and not isinstance(odometry, Odometry):
            raise MeasurementError(f"odometry is {odometry!r}: give an Odometry")
        set_field(self, "odometry", odometry)

    @property
    def n_detections(self) -> int:
        """Number of detections."""
        return len(self.bearings)

    def __len__(self) -> int:
        return len(self.bearings)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, BearingScan):
            return NotImplemented
        return (
            np.array_equal(self.bearings, other.bearings)
            and self.time == other.time
            and _same_array(self.sigma, other.sigma)
            and self.labels == other.labels
            and self.odometry == other.odometry
        )

    def __hash__(self) -> int:
        # Adding zero turns -0.0, which equals 0.0, into the same bytes.
        return hash(((self.bearings + 0.0).tobytes(), self.time, self.labels))

    def __setstate__(self, state: dict[str, object]) -> None:
        _restore(self, state)


@dataclass(frozen=True)
class StraightRun:
    """Scans taken along one straight line, forward being the direction of travel.

    The headings are common to all scans, the steps are positive and unknown. The run's own frame
    has the first observation point O1 at the origin and the second, O2, at (1, 0): the unit is the
    first baseline.

    Attributes
    ----------
    scans : at least three `BearingScan`, in the order of travel. A scan without detections is a
        scan in which everything was missed.

    Raises `MeasurementError` for fewer than three scans, or something else than a scan.

    >>> run = StraightRun([BearingScan([0.4, 1.0, 2.0])] * 3)
    >>> run.n_detections
    (3, 3, 3)
    """

    scans: tuple[BearingScan, ...]

    def __init__(self, scans: Iterable[BearingScan]) -> None:
        object.__setattr__(self, "scans", _scans(scans, "scans"))
        if len(self.scans) < MIN_RUN_SCANS:
            raise MeasurementError(
                f"scans has {len(self.scans)} scans: a straight run needs at least {MIN_RUN_SCANS}"
            )

    @property
    def n_detections(self) -> tuple[int, ...]:
        """Number of detections of each scan."""
        return tuple(len(scan) for scan in self.scans)

    def __len__(self) -> int:
        return len(self.scans)

    def select(self, scans: Sequence[int]) -> StraightRun:
        """Return the run of the scans with these indices, which keep the order of travel."""
        return StraightRun(self.scans[i] for i in scan_selection(scans, len(self.scans)))


@dataclass(frozen=True)
class RunPair:
    """Two straight runs of two scans each, with nothing known of how the runs lie to each other.

    Attributes
    ----------
    first, second : (2,) tuples of `BearingScan`; forward is the direction of travel in each.

    Raises `MeasurementError` like `StraightRun`.
    """

    first: tuple[BearingScan, BearingScan]
    second: tuple[BearingScan, BearingScan]

    def __init__(self, first: Iterable[BearingScan], second: Iterable[BearingScan]) -> None:
        for name, value in (("first", first), ("second", second)):
            pair = _scans(value, name)
            if len(pair) != 2:
                raise MeasurementError(f"{name} has {len(pair)} scans: give exactly two")
            object.__setattr__(self, name, pair)

    @property
    def scans(self) -> tuple[BearingScan, ...]:
        """The four scans: those of the first run, then those of the second."""
        return (*self.first, *self.second)

    @property
    def n_detections(self) -> tuple[int, ...]:
        """Number of detections of each of the four scans."""
        return tuple(len(scan) for scan in self.scans)

    def __len__(self) -> int:
        return 4


def scan_selection(
    scans: Sequence[int], n_scans: int, *, exactly: int | None = None
) -> tuple[int, ...]:
    """Validate increasing scan indices of a run of `n_scans`; `exactly` fixes their number."""
    try:
        chosen = tuple(operator.index(i) for i in scans)
    except TypeError:
        raise MeasurementError(f"scans is {scans!r}: give scan indices") from None
    if exactly is not None and len(chosen) != exactly:
        raise MeasurementError(f"scans has {len(chosen)} indices: give {exactly}")
    for i in chosen:
        if not 0 <= i < n_scans:
            raise MeasurementError(f"scans names scan {i}: the run has scans 0 to {n_scans - 1}")
    if any(a >= b for a, b in pairwise(chosen)):
        raise MeasurementError(f"scans is {chosen}: give increasing indices, in order of travel")
    return chosen


def _scans(scans: Iterable[BearingScan], name: str) -> tuple[BearingScan, ...]:
    try:
        members = tuple(scans)
    except TypeError:
        raise MeasurementError(f"{name} is {scans!r}: give a sequence of BearingScan") from None
    for i, scan in enumerate(members):
        if not isinstance(scan, BearingScan):
            raise MeasurementError(f"{name}[{i}] is {type(scan).__name__}: give a BearingScan")
    return members


def _sigmas(sigma: npt.ArrayLike, n: int) -> FloatArray:
    array = finite_array(
        sigma, "sigma", MeasurementError, remedy="give standard deviations in radians"
    )
    if array.ndim == 0:
        array = np.full(n, float(array))
    if array.shape != (n,):
        raise MeasurementError(
            f"sigma has shape {array.shape}: give one number, or one per detection ({n})"
        )
    bad = np.flatnonzero(array < SMALLEST_SIGMA)
    if len(bad):
        raise MeasurementError(
            f"sigma[{bad[0]}] is {array[bad[0]]}: give radians above zero, at least "
            f"{SMALLEST_SIGMA:g}"
        )
    return freeze(array)


def _labels(labels: Sequence[str | None], n: int) -> tuple[str | None, ...]:
    if isinstance(labels, str):
        raise MeasurementError("labels is one string: give one label, or None, per detection")
    try:
        members = tuple(labels)
    except TypeError:
        raise MeasurementError(
            f"labels is {labels!r}: give one label, or None, per detection"
        ) from None
    if len(members) != n:
        raise MeasurementError(f"labels has {len(members)} entries for {n} detections")
    for i, label in enumerate(members):
        if label is not None and not isinstance(label, str):
            raise MeasurementError(f"labels[{i}] is {label!r}: give a string or None")
        if label is not None and label in members[:i]:
            raise MeasurementError(
                f"labels[{i}] repeats {label!r}: one scan sees a landmark at most once"
            )
    return members


def _covariance(covariance: npt.ArrayLike) -> FloatArray:
    matrix = finite_array(
        covariance, "odometry covariance", MeasurementError, remedy="give metres and radians"
    )
    if matrix.shape == (3,):
        matrix = np.diag(matrix)
    if matrix.shape != (3, 3):
        raise MeasurementError(
            f"odometry covariance has shape {matrix.shape}: give (3, 3), or 3 variances"
        )
    if not np.allclose(matrix, matrix.T, rtol=1e-6, atol=0.0):
        raise MeasurementError("odometry covariance is not symmetric")
    if np.linalg.eigvalsh(matrix)[0] <= 0.0:
        raise MeasurementError("odometry covariance is not positive definite")
    return freeze(matrix)


def _restore(value: object, state: dict[str, object]) -> None:
    """Set the fields of a copied or unpickled value, whose arrays numpy made writeable."""
    for name, entry in state.items():
        object.__setattr__(value, name, freeze(entry) if isinstance(entry, np.ndarray) else entry)


def _same_array(a: FloatArray | None, b: FloatArray | None) -> bool:
    if a is None or b is None:
        return a is b
    return np.array_equal(a, b)
