"""Text and comma-separated tables of recordings, with errors that name file and line."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mht_slam.arrays import FloatArray
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


def read_numbers(path: Path, fields: tuple[str, ...]) -> FloatArray:
    """Read lines of finite numbers between blanks, the first of them a time; (k, len(fields)).

    Blank lines and those that begin with # are left out. Raises `RecordingError`, with file, line
    and field, for another number of fields, a value that is no finite number, or time that runs
    backwards.
    """
    lines = enumerate(read_text(path).split("\n"), start=1)
    rows = [(line, text.split()) for line, text in lines if text.strip() and text.strip()[0] != "#"]
    for line, words in rows:
        if len(words) != len(fields):
            what = f"{len(words)} fields"
            raise FieldReader(path, line).error("row", what, f"expected {' '.join(fields)}")
    try:
        numbers = np.array([words for _, words in rows], dtype=np.float64)
    except ValueError:
        numbers = np.full((len(rows), len(fields)), math.nan)
    if not np.isfinite(numbers).all():  # again, and slowly: one of them is to be named
        for line, words in rows:
            for word, name in zip(words, fields, strict=True):
                FieldReader(path, line).number(word, name)
    numbers = numbers.reshape(-1, len(fields))
    back = np.flatnonzero(np.diff(numbers[:, 0]) < 0.0)
    if len(back):
        line, words = rows[back[0] + 1]
        what = f"it runs backwards from {rows[back[0]][1][0]}"
        raise FieldReader(path, line).error(fields[0], words[0], what)
    return numbers
