"""Straight windows of the Victoria Park recording: their table, and the tracks inside them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from mht_slam.datasets.tables import FieldReader, read_table

WINDOW_COLUMNS = (
    "window",
    "scan_i",
    "scan_j",
    "t0_s",
    "t1_s",
    "n_scans",
    "chord_m",
    "max_lateral_dev_m",
    "heading_span_deg",
    "n_tracks_ge3obs",
    "n_tracks_parallax_ge5deg",
    "frac_scans_ge3_tracked",
    "n_untracked_dets",
    "n_dets",
    "bearing_resid_std_deg",
    "gps_rms_after_rigid_alignment_m",
)
TRACK_COLUMNS = (
    "window",
    "scan_index",
    "t_s",
    "track_in_window",
    "bearing_rad_ccw_from_forward",
    "range_m",
    "ref_x",
    "ref_y",
    "ref_theta",
    "ref_lm_x",
    "ref_lm_y",
)


@dataclass(frozen=True)
class StraightWindow:
    """One nearly straight stretch: a row of the table.

    Attributes
    ----------
    number : of the window, from 0.
    first_scan, last_scan : both belong to the window; the next window may begin with the last.
    chord : distance between the first and the last pose, metres.
    max_lateral_deviation : of a pose from the chord, metres.
    heading_span : largest minus smallest heading, radians.
    n_detections, n_untracked : of all its scans, and those of them that are in no track.
    """

    number: int
    first_scan: int
    last_scan: int
    chord: float
    max_lateral_deviation: float
    heading_span: float
    n_detections: int
    n_untracked: int

    @property
    def scans(self) -> range:
        """Indices of the window's scans in the recording."""
        return range(self.first_scan, self.last_scan + 1)


@dataclass(frozen=True)
class TrackedDetection:
    """One detection of a track: a row of the table, with the reference pose and landmark.

    Attributes
    ----------
    window, scan, track : tracks are numbered window by window.
    time : seconds.
    bearing, range : radians counter-clockwise from forward, metres; both rounded.
    pose : x, y in metres and theta in radians of the scan, in the window's own frame.
    landmark : x, y in metres of the track, in the same frame.
    line : of the table.
    """

    window: int
    scan: int
    track: int
    time: float
    bearing: float
    range: float
    pose: tuple[float, float, float]
    landmark: tuple[float, float]
    line: int


def read_windows(path: Path, n_scans: int) -> tuple[StraightWindow, ...]:
    """Read the table of windows of a recording with `n_scans` scans.

    Raises `RecordingError`, with file and line, for a malformed row, a window out of sequence or
    scans that do not exist.
    """
    windows: list[StraightWindow] = []
    for read, row in read_table(path, WINDOW_COLUMNS):
        window = _window(row, read, n_scans)
        if window.number != len(windows):
            raise read.error("window", row["window"], f"window {len(windows)} comes here")
        windows.append(window)
    return tuple(windows)


def read_tracks(path: Path) -> tuple[TrackedDetection, ...]:
    """Read the table of tracked detections; raises `RecordingError` with file and line."""
    return tuple(_tracked(row, read) for read, row in read_table(path, TRACK_COLUMNS))


def _window(row: dict[str, str], read: FieldReader, n_scans: int) -> StraightWindow:
    first, last, count = (read.whole(row[name], name) for name in ("scan_i", "scan_j", "n_scans"))
    if not 0 <= first < last < n_scans:
        raise read.error(
            "scan_i", f"scans {first} to {last}", f"the recording has scans 0 to {n_scans - 1}"
        )
    if count != last - first + 1:
        raise read.error("n_scans", f"{count}", f"scans {first} to {last} are {last - first + 1}")
    return StraightWindow(
        number=read.whole(row["window"], "window"),
        first_scan=first,
        last_scan=last,
        chord=read.number(row["chord_m"], "chord_m"),
        max_lateral_deviation=read.number(row["max_lateral_dev_m"], "max_lateral_dev_m"),
        heading_span=math.radians(read.number(row["heading_span_deg"], "heading_span_deg")),
        n_detections=read.whole(row["n_dets"], "n_dets"),
        n_untracked=read.whole(row["n_untracked_dets"], "n_untracked_dets"),
    )


def _tracked(row: dict[str, str], read: FieldReader) -> TrackedDetection:
    def number(name: str) -> float:
        return read.number(row[name], name)

    return TrackedDetection(
        window=read.whole(row["window"], "window"),
        scan=read.whole(row["scan_index"], "scan_index"),
        track=read.whole(row["track_in_window"], "track_in_window"),
        time=number("t_s"),
        bearing=number("bearing_rad_ccw_from_forward"),
        range=number("range_m"),
        pose=(number("ref_x"), number("ref_y"), number("ref_theta")),
        landmark=(number("ref_lm_x"), number("ref_lm_y")),
        line=read.line,
    )
