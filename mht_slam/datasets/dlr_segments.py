"""Nearly straight stretches of the DLR recording, as its table of segments lists them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from mht_slam.datasets.tables import FieldReader, read_table

COLUMNS = (
    "kind",
    "scan_i",
    "scan_j",
    "n_scans",
    "chord_m",
    "max_lateral_dev_m",
    "heading_span_deg",
    "n_lm_ge3obs_par5",
    "min_true_lm_per_scan",
    "n_false_dets",
)


@dataclass(frozen=True)
class Segment:
    """One nearly straight stretch: a row of the table.

    Attributes
    ----------
    kind : "strict": the same three landmarks or more are in every scan; "relaxed": three landmarks
        or more are seen three times; "relaxed_le12scans": the same in at most twelve scans.
    first_scan, last_scan : both belong to the segment.
    chord : distance between the first and the last pose, metres.
    max_lateral_deviation : of a pose from the chord, metres.
    heading_span : largest minus smallest heading, radians.
    n_with_parallax : landmarks seen at least three times with five degrees of parallax.
    min_landmarks : the fewest labelled detections of a scan.
    n_false_detections : over all scans.
    """

    kind: str
    first_scan: int
    last_scan: int
    chord: float
    max_lateral_deviation: float
    heading_span: float
    n_with_parallax: int
    min_landmarks: int
    n_false_detections: int

    @property
    def scans(self) -> range:
        """Indices of the segment's scans in the recording."""
        return range(self.first_scan, self.last_scan + 1)

    @property
    def first_middle_last(self) -> tuple[int, int, int]:
        """The first, the middle (rounded down) and the last scan."""
        return self.first_scan, (self.first_scan + self.last_scan) // 2, self.last_scan


def read_segments(path: Path, n_scans: int) -> tuple[Segment, ...]:
    """Read the table of segments of a recording with `n_scans` scans.

    Raises `RecordingError`, with file and line, for a malformed row or scans that do not exist.
    """
    return tuple(_segment(row, read, n_scans) for read, row in read_table(path, COLUMNS))


def _segment(row: dict[str, str], read: FieldReader, n_scans: int) -> Segment:
    first, last, count = (read.whole(row[name], name) for name in ("scan_i", "scan_j", "n_scans"))
    if not 0 <= first < last < n_scans:
        raise read.error(
            "scan_i", f"scans {first} to {last}", f"the recording has scans 0 to {n_scans - 1}"
        )
    if count != last - first + 1:
        raise read.error("n_scans", f"{count}", f"scans {first} to {last} are {last - first + 1}")
    return Segment(
        kind=row["kind"],
        first_scan=first,
        last_scan=last,
        chord=read.number(row["chord_m"], "chord_m"),
        max_lateral_deviation=read.number(row["max_lateral_dev_m"], "max_lateral_dev_m"),
        heading_span=math.radians(read.number(row["heading_span_deg"], "heading_span_deg")),
        n_with_parallax=read.whole(row["n_lm_ge3obs_par5"], "n_lm_ge3obs_par5"),
        min_landmarks=read.whole(row["min_true_lm_per_scan"], "min_true_lm_per_scan"),
        n_false_detections=read.whole(row["n_false_dets"], "n_false_dets"),
    )
