"""Scans as they arrive: one JSON line after the other, from a file or a pipe."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

from mht_slam.datasets.scan_csv import parse_csv
from mht_slam.datasets.scan_files import file_format_of, read_text, unreadable
from mht_slam.datasets.scan_json import parse_json_line
from mht_slam.datasets.scan_records import Place, ScanRecord
from mht_slam.errors import ScanFileError

ScanStream: TypeAlias = Iterator[tuple[int, ScanRecord | ScanFileError]]
"""Number of a line, from 1, and the scan that it holds or what is wrong with it."""

BYTE_ORDER_MARK = b"\xef\xbb\xbf"


def stream_json_lines(source: Iterable[bytes], name: str | os.PathLike[str]) -> ScanStream:
    """Read scans from lines as soon as they are there; blank lines are passed over.

    The lines are those of `read_scans`. A malformed one gives a `ScanFileError`, of the form
    "name:line: field: what: remedy", in the place of its scan, and reading goes on behind it.
    """
    for number, line in enumerate(source, start=1):
        raw = line.removeprefix(BYTE_ORDER_MARK) if number == 1 else line
        if raw.strip():
            yield number, _parsed(raw, Place(Path(name), number))


@contextmanager
def stream_scans(path: str | os.PathLike[str]) -> Iterator[ScanStream]:
    """Hold a scan file open and read its scans one after the other, as `stream_json_lines` does.

    A CSV file is read as a whole: behind a wrong row nobody knows where a scan begins. Raises
    `ScanFileError` for a file that cannot be read, and for a malformed CSV.
    """
    source = Path(path)
    if file_format_of(source) == "csv":
        records = parse_csv(read_text(source), source)
        yield iter([(record.line, record) for record in records])
        return
    try:
        file = source.open("rb")
    except OSError as cause:
        raise unreadable(source, cause) from cause
    with file:
        yield stream_json_lines(file, source)


def _parsed(raw: bytes, place: Place) -> ScanRecord | ScanFileError:
    try:
        return parse_json_line(raw.decode("utf-8"), place)
    except UnicodeDecodeError:
        return place.error("text", "not UTF-8", "write UTF-8")
    except ScanFileError as error:
        return error
