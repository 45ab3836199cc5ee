"""The main job behind `demo` and `solve`: rank, refine, compare, then report, tables, figures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from mht_slam.association import Association
from mht_slam.cli.options import MethodOptions, OutputOptions, WorkOptions
from mht_slam.cli.run_folder import run_folder
from mht_slam.errors import UnequalScansError
from mht_slam.measurements import RunPair, StraightRun
from mht_slam.models import ObservationModel
from mht_slam.progress import Progress as ProgressCallback

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from mht_slam.pipeline import Solution
    from mht_slam.plotting import TrueLayout


@dataclass(frozen=True)
class Study:
    """One run to be solved, and what is true of it where that is known.

    Attributes
    ----------
    command, configuration : what goes into the folder's name and its configuration.json.
    scans : three scans of a `StraightRun` to solve alone, or None for all.
    truth, layout : over the scans that are solved; both may be None.
    """

    command: str
    run: StraightRun | RunPair
    scans: tuple[int, int, int] | None
    truth: Association | None
    layout: TrueLayout | None
    configuration: dict[str, Any]


def run_study(
    study: Study,
    method: MethodOptions,
    work: WorkOptions,
    output: OutputOptions,
    console: Console,
) -> Solution:
    """Solve the study, print its report and leave its folder. Raises what the steps raise."""
    # GTSAM and matplotlib take seconds to load; `--help` shall not wait for them.
    from mht_slam.cli.report import print_report
    from mht_slam.cli.results import write_results
    from mht_slam.pipeline import solve

    _refuse_unstated_misses(study, method.model())
    configuration = {**study.configuration, "model": _model_entry(study, method)}
    with run_folder(output.output, study.command, configuration) as folder:
        with work.executor() as executor, progress_bar("refining") as progress:
            solution = solve(
                study.run,
                epsilon=method.epsilon,
                top_k=method.top_k,
                model=method.model(),
                max_range=method.max_range,
                scans=study.scans,
                truth=study.truth,
                executor=executor,
                progress=progress,
            )
        members = [study.run.scans[i] for i in solution.posterior.scans]
        write_results(folder, solution, members, study.truth)
        for name, figure in _figures(study, method, solution):
            _save(figure, folder / f"{name}.{output.figure_format}")
    own_sigmas = any(scan.sigma is not None for scan in study.run.scans)
    print_report(console, solution, study.truth, own_sigmas=own_sigmas)
    console.print(f"Results: {folder}", soft_wrap=True)
    return solution


def _refuse_unstated_misses(study: Study, model: ObservationModel) -> None:
    """Say which options a longer run needs whose scans differ in length."""
    counts = study.run.n_detections
    over_all = study.scans is None and len(counts) > 3 and isinstance(study.run, StraightRun)
    if over_all and len(set(counts)) > 1 and not model.compares_sizes:
        raise UnequalScansError(
            f"the scans have {list(counts)} detections: say what misses and false alarms cost with "
            "--preset, or with --detection-probability, --false-alarm-rate and --expected-landmarks"
        )


def _figures(
    study: Study, method: MethodOptions, solution: Solution
) -> Iterator[tuple[str, Figure]]:
    from mht_slam.cli.results import truth_of
    from mht_slam.plotting import (
        cells_figure,
        comparison_figure,
        landmark_map_figure,
        run_map_figure,
    )

    ranked = solution.posterior if solution.seeds is None else solution.seeds
    best = ranked[0] if len(ranked) else None
    yield (
        "cells",
        cells_figure(
            study.run,
            epsilon=solution.ranking.epsilon,
            max_range=method.max_range,
            scans=solution.ranking.scans,
            association=None if best is None else best.association,
            truth=study.layout,
        ),
    )
    if best is not None:
        of_ranking = next(h for h in solution.ranking if h.association == best.association)
        if of_ranking.map_in_landmark_frame is not None:
            yield (
                "landmark_frame",
                landmark_map_figure(of_ranking.map_in_landmark_frame, best, truth=study.layout),
            )
        truth = truth_of(solution, study.truth)
        yield "comparison", comparison_figure(solution.comparison, truth)
    over_all = solution.posterior[0] if len(solution.posterior) else None
    if over_all is not None and over_all.poses is not None:
        yield "run_map", run_map_figure(over_all, solution.posterior.unit)


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=150)


def _model_entry(study: Study, method: MethodOptions) -> dict[str, Any]:
    """Everything assumed, and which scans bring their own sigma instead."""
    own = [i for i, scan in enumerate(study.run.scans) if scan.sigma is not None]
    return {**method.model().to_dict(), "scans_with_own_sigma": own}


@contextmanager
def progress_bar(text: str) -> Iterator[ProgressCallback]:
    """Draw a bar on stderr, and nothing where that is no terminal."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bars:
        task = bars.add_task(text, total=None)

        def update(done: int, total: int) -> None:
            bars.update(task, completed=done, total=total)

        yield update
