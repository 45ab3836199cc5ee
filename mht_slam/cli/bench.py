"""`mht-slam bench`: all methods on the same scenes or recorded runs; tables and one HTML page."""

from __future__ import annotations

import math
import os
import platform
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import tyro
from rich.console import Console

from mht_slam.arrays import whole_number
from mht_slam.cli.bench_profiles import Profile, profile_sweeps
from mht_slam.cli.options import Work, WorkOptions
from mht_slam.cli.run_folder import to_json, versions, write_json
from mht_slam.cli.study import progress_bar
from mht_slam.errors import MissingExtraError, OptionError

if TYPE_CHECKING:
    from mht_slam.evaluation.bench.case import CaseSource
    from mht_slam.evaluation.bench.compare import Outcome
    from mht_slam.evaluation.bench.methods import Method
    from mht_slam.evaluation.bench.sweep import Sweep

Kind: TypeAlias = Literal["annulus", "one_sided", "corridor", "clusters", "model"]
Noise: TypeAlias = Literal["uniform", "gaussian"]
Own: TypeAlias = tyro.conf.UseAppendAction[tuple[str, ...]]

SWEEP_OPTIONS = (
    "kinds", "landmarks", "noises", "epsilons_deg", "sigmas_deg", "coverage", "n_scans", "steps",
    "heading_sigmas_deg", "detection_probabilities", "false_alarms", "landmark_sigma",
)  # fmt: skip
DEGREES = {
    "epsilons_deg": "epsilons",
    "sigmas_deg": "sigmas",
    "heading_sigmas_deg": "heading_sigmas",
}


@dataclass(frozen=True)
class Participants:
    """Which methods take part, who works, and where results go."""

    method: Own = ()
    """A method of your own, as module:function, found from the current folder; again for more."""
    ours: tuple[str, ...] | None = None
    """Names of our methods that take part; all of them."""
    work: Work = field(default_factory=WorkOptions)


@dataclass(frozen=True)
class CompareCommand:
    """Compare methods on simulated scenes.

    A comparison that is killed goes on where it was when the same command is given again. Without
    options that name settings the profile's sweeps are run; with some, one sweep of them alone.
    """

    quick: bool = False
    """A minute or two instead of a quarter of an hour on two cores."""
    long: bool = False
    """More sizes, layouts and scenes: many hours."""
    kinds: tuple[Kind, ...] | None = None
    """Layouts of the landmarks; `model` draws everything from the assumed model."""
    landmarks: tuple[int, ...] | None = None
    """Numbers of landmarks."""
    noises: tuple[Noise, ...] | None = None
    """Uniform inside epsilon, or Gaussian of sigma, never clipped."""
    epsilons_deg: tuple[float, ...] | None = None
    """Vision errors, degrees."""
    sigmas_deg: tuple[float, ...] | None = None
    """Standard deviations of a bearing, degrees, in place of epsilons."""
    coverage: float | None = None
    """Epsilon over sigma of Gaussian noise; 3."""
    n_scans: tuple[int, ...] | None = None
    """Scans of a run; 3."""
    steps: tuple[float, ...] | None = None
    """Lengths of all steps after the first one, baselines; drawn."""
    heading_sigmas_deg: tuple[float, ...] | None = None
    """Deviations of headings from the direction of travel, degrees; 0."""
    detection_probabilities: tuple[float, ...] | None = None
    """Chances that a landmark is detected; 1."""
    false_alarms: tuple[float, ...] | None = None
    """Expected false alarms a scan; 0."""
    landmark_sigma: float | None = None
    """Scale of the landmark prior that judges, baselines; 30."""
    scenes: int | None = None
    """Scenes of each cell; the profile's number."""
    seed: int = 0
    """Seed of everything random."""
    part: Annotated[Participants, tyro.conf.OmitArgPrefixes] = field(default_factory=Participants)
    output: Path = Path("runs/bench-compare")
    """Folder of the results, in which an interrupted comparison goes on."""

    def run(self, console: Console) -> None:
        """Compare, and write tables and report."""
        jobs = [job for sweep in self._sweeps() for job in sweep.jobs]
        different = {(source.key, scene): (source, scene) for source, scene in jobs}
        title = "Associations of bearings: methods compared on simulated scenes"
        _compare(list(different.values()), self.part, self.output, to_json(self), title, console)

    def _sweeps(self) -> Sequence[Sweep]:
        from mht_slam.evaluation.bench.sweep import Sweep

        if self.quick and self.long:
            raise OptionError("quick and long are given: give one of them")
        profile: Profile = "quick" if self.quick else "long" if self.long else "standard"
        sweeps, scenes = profile_sweeps(profile)
        chosen: dict[str, Any] = {}
        for name in SWEEP_OPTIONS:
            value = getattr(self, name)
            if value is not None and name in DEGREES:
                chosen[DEGREES[name]] = tuple(math.radians(v) for v in value)
            elif value is not None:
                chosen[name] = value
        if self.scenes is not None:
            scenes = whole_number(self.scenes, "scenes", at_least=1)
        whole_number(self.seed, "seed", at_least=0)
        if chosen:
            return [Sweep(**chosen, scenes=scenes, seed=self.seed)]
        return [replace(sweep, scenes=scenes, seed=self.seed) for sweep in sweeps]


