"""`mht-slam track FILE`: identities through the dense scans of a file, by their visual order."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro
from rich.console import Console

from mht_slam.arrays import finite_number
from mht_slam.association import MISSED, Association
from mht_slam.cli.options import Output, OutputOptions
from mht_slam.cli.run_folder import run_folder, to_json, write_json
from mht_slam.errors import OptionError
from mht_slam.tracking.options import Mode, TrackerConfig

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mht_slam.measurements import BearingScan
    from mht_slam.tracking.exchanges import Exchange
    from mht_slam.tracking.tracker import OrderTracker

RESULTS_FILE, TRACKS_FILE = "tracks.json", "tracks.csv"
RESULTS_FORMAT = 1
"""Goes up when a reader of older tracks.json would misread a newer one."""
SURE = 0.9
"""Tracks of a lower probability are named in the report."""
COLUMNS = ("track", "scan", "detection", "bearing_deg", "probability")


@dataclass(frozen=True)
class Track:
    """Track landmarks through the scans of a file, so dense that bearings change little.

    The stamped folder holds the tracks (tracks.csv, tracks.json), their figure and the
    configuration. Where the file holds the truth, the report says how the tracks agree with it.
    """

    file: tyro.conf.Positional[Path]
    """Scan file: JSON lines (.jsonl, .json) or CSV (.csv)."""
    mode: Mode = "general"
    """`general`: predictions decide who is who; `paper`: the paper's rule alone."""
    sigma_deg: float = 0.5
    """Standard deviation of a bearing, degrees; a scan's own goes before it."""
    turn_sigma_deg: float = 3.0
    """Scale of the robot's turns from scan to scan, degrees."""
    detection_probability: float = 0.95
    """Chance that a landmark in view is detected."""
    false_alarm_rate: float = 0.05
    """Expected false alarms per radian and scan."""
    stay_probability: float = 0.998
    """Chance that a landmark in view is still in view at the next scan."""
    confirm: int = 3
    """Detections that make a track a landmark; fewer are taken for false alarms."""
    output: Output = field(default_factory=OutputOptions)

    def run(self, console: Console) -> None:
        """Read the file, track, and write tracks and figure."""
        from mht_slam.datasets import read_scans
        from mht_slam.plotting import tracks_figure
        from mht_slam.tracking.exchanges import exchanges
        from mht_slam.tracking.tracker import OrderTracker

        tracker = OrderTracker(self._config())
        content = read_scans(self.file)
        if not content.scans:
            raise OptionError(f"{self.file} has no scans: give a file with some")
        configuration = {"seed": None, "options": to_json(self), "model": to_json(tracker.config)}
        with run_folder(self.output.output, "track", configuration) as folder:
            for scan in content.scans:
                tracker.update(scan)
            found = exchanges(content.scans, tracker.association)
            write_json(folder / RESULTS_FILE, _results(tracker, found, content.truth))
            _write_tracks(folder / TRACKS_FILE, tracker, content.scans)
            figure = tracks_figure(content.scans, tracker.association)
            figure.savefig(folder / f"tracks.{self.output.figure_format}", dpi=150)
        association = tracker.association
        console.print(
            f"{association.n_landmarks} tracks through {association.n_scans} scans; detections in "
            f"none: {len(association.false_alarms)}; exchanges of places: {len(found)}."
        )
        for row, probability in enumerate(tracker.track_probabilities.tolist()):
            if probability < SURE:
                console.print(f"Track {row} may be mistaken for another: p = {probability:.3f}.")
        if content.truth is not None:
            console.print(f"Pairwise F1 against the truth: {association.f1(content.truth):.3f}.")
        console.print(f"Results: {folder}", soft_wrap=True)

    def _config(self) -> TrackerConfig:
        for name in ("sigma_deg", "turn_sigma_deg"):
            finite_number(getattr(self, name), name, above=0.0, below=180.0)
        return TrackerConfig(
            sigma=math.radians(self.sigma_deg),
            turn_sigma=math.radians(self.turn_sigma_deg),
            detection_probability=self.detection_probability,
            false_alarm_rate=self.false_alarm_rate,
            stay_probability=self.stay_probability,
            confirm=self.confirm,
            mode=self.mode,
        )


def _results(
    tracker: OrderTracker, found: Sequence[Exchange], truth: Association | None
) -> dict[str, Any]:
    association = tracker.association
    return {
        "format": RESULTS_FORMAT,
        "n_detections": association.n_detections,
        "tracks": association.table,
        "probabilities": tracker.track_probabilities,
        "false_alarms": association.false_alarms,
        "exchanges": found,
        "truth": None if truth is None else truth.table,
        "f1": None if truth is None else association.f1(truth),
    }


def _write_tracks(path: Path, tracker: OrderTracker, scans: Sequence[BearingScan]) -> None:
    """Write one detection of a track a row."""
    sure = tracker.track_probabilities.tolist()
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for row, entries in enumerate(tracker.association.table.tolist()):
            for k, detection in enumerate(entries):
                if detection != MISSED:
                    bearing = math.degrees(float(scans[k].bearings[detection]))
                    writer.writerow([row, k, detection, bearing, sure[row]])
