"""The paper's experiment run anew: figures, tables, and which of its claims hold.

    python benchmarks/paper/paper_experiment.py [--output DIR] [--experiments N] [--seed N]
        [--workers N] [--epsilons-deg E ...] [--docs-figure FILE]

Three scans past three landmarks in view, vision error epsilon from 1 to 7 degrees, noise uniform
inside it, 40 experiments each (docs/method.md, section 8). The polygon method stands beside graphs
of its hypotheses, whose estimate is moved to F_L by z = (p - p1) / (p2 - p1). Everything is
measured in metres, ten of them the unit |Lc Le| of F_L. Experiments have randomness of their own:
results do not depend on the number of workers.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

from paper_claims import claims
from paper_curves import curves_figure
from paper_figures import draw_method
from paper_measure import TRACKS, Experiment, Located, Ranked, measure
from paper_outcome import Outcome
from paper_tables import summarise
from rich.console import Console
from rich.progress import track

from mht_slam.parallel import ordered_map

EPSILONS_DEG = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0)
DPI = 110


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all experiments; write rows, summary and figures."""
    options = _parse(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    outcome = run(options.epsilons_deg, options.experiments, options.seed, options.workers)
    write_rows(options.output / "ranked.csv", Ranked._fields, outcome.ranked)
    write_rows(options.output / "located.csv", Located._fields, outcome.located)
    lines = list(summarise(outcome, claims(outcome)))
    (options.output / "summary.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    for name, figure in draw_method(options.seed).items():
        figure.savefig(options.output / f"{name}.png", dpi=DPI)
    for measure_name in ("uncertainty", "error"):
        figure = curves_figure(outcome, (measure_name,))
        figure.savefig(options.output / f"{measure_name}.png", dpi=DPI)
    if options.docs_figure is not None:
        curves_figure(outcome, ("uncertainty", "error")).savefig(options.docs_figure, dpi=DPI)
    print("\n".join(lines))
    print(f"\nrows, summary and figures in {options.output}")
    return 0


def run(
    epsilons_deg: Sequence[float], n_experiments: int, seed: int, n_workers: int = 1
) -> Outcome:
    """Measure every track at every epsilon; one worker is this process."""
    jobs = [
        Experiment(name, epsilon, number, seed)
        for name in TRACKS
        for epsilon in epsilons_deg
        for number in range(n_experiments)
    ]
    console = Console(stderr=True)
    executor = None if n_workers == 1 else ProcessPoolExecutor(n_workers)
    try:
        results = ordered_map(executor, measure, jobs)
        done = list(track(results, "experiments", total=len(jobs), console=console))
    finally:
        if executor is not None:
            executor.shutdown()
    return Outcome(
        ranked=[row for ranked, _ in done for row in ranked],
        located=[row for _, located in done for row in located],
    )


def write_rows(path: Path, names: Sequence[str], rows: Iterable[NamedTuple]) -> None:
    """Write one CSV line a row, numbers in full."""
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(names)
        table.writerows(rows)


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, default=Path("runs/paper"))
    parser.add_argument("--experiments", type=int, default=40, help="of each track and epsilon")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--epsilons-deg", type=float, nargs="+", default=EPSILONS_DEG)
    parser.add_argument("--docs-figure", type=Path, help="draw the figure of the docs there, too")
    options = parser.parse_args(arguments)
    if options.experiments < 1 or options.workers < 1:
        parser.error("--experiments and --workers are at least 1")
    return options


if __name__ == "__main__":
    sys.exit(main())