@dataclass(frozen=True)
class RecordingsCommand:
    """Compare methods on three-scan runs of the DLR recording.

    First, middle and last scan of every nearly straight segment, with the labelled detections
    common to the three. The model is stated here, not fitted to these segments.
    """

    data: Path | None = None
    """Folder that holds the recordings (`dlr` in it); the environment variable MHT_SLAM_DATA."""
    sigma_deg: float = 0.5
    """Standard deviation of a bearing, degrees."""
    heading_sigma_deg: float = 3.0
    """Deviation of headings from the direction of travel, degrees."""
    coverage: float = 3.0
    """Epsilon over sigma; the wander of the headings enlarges epsilon besides."""
    landmark_sigma: float = 30.0
    """Scale of the landmark prior, baselines."""
    limit: int | None = None
    """First runs only."""
    part: Annotated[Participants, tyro.conf.OmitArgPrefixes] = field(default_factory=Participants)
    output: Path = Path("runs/bench-recordings")
    """Folder of the results, in which an interrupted comparison goes on."""

    def run(self, console: Console) -> None:
        """Read the recording, compare, and write tables and report."""
        jobs = [(source, scene) for source in self._sources() for scene in range(len(source.cases))]
        title = "Associations of bearings: methods compared on recorded runs"
        _compare(jobs, self.part, self.output, to_json(self), title, console)

    def _sources(self) -> list[Any]:
        from mht_slam.datasets import read_dlr, three_scan_runs
        from mht_slam.evaluation.bench.case import Assumptions, Case
        from mht_slam.evaluation.bench.recorded import (
            RecordedRuns,
            in_run_frame,
            poses_in_run_frame,
        )
        from mht_slam.models import ObservationModel

        model = ObservationModel(
            sigma=math.radians(self.sigma_deg),
            heading_sigma=math.radians(self.heading_sigma_deg),
            landmark_sigma=self.landmark_sigma,
        )
        folder = None if self.data is None else self.data / "dlr"
        runs = three_scan_runs(read_dlr(folder))[: self.limit]
        assumptions = Assumptions(self.coverage * model.sigma, model)
        cases: dict[int, list[Case]] = {}
        for run in runs:
            poses = run.reference_poses
            landmarks = in_run_frame(run.reference_landmarks, poses)
            case = Case(run.run, run.truth, assumptions, poses_in_run_frame(poses), landmarks)
            cases.setdefault(run.n, []).append(case)
        return [
            RecordedRuns(f"dlr strict, three scans, n={n}", tuple(cases[n])) for n in sorted(cases)
        ]


@dataclass(frozen=True)
class Bench:
    """Compare methods: ours, the trivial ones, and your own, on the same scenes."""

    command: tyro.conf.OmitSubcommandPrefixes[
        tyro.conf.OmitArgPrefixes[
            Annotated[CompareCommand, tyro.conf.subcommand("compare")]
            | Annotated[RecordingsCommand, tyro.conf.subcommand("recordings")]
        ]
    ]

    def run(self, console: Console) -> None:
        """Run the comparison that was asked for."""
        self.command.run(console)


def _compare(
    jobs: Sequence[tuple[CaseSource, int]],
    part: Participants,
    folder: Path,
    options: dict[str, Any],
    title: str,
    console: Console,
) -> None:
    from mht_slam.evaluation.bench.compare import compare

    own = _own_methods(part.method)
    with part.work.executor() as executor, progress_bar("comparing") as progress:
        outcome = compare(
            jobs, own, ours=part.ours, store=folder, executor=executor, progress=progress
        )
    configuration = {"options": options, "versions": versions(), "machine": machine_in_words()}
    _write(folder, outcome, configuration, title, console)


def _own_methods(names: Sequence[str]) -> dict[str, Method]:
    from mht_slam.evaluation.bench.methods import load_method

    if names and "" not in sys.path and str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))  # as `python -m` would find them
    return {name: load_method(name) for name in names}


def _write(
    folder: Path, outcome: Outcome, configuration: dict[str, Any], title: str, console: Console
) -> None:
    from mht_slam.evaluation.bench.report import html_report
    from mht_slam.evaluation.bench.summary import markdown, summarise, summary_rows
    from mht_slam.evaluation.bench.tables import tidy_rows, time_rows, write_csv, write_parquet
    from mht_slam.plotting.bench_report import report_pictures

    summary, rows = summarise(outcome), tidy_rows(outcome)
    write_csv(folder / "rows.csv", rows)
    write_csv(folder / "summary.csv", summary_rows(summary))
    write_csv(folder / "times.csv", time_rows(outcome))
    try:
        write_parquet(folder / "rows.parquet", rows)
    except MissingExtraError as missing:
        console.print(str(missing), soft_wrap=True)
    (folder / "summary.md").write_text(markdown(summary), encoding="utf-8")
    write_json(folder / "configuration.json", configuration)
    flat = {
        **{f"option {name}": value for name, value in configuration["options"].items()},
        **{f"version of {name}": value for name, value in configuration["versions"].items()},
        "machine": configuration["machine"],
    }
    page = html_report(summary, report_pictures(summary), flat, title=title)
    (folder / "report.html").write_text(page, encoding="utf-8")
    for row in summary.overall:
        rate = row.exact
        console.print(
            f"{row.method:<26} exact {rate.estimate:.3f} [{rate.low:.3f}, {rate.high:.3f}] of "
            f"{row.scenes}, {row.failures} failed"
        )
    console.print(f"Report: {folder / 'report.html'}", soft_wrap=True)


def machine_in_words() -> str:
    """Return processor, cores and system; nothing that names this very machine."""
    model = platform.processor() or platform.machine()
    listed = Path("/proc/cpuinfo")
    if listed.is_file():
        lines = listed.read_text(encoding="utf-8", errors="replace").splitlines()
        names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
        model = names[0] if names else model
    return f"{model}, {os.cpu_count()} cores, {platform.system()} on {platform.machine()}"
