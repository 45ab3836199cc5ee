"""Scans as CSV: one detection a row, ``scan,time,bearing_deg[,landmark]``.

The format holds bearings, times and true landmarks. It has no room for sigmas, labels, odometry
or scans without detections; writing any of those is refused rather than lost.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mht_slam.datasets.scan_records import Place, ScanRecord, check_landmarks, exact_degrees
from mht_slam.errors import ScanFileError
from mht_slam.measurements import BearingScan

COLUMNS = ("scan", "time", "bearing_deg")
TRUTH_COLUMN = "landmark"


class _Row(NamedTuple):
    scan: int
    time: float | None
    bearing: float
    landmark: int | None
    line: int


def parse_csv(text: str, path: Path) -> list[ScanRecord]:
    """Read the scans of a CSV file; raises `ScanFileError`.

    Scan numbers are whole, start anywhere and go up by one: a gap could mean a scan that saw
    nothing or one that does not exist, so it is refused.
    """
    rows = _rows(text, path)
    records: list[ScanRecord] = []
    previous: int | None = None
    for number, group in groupby(rows, key=lambda row: row.scan):
        members = list(group)
        place = Place(path, members[0].line)
        if previous is not None and number != previous + 1:
            raise place.error(
                "scan",
                f"{number} follows {previous}",
                "number the scans one by one, upwards; scans that saw nothing need JSON lines",
            )
        previous = number
        records.append(_record(members, path))
    return records


def format_csv(
    scans: Sequence[BearingScan], landmarks: Sequence[Sequence[int]] | None, path: Path
) -> str:
    """Return the text of the file; `landmarks` are the true ids of each scan.

    Raises `ScanFileError` for what CSV has no room for.
    """
    out = io.StringIO(newline="")
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS if landmarks is None else (*COLUMNS, TRUTH_COLUMN))
    for number, scan in enumerate(scans):
        _refuse_loss(scan, number, path)
        time = "" if scan.time is None else repr(scan.time)
        for detection, bearing in enumerate(scan.bearings.tolist()):
            row: list[object] = [number, time, repr(exact_degrees(bearing))]
            writer.writerow(row if landmarks is None else [*row, landmarks[number][detection]])
    return out.getvalue()


def _refuse_loss(scan: BearingScan, number: int, path: Path) -> None:
    has_no_room_for = {
        "bearings": len(scan) == 0,
        "sigma": scan.sigma is not None,
        "labels": scan.labels is not None,
        "odometry": scan.odometry is not None,
    }
    for field, present in has_no_room_for.items():
        if present:
            what = "no detections" if field == "bearings" else field
            raise ScanFileError(
                f"{path}: scan {number}: {field}: CSV has no room for a scan with {what}: "
                "write JSON lines (.jsonl)"
            )


def _rows(text: str, path: Path) -> list[_Row]:
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    rows: list[_Row] = []
    columns: tuple[str, ...] | None = None
    try:
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            place = Place(path, reader.line_num)
            if columns is None:
                columns = _header(cells, place)
                continue
            rows.append(_row(cells, columns, place))
    except csv.Error as cause:
        place = Place(path, reader.line_num)
        raise place.error("row", f"not CSV ({cause})", "separate fields by commas") from None
    if columns is not None and not rows:
        raise Place(path, reader.line_num).error(
            "rows", "only a header", "give one detection a row"
        )
    return rows


def _header(cells: list[str], place: Place) -> tuple[str, ...]:
    columns = tuple(cell.strip() for cell in cells)
    if columns not in (COLUMNS, (*COLUMNS, TRUTH_COLUMN)):
        raise place.error(
            "header", ",".join(columns), f"give {','.join(COLUMNS)} and optionally {TRUTH_COLUMN}"
        )
    return columns


def _row(cells: list[str], columns: tuple[str, ...], place: Place) -> _Row:
    if len(cells) != len(columns):
        raise place.error(
            "row", f"{len(cells)} fields", f"give {len(columns)}: {','.join(columns)}"
        )
    values = {column: cell.strip() for column, cell in zip(columns, cells, strict=True)}
    scan = _whole(values["scan"], "scan", place)
    if scan < 0:
        raise place.error("scan", f"{scan}", "give a whole number of at least 0")
    return _Row(
        scan=scan,
        time=_decimal(values["time"], "time", place) if values["time"] else None,
        bearing=_decimal(values["bearing_deg"], "bearing_deg", place),
        landmark=(
            _whole(values[TRUTH_COLUMN], TRUTH_COLUMN, place) if TRUTH_COLUMN in values else None
        ),
        line=place.line,
    )


def _record(rows: list[_Row], path: Path) -> ScanRecord:
    first = rows[0]
    for row in rows:
        if row.time != first.time:
            raise Place(path, row.line).error(
                "time", f"{row.time} inside a scan of {first.time}", "give one time per scan"
            )
    landmarks = tuple(row.landmark for row in rows if row.landmark is not None)
    for i, row in enumerate(rows):
        # Checked row by row, so that the error names the row that is wrong.
        check_landmarks(landmarks[: i + 1], min(i + 1, len(landmarks)), Place(path, row.line))
    return ScanRecord(
        scan=BearingScan(np.array([math.radians(row.bearing) for row in rows]), time=first.time),
        landmarks=landmarks if first.landmark is not None else None,
        line=first.line,
    )


def _decimal(text: str, field: str, place: Place) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number) or "_" in text:
        raise place.error(field, f"{text!r}", "give a finite number")
    return number


def _whole(text: str, field: str, place: Place) -> int:
    try:
        number = int(text)
    except ValueError:
        raise place.error(field, f"{text!r}", "give a whole number") from None
    if "_" in text:
        raise place.error(field, f"{text!r}", "give a whole number")
    return number
