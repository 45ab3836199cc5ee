"""A drive of any length: scans with odometry, and apart from them what no method may see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from mht_slam.arrays import FloatArray, IntArray, freeze
from mht_slam.association import MISSED, Association
from mht_slam.errors import OptionError
from mht_slam.measurements import BearingScan


@dataclass(frozen=True, eq=False)
class Drive:
    """Scans in the order of travel, with the truth of them that evaluation needs.

    Attributes
    ----------
    name : recording and what of it: "dlr scans 100-199".
    scans : m scans. Odometry, where the source has it, is the motion since the scan before, so the
        first scan has none.
    identities : for each scan the (n_detections,) landmark ids, -1 for a false detection.
    reference_poses : (m, 3) x, y in metres and theta in radians; forward is along theta. NaN where
        the source has no reference, which may be the heading alone; (0, 3) without any.
    reference_landmarks : id to (x, y), metres, in the frame of the poses; empty without any.
    stretches : (first, last) scans, both included, between which identities hold; None, for all of
        them, becomes one stretch. Scans outside have -1 everywhere, which says nothing there, and
        ids of different stretches differ even where the landmark is the same.

    Raises `OptionError` where the lengths disagree.
    """

    name: str
    scans: tuple[BearingScan, ...]
    identities: tuple[IntArray, ...]
    reference_poses: FloatArray = field(default_factory=lambda: freeze(np.empty((0, 3))))
    reference_landmarks: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    stretches: tuple[tuple[int, int], ...] | None = None

    def __post_init__(self) -> None:
        counts = [len(scan) for scan in self.scans]
        if counts != [len(of_scan) for of_scan in self.identities]:
            raise OptionError(f"{self.name}: give one identity for each detection of each scan")
        if self.reference_poses.shape not in ((len(counts), 3), (0, 3)):
            raise OptionError(
                f"{self.name}: reference_poses has shape {self.reference_poses.shape}: "
                f"give ({len(counts)}, 3), or (0, 3) without a reference"
            )
        if self.stretches is None:
            whole = ((0, len(counts) - 1),) if counts else ()
            object.__setattr__(self, "stretches", whole)

    def __len__(self) -> int:
        return len(self.scans)

    @property
    def n_detections(self) -> tuple[int, ...]:
        """Number of detections of each scan."""
        return tuple(len(scan) for scan in self.scans)

    @property
    def has_odometry(self) -> bool:
        """Whether every scan but the first says how the robot moved since the one before."""
        return all(scan.odometry is not None for scan in self.scans[1:])

    def part(self, first: int, last: int) -> Drive:
        """Return scans `first` to `last`, both included, as a drive of their own.

        Its first scan has no odometry; the references stay in their frame. Raises `OptionError` for
        scans that do not exist.
        """
        if not 0 <= first <= last < len(self):
            raise OptionError(
                f"scans {first} to {last}: {self.name} has scans 0 to {len(self) - 1}"
            )
        inside = slice(first, last + 1)
        stretches = [
            (max(start, first) - first, min(end, last) - first)
            for start, end in self.stretches or ()
            if start <= last and end >= first
        ]
        return replace(
            self,
            name=f"{self.name} scans {first}-{last}",
            scans=begun_anew(self.scans[inside]),
            identities=self.identities[inside],
            reference_poses=self.reference_poses[inside],
            stretches=tuple(stretches),
        )

    def truth(self, scans: Sequence[int] | None = None) -> Association:
        """Return the true association of these scans, or of all."""
        chosen = self.identities if scans is None else [self.identities[k] for k in scans]
        return Association.from_labels(
            [[None if i == MISSED else i for i in of_scan.tolist()] for of_scan in chosen]
        )


def begun_anew(scans: Sequence[BearingScan]) -> tuple[BearingScan, ...]:
    """Return the scans, the first without odometry: before it there is no pose to move from."""
    if not scans or scans[0].odometry is None:
        return tuple(scans)
    first = scans[0]
    begin = BearingScan(first.bearings, time=first.time, sigma=first.sigma, labels=first.labels)
    return (begin, *scans[1:])


def shuffled_drive(
    name: str,
    scans: Sequence[BearingScan],
    identities: Sequence[IntArray],
    *,
    poses: FloatArray | None = None,
    landmarks: Mapping[int, tuple[float, float]] | None = None,
    stretches: Sequence[tuple[int, int]] | None = None,
) -> Drive:
    """Shuffle the detections of each scan of a recording and give them as a drive.

    A recording's own order goes by distance or by angle and could tell landmarks apart. The orders
    come from generators seeded by the scan's index.
    """
    orders = [np.random.default_rng(k).permutation(len(scan)) for k, scan in enumerate(scans)]
    mixed = [
        BearingScan(scan.bearings[order], time=scan.time, odometry=scan.odometry)
        for scan, order in zip(scans, orders, strict=True)
    ]
    return Drive(
        name=name,
        scans=begun_anew(mixed),
        identities=tuple(
            freeze(of_scan[order]) for of_scan, order in zip(identities, orders, strict=True)
        ),
        reference_poses=freeze(np.empty((0, 3)) if poses is None else np.array(poses)),
        reference_landmarks={} if landmarks is None else dict(landmarks),
        stretches=None if stretches is None else tuple(stretches),
    )


def windows(drive: Drive, length: int) -> list[Drive]:
    """Cut a drive into windows of `length` scans, without overlap; a shorter rest is left out."""
    edges = range(0, len(drive) + 1, length)
    return [drive.part(first, after - 1) for first, after in pairwise(edges)]
