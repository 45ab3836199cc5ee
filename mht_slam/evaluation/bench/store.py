"""Finished jobs on disk: one line each as soon as it is there, so that a killed sweep goes on."""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import platform
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any, TextIO

from mht_slam import __version__
from mht_slam.errors import OptionError
from mht_slam.evaluation.bench.jobs import JobResult, JobTimes
from mht_slam.evaluation.bench.judging import Verdict
from mht_slam.evaluation.bench.methods import Method, source_of

RESULTS_FILE, TIMES_FILE = "results.jsonl", "times.jsonl"
FORMAT = 1

_ENGINES = ("numpy", "scipy", "shapely", "gtsam")
_NO_PART_OF_RESULTS = {"cli", "plotting", "vision", "datasets"}
_DRAWN_LATER = {
    "store.py",
    "compare.py",
    "tables.py",
    "summary.py",
    "report.py",
    "work.py",
    "gate.py",
}
"""Modules of this package that only read results."""


class JobStore:
    """The finished jobs of a folder, and the files that more are written to.

    Attributes
    ----------
    results : by job key, in the order of writing.
    times : by job key.
    """

    def __init__(self, results: TextIO, times: TextIO, header: Mapping[str, Any]) -> None:
        self._results, self._times = results, times
        self.results: dict[tuple[str, int], JobResult] = {}
        self.times: dict[tuple[str, int], JobTimes] = {}
        lines = _whole_lines(results)
        if lines:
            _require_same(lines[0], header, Path(results.name))
        else:
            _append(results, header)
        for line in lines[1:]:
            result = _result_of(line)
            self.results.setdefault(result.key, result)
        for line in _whole_lines(times):
            taken = JobTimes(**line)
            self.times[(taken.source, taken.scene)] = taken

    def add(self, result: JobResult, times: JobTimes) -> None:
        """Write a finished job. It counts once its line is whole; a cut line is dropped later."""
        if result.key in self.results:
            return
        # Times first: a job whose results are there has its times too.
        _append(self._times, asdict(times))
        _append(self._results, asdict(result))
        self.times[result.key] = times
        self.results[result.key] = result


@contextmanager
def job_store(folder: Path, methods: Mapping[str, Method]) -> Iterator[JobStore]:
    """Open the store in a folder, which is made where there is none.

    Results are kept apart by what they rest on: a store of other methods, other code or other
    versions of the engines is refused. Raises `OptionError` for such a store, for one that
    another process writes to, and for a file that is no store.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (
        (folder / RESULTS_FILE).open("a+", encoding="utf-8", newline="\n") as results,
        (folder / TIMES_FILE).open("a+", encoding="utf-8", newline="\n") as times,
    ):
        try:
            fcntl.flock(results, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as cause:
            raise OptionError(
                f"{results.name} is being written by another process: wait for it, or give "
                "another folder"
            ) from cause
        yield JobStore(results, times, store_header(methods))


def store_header(methods: Mapping[str, Method]) -> dict[str, Any]:
    """Return what results rest on: format, code, methods, versions."""
    return {
        "format": FORMAT,
        "mht-slam": __version__,
        "code": code_digest(),
        "methods": {name: _digest(source_of(method)) for name, method in methods.items()},
        "versions": engine_versions(),
    }


def engine_versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that numbers come from."""
    python = ".".join(platform.python_version_tuple()[:2])
    return {"python": python, **{name: version(name) for name in _ENGINES}}


def code_digest() -> str:
    """Digest of all sources that a job's result rests on."""
    package = Path(__file__).resolve().parents[2]
    folders = [package]
    if not (package / "factors").is_dir():  # an editable installation has it beside the package
        folders.append(package.parent / "factors")
    digest = hashlib.sha256()
    for folder in folders:
        for path in sorted(folder.rglob("*.py")):
            place = path.relative_to(folder.parent).parts
            reads_only = path.parent == Path(__file__).parent and path.name in _DRAWN_LATER
            if not reads_only and place[1] not in _NO_PART_OF_RESULTS:
                digest.update("/".join(place).encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _whole_lines(file: TextIO) -> list[dict[str, Any]]:
    """Read the lines that were finished, and cut off one that was not."""
    file.seek(0)
    text = file.read()
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        os.truncate(file.name, len(whole.encode()))
    file.seek(0, os.SEEK_END)
    lines = []
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            entry = json.loads(line)
        except ValueError as cause:
            raise OptionError(
                f"{file.name}, line {number}, is no finished job: give another folder, or remove "
                "the file"
            ) from cause
        lines.append(entry)
    return lines


def _append(file: TextIO, entry: Mapping[str, Any]) -> None:
    """Write one line at once, past all buffers of this process."""
    file.write(json.dumps(entry, separators=(",", ":"), allow_nan=False) + "\n")
    file.flush()


def _require_same(found: Mapping[str, Any], wanted: Mapping[str, Any], path: Path) -> None:
    if found.get("format") != FORMAT:
        raise OptionError(f"{path} is no store of results of this format: give another folder")
    other = [name for name in wanted if found.get(name) != wanted[name]]
    if other:
        raise OptionError(
            f"{path} holds results of other {' and '.join(other)}: give another folder, or remove "
            "it to begin anew"
        )


def _result_of(line: dict[str, Any]) -> JobResult:
    verdicts = tuple(Verdict(**verdict) for verdict in line.pop("verdicts"))
    return JobResult(**line, verdicts=verdicts)
