"""Whole drives: the estimator, baselines and ceilings on recordings and simulations.

    python benchmarks/recordings/drives.py [--output DIR] [--workers N] [--set SET ...]
        [--method METHOD ...] [--half HALF] [--limit N]

Drives at even places of a set tune options, those at odd places are scored; a set of a single drive
takes the options of another set (drive_sets.py). A method with several options gets the one of the
greatest pooled F1 on the tuning half; with `--half scored` the others skip that half. Drives longer
than two hundred scans are also looked at in parts of a hundred.

Rows are added to rows.csv as they come; a second call does only what is missing there for the same
code. A drive on which a method fails counts as without an answer.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from dataclasses import dataclass, fields, replace
from pathlib import Path

import dead_reckoning
import joint_compatibility
import known_association
import multi_hypothesis
import nearest_neighbour
import trackers_on_drives
from contenders import code_version
from drive_scores import Answer, NotApplicableError, Row, score
from drive_sets import HALVES, MODELS, READERS, TUNED_ON, drives_of, half_of
from drives_summary import best_options, summarise
from rich.console import Console
from rich.progress import track

from mht_slam.datasets import Drive
from mht_slam.errors import MhtSlamError
from mht_slam.models import ObservationModel


@dataclass(frozen=True)
class Method:
    """An estimator: what answers, its options, and the modules that its answers rest on."""

    answer: Callable[[Drive, ObservationModel, str], Answer]
    options: tuple[str, ...]
    code: tuple[str, ...]


METHODS = {
    "given truth": Method(
        known_association.given_truth, known_association.GATES, ("known_association",)
    ),
    "given truth and view": Method(
        known_association.given_truth_and_view, known_association.GATES, ("known_association",)
    ),
    "known association": Method(
        known_association.answer, known_association.OPTIONS, ("known_association",)
    ),
    "dead reckoning": Method(dead_reckoning.answer, dead_reckoning.OPTIONS, ("dead_reckoning",)),
    "nearest-bearing tracker": Method(
        trackers_on_drives.answer, trackers_on_drives.OPTIONS, ("trackers_on_drives",)
    ),
    "nearest neighbour": Method(
        nearest_neighbour.answer, nearest_neighbour.OPTIONS, ("nearest_neighbour", "ekf_slam")
    ),
    "joint compatibility": Method(
        joint_compatibility.answer,
        joint_compatibility.OPTIONS,
        ("joint_compatibility", "ekf_slam"),
    ),
    "one hypothesis": Method(
        multi_hypothesis.answer, multi_hypothesis.ONE, ("multi_hypothesis", "mht_slam.incremental")
    ),
    "multi-hypothesis": Method(
        multi_hypothesis.answer,
        multi_hypothesis.OPTIONS,
        ("multi_hypothesis", "mht_slam.incremental"),
    ),
    "multi-hypothesis, fitted": Method(
        multi_hypothesis.answer,
        multi_hypothesis.FITTED,
        ("multi_hypothesis", "mht_slam.incremental", "mht_slam.fitting"),
    ),
    "multi-hypothesis, drawn anew": Method(
        multi_hypothesis.answer,
        multi_hypothesis.ANEW,
        ("multi_hypothesis", "mht_slam.incremental"),
    ),
    "multi-hypothesis, fitted and drawn anew": Method(
        multi_hypothesis.answer,
        multi_hypothesis.FITTED_ANEW,
        ("multi_hypothesis", "mht_slam.incremental", "mht_slam.fitting"),
    ),
}
SHARED_CODE = (
    "drive_sets",
    "drive_scores",
    "mht_slam.datasets",
    "mht_slam.simulation.drives",
    "mht_slam.evaluation.known_association",
    "mht_slam.evaluation.landmark_maps",
    "mht_slam.evaluation.trajectories",
)


@dataclass(frozen=True)
class Job:
    """One method with one option on one drive."""

    set_name: str
    place: int
    method: str
    option: str
    code: str


def main(arguments: Sequence[str] | None = None) -> int:
    """Do what is missing, and write rows and summary."""
    options = _parse(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    table = RowTable(options.output / "rows.csv")
    try:
        for name in options.set:
            drives_of(name)
    except MhtSlamError as error:
        print(f"drives: {error}", file=sys.stderr)
        return 2
    console = Console(stderr=True)
    with ProcessPoolExecutor(options.workers) as pool:
        tuning = list(_tuning_jobs(options))
        work(tuning, table, pool, console, "tuning half")
        if options.half != "tuning":
            chosen = best_options(table.of(tuning))
            work(list(_scored_jobs(options, chosen)), table, pool, console, "scored half")
    wanted = {(name, method) for name in options.set for method in options.method}
    rows = [row for row in table.rows if (row.set_name, row.method) in wanted]
    lines = list(summarise(rows, {name: MODELS[name].describe() for name in options.set}))
    (options.output / "summary.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))
    print(f"\nrows and summary in {options.output}")
    return 0


class RowTable:
    """rows.csv: what was finished before, and what is added, a drive at a time.

    Attributes
    ----------
    rows : those of the present code.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._names = [field.name for field in fields(Row)]
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        whole = text[: text.rfind("\n") + 1]  # the last line may have been cut
        lines = whole.splitlines()
        if not lines or lines[0] != ",".join(self._names):
            if lines:  # columns of another time: kept, but of no use here
                path.rename(path.with_suffix(".old.csv"))
            whole, lines = ",".join(self._names) + "\n", []
        if whole != text:
            path.write_text(whole, encoding="utf-8")
        known = {code_of(method) for method in METHODS}
        read = [Row.from_dict(cells) for cells in csv.DictReader(lines)]
        self.rows = [row for row in read if row.code in known]

    def add(self, rows: Sequence[Row]) -> None:
        """Append the rows of a finished drive."""
        with self._path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, self._names, lineterminator="\n").writerows(
                row.to_dict() for row in rows
            )
        self.rows += rows

    def of(self, jobs: Sequence[Job]) -> list[Row]:
        """Return the rows of these jobs."""
        wanted = {_key(job) for job in jobs}
        return [row for row in self.rows if _row_key(row) in wanted]

    def missing(self, jobs: Sequence[Job]) -> list[Job]:
        """Return those of the jobs that are not finished."""
        done = {_row_key(row) for row in self.rows}
        return [job for job in jobs if _key(job) not in done]


