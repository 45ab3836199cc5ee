"""Text and comma-separated tables of recordings, with errors that name file and line."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mht_slam.errors import RecordingError


@dataclass(frozen=True)
class FieldReader:
    """Reads the fields of one line of a recording."""

    path: Path
    line: int

    def number(self, text: str, name: str) -> float:
        """Return the finite number that `text` writes; raises `RecordingError`."""
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.error(name, repr(text), "a finite number belongs here")
        return value

    def whole(self, text: str, name: str) -> int:
        """Return the whole number that `text` writes; raises `RecordingError`."""
        try:
            return int(text)
        except ValueError:
            raise self.error(name, repr(text), "a whole number belongs here") from None

    def error(self, field: str, what: str, remedy: str) -> RecordingError:
        """Return the error that says what is wrong with `field` on this line."""
        return RecordingError(f"{self.path}:{self.line}: {field}: {what}: {remedy}")


def read_text(path: Path) -> str:
    """Return the text of a recording's file; raises `RecordingError` unless it is UTF-8."""
    raw = path.read_bytes()
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError as cause:
        line = raw.count(b"\n", 0, cause.start) + 1
        raise FieldReader(path, line).error("text", "not UTF-8", "take an unspoilt copy") from None


def read_table(
    path: Path, columns: tuple[str, ...]
) -> Iterator[tuple[FieldReader, dict[str, str]]]:
    """Yield every row under a header that names `columns`, with a reader for its fields.

    Raises `RecordingError` for another header or a row of another length.
    """
    rows = csv.reader(io.StringIO(read_text(path), newline=""))
    for number, cells in enumerate(rows):
        read = FieldReader(path, rows.line_num)
        if number == 0:
            if tuple(cells) != columns:
                raise read.error("header", ",".join(cells), f"expected {','.join(columns)}")
        elif len(cells) != len(columns):
            raise read.error("row", f"{len(cells)} fields", f"expected {len(columns)}")
        else:
            yield read, dict(zip(columns, cells, strict=True))
