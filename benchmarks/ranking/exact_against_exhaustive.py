"""What exact ranking costs, against going through all hypotheses and against linear programs.

    python benchmarks/ranking/exact_against_exhaustive.py [--quick] [--output DIR] [--workers N]

Simulated runs of three scans, n landmarks all seen, noise uniform inside epsilon. Each scene is
ranked exactly (first ten), exhaustively in the same process (n to 7, at epsilon 1 degree to 8), and
asked the other question, consistency, of a linear program. The exhaustive ranking reads tables and
drops halves of hypotheses that can only score zero, so its time is not extrapolated: what it does
in a second grows with n. The reference is one that goes through all feasible pairs of hypotheses,
those whose cells all exist, at 30,000 a second.

Every scene runs in a process of its own, forked from one that has everything compiled, so memory
is that scene's and times hold no compilation; what compiling takes is measured apart. Each result
is a line of rows.csv as soon as it is there: a study that was killed goes on where it was, and
lines measured with other sources of the ranking are kept but not used.
"""

from __future__ import annotations

import argparse
import ast
import csv
import json
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import astuple, fields
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from measure import KINDS, Job, Row, code_version, compile_seconds, measure, warm_up
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from summary import details, draw, summarise

SIZES = (3, 4, 5, 6, 7, 8, 10, 12, 16, 20, 24)
EPSILONS_DEG = (1.0, 3.0, 5.0)
LARGE = 12
"""Scenes of more landmarks may take a minute, so there are fewer of them."""
QUICK_SCENES = 2

_TEXT = ("kind", "code")
_REDRAW_SECONDS = 1.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is missing, then write summary and figure."""
    options = _parse(arguments)
    console = Console(stderr=True)
    version = code_version()
    options.output.mkdir(parents=True, exist_ok=True)
    path = options.output / "rows.csv"
    try:
        rows = {row.job: row for row in read_rows(path) if row.code == version}
    except ValueError as error:
        print(f"exact_against_exhaustive: {error}", file=sys.stderr)
        return 2
    jobs = planned(options)
    missing = [job for job in jobs if job not in rows]
    console.print(f"{len(jobs) - len(missing)} of {len(jobs)} scenes are done")
    if missing:
        rows |= {row.job: row for row in _run(missing, version, path, options.workers, console)}
    compiling = None if options.quick else _compile_seconds(options.output, version)
    done = sorted((rows[job] for job in jobs if job in rows), key=_place)
    if not done:
        print("exact_against_exhaustive: no scene gave a result", file=sys.stderr)
        return 1
    lines = list(summarise(done, compiling))
    _write_lines(options.output / "summary.md", lines)
    _write_lines(options.output / "details.md", details(done))
    draw(done).savefig(options.output / "exact_ranking.png", dpi=150)
    print("\n".join(lines))
    print(f"\nrows, summary, details and figure in {options.output}")
    if len(done) < len(jobs):
        print(f"{len(jobs) - len(done)} scenes ended without a result", file=sys.stderr)
        return 1
    return 0


def _write_lines(path: Path, lines: Iterable[str]) -> None:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _place(row: Row) -> tuple[float, ...]:
    return KINDS.index(row.kind), row.epsilon_deg, row.n, row.seed


def planned(options: argparse.Namespace) -> list[Job]:
    """All jobs, one scene of everything before the second of anything, long ones first."""
    return [
        Job(kind, n, epsilon, seed, options.work_limit)
        for seed in range(options.scenes)
        for n in sorted(options.sizes, reverse=True)
        for epsilon in options.epsilons_deg
        for kind in options.kinds
        if n <= LARGE or seed < options.large_scenes
    ]


def read_rows(path: Path) -> list[Row]:
    """Read what was finished, dropping a last line that was cut; none where there is no file.

    Raises `ValueError` for the rows of another study.
    """
    names = [field.name for field in fields(Row)]
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    whole = text[: text.rfind("\n") + 1]
    if not whole:
        path.write_text(",".join(names) + "\n", encoding="utf-8")
        return []
    if whole != text:
        os.truncate(path, len(whole.encode()))
    header, *lines = csv.reader(whole.splitlines())
    if header != names:
        raise ValueError(f"{path} has other columns: remove it, or give another --output")
    return [
        Row(**{n: _value(n, text) for n, text in zip(names, line, strict=True)}) for line in lines
    ]


def _value(name: str, text: str) -> Any:
    if name in _TEXT:
        return text
    return ast.literal_eval(text) if text else None


def _append(path: Path, row: Row) -> None:
    """Add one line in one write, so that a kill leaves all of it or a cut last line."""
    values = ["" if value is None else str(value) for value in astuple(row)]
    with path.open("a", encoding="utf-8") as file:
        file.write(",".join(values) + "\n")


def _run(
    jobs: Sequence[Job], version: str, path: Path, workers: int, console: Console
) -> Iterator[Row]:
    """Measure the jobs, `workers` at a time, each in a fork of this process.

    The bar has no thread of its own: a process with threads must not be forked.
    """
    console.print("compiling, or loading what is compiled ...")
    console.print(f"... took {warm_up():.0f} s")
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    context = get_context("fork")
    waiting = list(reversed(jobs))
    running: dict[Connection, tuple[BaseProcess, Job]] = {}
    with Progress(*columns, console=console, auto_refresh=False) as bar:
        task = bar.add_task("scenes", total=len(jobs))
        while waiting or running:
            while waiting and len(running) < workers:
                job = waiting.pop()
                receiver, sender = context.Pipe(duplex=False)
                process = context.Process(target=_send, args=(sender, job, version), daemon=True)
                process.start()
                sender.close()
                running[receiver] = (process, job)
            ready = wait(list(running), timeout=_REDRAW_SECONDS)
            for receiver in [each for each in running if each in ready]:
                finished, job = running.pop(receiver)
                try:
                    row = receiver.recv()
                except EOFError:
                    console.print(f"no result: {job}")
                else:
                    _append(path, row)
                    yield row
                receiver.close()
                finished.join()
                bar.advance(task)
            bar.refresh()


def _send(sender: Connection, job: Job, version: str) -> None:
    sender.send(measure(job, version))


def _compile_seconds(output: Path, version: str) -> tuple[float, float]:
    """Measured once for each version of the ranking's sources, then read."""
    path = output / "compile_seconds.json"
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    if version not in known:
        known[version] = compile_seconds()
        path.write_text(json.dumps(known, indent=2) + "\n", encoding="utf-8")
    cold, warm = known[version]
    return cold, warm


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, default=Path("runs/ranking"))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--quick", action="store_true", help="few scenes, n to 12")
    parser.add_argument("--scenes", type=int, default=10, help=f"of each kind, n to {LARGE}")
    parser.add_argument("--large-scenes", type=int, default=5, help="of each kind, larger n")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="landmarks")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--epsilons-deg", type=float, nargs="+", default=EPSILONS_DEG)
    parser.add_argument("--work-limit", type=int, default=2_000_000, help="steps of one ranking")
    options = parser.parse_args(arguments)
    if options.quick:
        options.scenes = min(options.scenes, QUICK_SCENES)
        options.sizes = [n for n in options.sizes if n <= LARGE]
    return options


if __name__ == "__main__":
    sys.exit(main())