def work(jobs: Sequence[Job], table: RowTable, pool: Executor, console: Console, what: str) -> None:
    """Do the jobs that are not in the table."""
    missing = table.missing(jobs)
    futures = [pool.submit(answered, job) for job in missing]
    for future in track(as_completed(futures), what, total=len(missing), console=console):
        table.add(future.result())


def answered(job: Job) -> list[Row]:
    """Let a method answer a drive, and score it; whatever it raises is its answer."""
    drive = drives_of(job.set_name)[job.place]
    start = time.perf_counter()
    error, answer = "", Answer(None)
    try:
        answer = METHODS[job.method].answer(drive, MODELS[job.set_name], job.option)
    except NotApplicableError as cause:
        error = f"not applicable: {cause}"
    except Exception as cause:  # a method that throws has failed the drive
        error = " ".join(f"{type(cause).__name__}: {cause}".split())
    rows = score(
        drive,
        answer,
        set_name=job.set_name,
        half=half_of(job.set_name, job.place),
        method=job.method,
        option=job.option,
        error=error,
        code=job.code,
    )
    seconds = time.perf_counter() - start
    return [replace(row, seconds=seconds) if not row.part else row for row in rows]


def code_of(method: str) -> str:
    """Digest of the code that the answers of a method rest on."""
    return code_version((*SHARED_CODE, *METHODS[method].code))


def _tuning_jobs(options: argparse.Namespace) -> Iterator[Job]:
    """Every option on the tuning half; a single option where that half itself is wanted."""
    for name in dict.fromkeys(TUNED_ON.get(name, name) for name in options.set):
        for method in options.method:
            choices = METHODS[method].options
            wanted = name in options.set and options.half != "scored"
            if wanted or len(choices) > 1:
                for option in choices:
                    yield from _jobs(name, "tuning", method, option, options.limit)


def _scored_jobs(options: argparse.Namespace, chosen: dict[tuple[str, str], str]) -> Iterator[Job]:
    for name in options.set:
        for method in options.method:
            tuned = chosen.get((TUNED_ON.get(name, name), method), METHODS[method].options[0])
            yield from _jobs(name, "scored", method, tuned, options.limit)


def _jobs(set_name: str, half: str, method: str, option: str, limit: int | None) -> Iterator[Job]:
    places = range(len(drives_of(set_name)))
    of_half = [place for place in places if half_of(set_name, place) == half]
    code = code_of(method)
    for place in of_half[:limit]:
        yield Job(set_name, place, method, option, code)


def _key(job: Job) -> tuple[str, ...]:
    name = drives_of(job.set_name)[job.place].name
    return job.set_name, name, job.method, job.option, job.code


def _row_key(row: Row) -> tuple[str, ...]:
    return row.set_name, row.drive, row.method, row.option, row.code


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, default=Path("runs/drives"))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--set", nargs="+", choices=list(READERS), default=list(READERS))
    parser.add_argument("--method", nargs="+", choices=list(METHODS), default=list(METHODS))
    parser.add_argument("--half", choices=("both", *HALVES), default="both")
    parser.add_argument("--limit", type=int, help="first N drives of each half only")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
