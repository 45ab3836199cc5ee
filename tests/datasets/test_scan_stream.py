"""Scans one line after the other: each is there at once, and a bad line costs itself alone."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from mht_slam.datasets import ScanRecord, read_scans, stream_json_lines, stream_scans
from mht_slam.errors import ScanFileError

LINE = b'{"time": 1.5, "bearings_deg": [10, -20.5], "landmarks": [4, -1]}\n'


@pytest.mark.parametrize(
    ("name", "content", "lines"),
    [
        ("scans.jsonl", b"\xef\xbb\xbf" + LINE + b"\n" + LINE.replace(b"1.5", b"2"), [1, 3]),
        (
            "scans.csv",
            b"scan,time,bearing_deg,landmark\n7,1.5,10,4\n7,1.5,-20,-1\n8,2,3,4\n",
            [2, 4],
        ),
    ],
)
def test_a_stream_gives_what_reading_the_file_gives(
    name: str, content: bytes, lines: list[int], tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with stream_scans(path) as stream:
        found = list(stream)
    assert [number for number, _ in found] == lines
    records = [entry for _, entry in found if isinstance(entry, ScanRecord)]
    assert [record.scan for record in records] == list(read_scans(path).scans)
    assert records[0].landmarks == (4, -1)


def test_a_scan_is_there_before_the_next_line_is_written() -> None:
    ends = os.pipe()
    with os.fdopen(ends[0], "rb") as reader, os.fdopen(ends[1], "wb", 0) as writer:
        stream = stream_json_lines(reader, "pipe")
        for number in (1, 2):
            writer.write(LINE)
            assert next(stream)[0] == number


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (b"{]\n", "pipe:2: column 2: not JSON"),
        (b'{"bearings_deg": [1, "x"]}\n', "pipe:2: bearings_deg[1]: a string"),
        (b'{"bearings_deg": [1], "time": "noon"}\n', "pipe:2: time: a string"),
        (b'{"bearings_deg": [\xff]}\n', "pipe:2: text: not UTF-8"),
        (b"\xef\xbb\xbf" + LINE, "pipe:2: "),
    ],
)
def test_a_malformed_line_is_named_and_those_behind_it_are_read(line: bytes, said: str) -> None:
    found = list(stream_json_lines([LINE, line, LINE], "pipe"))
    assert [number for number, _ in found] == [1, 2, 3]
    assert [isinstance(entry, ScanFileError) for _, entry in found] == [False, True, False]
    assert str(found[1][1]).startswith(said)


def test_a_half_written_last_line_is_malformed() -> None:
    (_, first), (_, last) = stream_json_lines([LINE, LINE[:30]], "pipe")
    assert isinstance(first, ScanRecord)
    assert isinstance(last, ScanFileError)


def test_a_file_that_is_not_there_or_a_wrong_csv_row_is_said_at_once(tmp_path: Path) -> None:
    with pytest.raises(ScanFileError, match="cannot be read"), stream_scans(tmp_path / "no.jsonl"):
        pass
    wrong = tmp_path / "wrong.csv"
    wrong.write_text("scan,time,bearing_deg\n0,0,1\n0,0,x\n")
    with pytest.raises(ScanFileError, match=r"wrong\.csv:3: bearing_deg"), stream_scans(wrong):
        pass
