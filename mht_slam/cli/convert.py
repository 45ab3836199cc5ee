"""`mht-slam convert IN OUT`: scans from one file format to another."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console

from mht_slam.errors import OptionError

DLR_SUFFIX = ".circles"


@dataclass(frozen=True)
class Convert:
    """Convert scans between JSON lines and CSV, or from the DLR recording's map.circles.

    What the target cannot hold (CSV: sigmas, labels, odometry, empty scans) is refused, never
    lost. An existing target is refused too. Of map.circles bearings, odometry and identities are
    kept; ranges and qualities have no place in a scan file.
    """

    source: tyro.conf.Positional[Path]
    """File to read: .jsonl, .json, .csv or .circles."""
    target: tyro.conf.Positional[Path]
    """File to write: .jsonl, .json or .csv."""

    def run(self, console: Console) -> None:
        """Read one file and write the other."""
        from mht_slam.association import Association
        from mht_slam.datasets import read_map_circles, read_scans, write_scans

        if self.target.exists():
            raise OptionError(f"target: {self.target} exists: name a file that does not")
        truth: Association | None
        if self.source.suffix.lower() == DLR_SUFFIX:
            recording = read_map_circles(self.source)
            scans = recording.scans
            truth = recording.truth(range(len(scans)))
        else:
            content = read_scans(self.source)
            scans, truth = content.scans, content.truth
        write_scans(self.target, scans, truth)
        console.print(f"{len(scans)} scans: {self.target}", soft_wrap=True)
