"""What the scan-file formats share: one record a scan, located errors, exact degrees."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from mht_slam.association import MISSED
from mht_slam.errors import MeasurementError, ScanFileError
from mht_slam.measurements import BearingScan


@dataclass(frozen=True)
class ScanRecord:
    """A scan, its true landmark ids (-1 = false alarm) or None, and the line it begins on."""

    scan: BearingScan
    landmarks: tuple[int, ...] | None
    line: int


@dataclass(frozen=True)
class Place:
    """A line of a file, for errors of the form "file:line: field: what: remedy"."""

    path: Path
    line: int

    def error(self, field: str, what: str, remedy: str) -> ScanFileError:
        """Return the error that says what is wrong with `field` here."""
        return ScanFileError(f"{self.path}:{self.line}: {field}: {what}: {remedy}")

    def measurement_error(self, cause: MeasurementError) -> ScanFileError:
        """Return the error for values that cannot be a measurement; they name their own field."""
        return ScanFileError(f"{self.path}:{self.line}: {cause}")


def check_landmarks(landmarks: tuple[int, ...], n_detections: int, place: Place) -> None:
    """Raise `ScanFileError` unless the ids are one per detection, and each landmark seen once."""
    if len(landmarks) != n_detections:
        raise place.error(
            "landmarks",
            f"{len(landmarks)} ids for {n_detections} bearings",
            "give one id per bearing, -1 for a false alarm",
        )
    seen = set()
    for i, landmark in enumerate(landmarks):
        if landmark < MISSED:
            raise place.error(
                f"landmarks[{i}]", f"{landmark} is no id", "give 0 or more, -1 for a false alarm"
            )
        if landmark in seen:
            raise place.error(
                f"landmarks[{i}]",
                f"landmark {landmark} is there twice",
                "one scan sees a landmark at most once; -1 is a false alarm",
            )
        if landmark != MISSED:
            seen.add(landmark)


def exact_degrees(radians: float) -> float:
    """Return the degrees that come back as these very radians, if a float nearby does.

    Radians that were read from degrees always come back bit for bit; others within one unit in
    the last place of the degrees.
    """
    nearest = math.degrees(radians)
    neighbours = (
        nearest,
        math.nextafter(nearest, math.inf),
        math.nextafter(nearest, -math.inf),
    )
    for candidate in neighbours:
        if math.radians(candidate) == radians:
            return candidate
    return nearest
