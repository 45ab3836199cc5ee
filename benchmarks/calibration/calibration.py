"""Do stated probabilities come true: polygon scores, likelihoods and evidences side by side.

    python benchmarks/calibration/calibration.py [--quick] [--output DIR] [--workers N]
        [--cells PATTERN ...] [--scenes N] [--mismatch-scenes N] [--marginal-scenes N]

Every scene is a run of three scans. All scorers weigh the same candidates: every association
within e^-40 of the largest exact evidence, at most 200, and the first ones of the polygon rankings.
Cells of kind "model" are drawn from the model that judges them; there probabilities must come true.

Each scene is one line of rows.jsonl as soon as it is there, whatever the number of workers: a study
that was killed goes on where it was. Lines that other sources scored are kept but not used. With
--cells only cells whose name matches one of the patterns are run; tables show all that was done.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from fnmatch import fnmatch
from functools import partial
from pathlib import Path

from calibration_cells import Cell
from calibration_figure import draw
from calibration_plan import all_cells
from calibration_scores import Row, code_version, score_scene
from calibration_tables import summarise
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

ROOT = Path(__file__).parents[2]
CHUNK = 4
"""Scenes sent to a worker at a time."""
QUICK_SCENES = 40

Job = tuple[Cell, int]


def main(arguments: Sequence[str] | None = None) -> int:
    """Score what is missing, then write summary and figure."""
    options = _parse(arguments)
    console = Console(stderr=True)
    version = code_version(ROOT)
    options.output.mkdir(parents=True, exist_ok=True)
    path = options.output / "rows.jsonl"
    rows = {row.key: row for row in read_rows(path) if row.code == version}
    jobs = planned(options)
    missing = [job for job in jobs if (job[0].name, job[1]) not in rows]
    console.print(f"{len(jobs) - len(missing)} of {len(jobs)} scenes are done")
    measure = partial(_measure, version, options.marginal_scenes)
    with path.open("a", encoding="utf-8") as file:
        for row in _with_bar(_run(measure, missing, options.workers), len(missing), console):
            file.write(json.dumps(asdict(row), separators=(",", ":")) + "\n")
            file.flush()
            rows[row.key] = row
    if not rows:
        print("calibration: no scene was scored", file=sys.stderr)
        return 1
    lines = list(summarise(all_cells(), list(rows.values())))
    (options.output / "summary.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    draw(all_cells(), list(rows.values())).savefig(options.output / "calibration.png", dpi=150)
    print("\n".join(lines))
    print(f"\nrows, summary and figure in {options.output}")
    return 0


def planned(options: argparse.Namespace) -> list[Job]:
    """All scenes wanted, cell by cell."""
    return [
        (cell, seed)
        for cell in all_cells()
        if any(fnmatch(cell.name, pattern) for pattern in options.cells)
        for seed in range(options.scenes if cell.from_model else options.mismatch_scenes)
    ]


def read_rows(path: Path) -> list[Row]:
    """Read what was finished, dropping a last line that was cut; none where there is no file."""
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        os.truncate(path, len(whole.encode()))
    return [Row(**json.loads(line)) for line in whole.splitlines()]


def _measure(version: str, marginal_scenes: int, job: Job) -> Row:
    cell, seed = job
    return score_scene(cell, seed, version, marginal=seed < marginal_scenes)


def _run(measure: Callable[[Job], Row], jobs: list[Job], workers: int) -> Iterator[Row]:
    """Rows in the order of the jobs; one worker is this process."""
    if workers == 1 or not jobs:
        yield from map(measure, jobs)
        return
    with ProcessPoolExecutor(workers) as pool:
        yield from pool.map(measure, jobs, chunksize=CHUNK)


def _with_bar(rows: Iterable[Row], total: int, console: Console) -> Iterator[Row]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bar:
        yield from bar.track(rows, total=total, description="scenes")


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, default=Path("runs/calibration"))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_SCENES} scenes a cell")
    parser.add_argument("--cells", nargs="+", default=["*"], help="patterns of cell names")
    parser.add_argument("--scenes", type=int, default=2000, help="of each model cell")
    parser.add_argument("--mismatch-scenes", type=int, default=500, help="of each other cell")
    parser.add_argument(
        "--marginal-scenes", type=int, default=100, help="first ones with the marginal evidence too"
    )
    options = parser.parse_args(arguments)
    if options.quick:
        options.scenes = min(options.scenes, QUICK_SCENES)
        options.mismatch_scenes = min(options.mismatch_scenes, QUICK_SCENES)
    return options


if __name__ == "__main__":
    sys.exit(main())
