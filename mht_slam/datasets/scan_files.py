"""Our own scan files, both ways: JSON lines and CSV.

Angles are degrees in the files and radians in a `BearingScan`. A bearing that was read from a file
is written back so that it reads bit for bit the same; any other survives within one unit in the
last place of its degrees.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from mht_slam.association import MISSED, Association
from mht_slam.datasets.scan_csv import format_csv, parse_csv
from mht_slam.datasets.scan_json import format_json_lines, parse_json_lines
from mht_slam.datasets.scan_records import Place, ScanRecord
from mht_slam.errors import ScanFileError
from mht_slam.measurements import BearingScan

FileFormat: TypeAlias = Literal["jsonl", "csv"]

FORMAT_OF_SUFFIX: dict[str, FileFormat] = {".jsonl": "jsonl", ".json": "jsonl", ".csv": "csv"}


@dataclass(frozen=True)
class ScanFile:
    """What a scan file holds: the scans in order, and the true association where it is given."""

    scans: tuple[BearingScan, ...]
    truth: Association | None = None


def read_scans(path: str | os.PathLike[str], *, file_format: FileFormat | None = None) -> ScanFile:
    """Read a scan file as a whole.

    JSON lines, one scan a line (bearings needed, everything else optional; blank lines are
    passed over)::

        {"time": 0.0, "bearings_deg": [10.0, -35.5], "sigma_deg": 1.0, "labels": [null, "door"],
         "odometry": {"dx": 1.0, "dy": 0.0, "dtheta_deg": 2.0, "covariance": [0.01, 0.01, 0.001]},
         "landmarks": [4, -1]}

    `sigma_deg` is one number or one per bearing; the covariance of (dx, dy, dtheta) is in metres
    and radians, as three variances, nine numbers or three rows. `landmarks` are the true
    identities, -1 for a false alarm, in every scan or in none. CSV has one detection a row:
    ``scan,time,bearing_deg[,landmark]``, the time may be empty.

    `file_format` is taken from the suffix when None: .jsonl and .json, or .csv.

    Raises `ScanFileError` of the form "file:line: field: what: remedy" for anything malformed, a
    blank file, or one that cannot be read; nothing half-read is returned.
    """
    source = Path(path)
    chosen = file_format_of(source, file_format)
    text = read_text(source)
    records = parse_csv(text, source) if chosen == "csv" else parse_json_lines(text, source)
    if not records:
        raise Place(source, 1).error("file", "blank", "give at least one scan")
    return ScanFile(tuple(record.scan for record in records), _truth(records, source))


def write_scans(
    path: str | os.PathLike[str],
    scans: Iterable[BearingScan],
    truth: Association | None = None,
    *,
    file_format: FileFormat | None = None,
) -> None:
    """Write scans, and the true association where given, so that `read_scans` gives them back.

    The file is replaced as a whole: a write that fails leaves the old one as it was. Raises
    `ScanFileError` for no scans, a truth over other detections, scans that CSV has no room for
    (sigmas, labels, odometry, no detections), or a folder that cannot be written.
    """
    target = Path(path)
    chosen = file_format_of(target, file_format)
    members = tuple(scans)
    if not members:
        raise ScanFileError(f"{target}: scans: none: give at least one scan")
    counts = tuple(len(scan) for scan in members)
    if truth is not None and truth.n_detections != counts:
        raise ScanFileError(
            f"{target}: truth: it is over {truth.n_detections} detections and the scans have "
            f"{counts}: give the association of these scans"
        )
    landmarks = None
    if truth is not None:
        landmarks = [rows.tolist() for rows in truth.landmark_of_detection()]
    if chosen == "csv":
        text = format_csv(members, landmarks, target)
    else:
        text = format_json_lines(members, landmarks)
    _replace(target, text)


def file_format_of(path: Path, file_format: FileFormat | None = None) -> FileFormat:
    """Return the format asked for, or else that of the suffix; raises `ScanFileError`."""
    if file_format is not None:
        if file_format not in FORMAT_OF_SUFFIX.values():
            raise ScanFileError(f"{path}: file_format: {file_format!r}: give 'jsonl' or 'csv'")
        return file_format
    suffix = path.suffix.lower()
    if suffix not in FORMAT_OF_SUFFIX:
        raise ScanFileError(
            f"{path}: suffix: {suffix!r} is no scan file: use {', '.join(FORMAT_OF_SUFFIX)}, "
            "or give file_format"
        )
    return FORMAT_OF_SUFFIX[suffix]


def read_text(path: Path) -> str:
    """Return the text of a scan file; raises `ScanFileError` where there is none."""
    try:
        raw = path.read_bytes()
    except OSError as cause:
        raise unreadable(path, cause) from cause
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as cause:
        place = Place(path, raw.count(b"\n", 0, cause.start) + 1)
        raise place.error("text", "not UTF-8", "save the file as UTF-8") from None


def unreadable(path: Path, cause: OSError) -> ScanFileError:
    """Return the error for a scan file that the system refuses to read."""
    return ScanFileError(
        f"{path}: cannot be read ({cause.strerror}): give a file that exists and is readable"
    )


def _truth(records: list[ScanRecord], path: Path) -> Association | None:
    stated = [record.landmarks is not None for record in records]
    if not any(stated):
        return None
    labels: list[list[int | None]] = []
    for record in records:
        if record.landmarks is None:
            raise Place(path, record.line).error(
                "landmarks", "missing, while other scans have them", "give them always or never"
            )
        labels.append([None if label == MISSED else label for label in record.landmarks])
    return Association.from_labels(labels)


def _replace(path: Path, text: str) -> None:
    """Write a temporary file in the same folder, then put it in the old one's place."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        try:
            with temporary.open("w", encoding="utf-8", newline="") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as cause:
        raise ScanFileError(
            f"{path}: cannot be written ({cause.strerror}): give a folder that exists and is "
            "writable"
        ) from cause
