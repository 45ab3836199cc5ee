"""`mht-slam slam FILE`: scan after scan through a file or a live pipe, one result line each."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from mht_slam.arrays import whole_number
from mht_slam.cli.model_options import ModelOptions
from mht_slam.cli.options import Output, OutputOptions
from mht_slam.cli.run_folder import run_folder, to_json
from mht_slam.errors import NoEstimateError, OptionError, ScanFileError
from mht_slam.incremental.config import SlamConfig
from mht_slam.measurements import BearingScan

if TYPE_CHECKING:
    from mht_slam.cli.slam_run import Checkpoints
    from mht_slam.datasets.scan_stream import ScanStream
    from mht_slam.incremental.estimator import MultiHypothesisSlam
    from mht_slam.plotting import FrameRecorder, RerunView

PIPE = Path("-")
PIPE_NAME = Path("stdin")
"""What standard input is called in messages."""

ANIMATION_FILE = "run.gif"


@dataclass(frozen=True)
class EstimatorOptions:
    """What is assumed, and how hard the estimator tries."""

    assumed: Annotated[ModelOptions, tyro.conf.OmitArgPrefixes] = field(
        default_factory=lambda: ModelOptions(preset="panoramic")
    )
    hypotheses: int = SlamConfig.hypotheses
    """Global hypotheses kept from scan to scan."""
    start_hypotheses: int = SlamConfig.start_hypotheses
    """As many while the first scans are open: before there is a map, much is possible."""
    lag: int = SlamConfig.lag
    """Scans whose associations are open; older ones are settled as the best hypothesis says."""
    drop: float = SlamConfig.drop
    """Hypotheses this many nats below the best are dropped."""
    pair_within: int = SlamConfig.pair_within
    """Scans from the first to the second detection of a landmark, at most."""
    sight: float | None = SlamConfig.sight
    """Range beyond which no detection is expected, metres or first steps; any range."""
    active: int = SlamConfig.active
    """Landmarks of the settled map, besides those of the open scans, that a scan may see."""
    loop_odds: float = SlamConfig.loop_odds
    """Nats of evidence that close a loop, from several landmarks together."""
    twin_odds: float = SlamConfig.twin_odds
    """Nats of evidence that make one landmark of two in one place."""
    loop_scans: int = SlamConfig.loop_scans
    """Scans over which that evidence is gathered."""
    remaps: int = SlamConfig.remaps
    """At the end, maps drawn anew from all scans at once; the likeliest is kept."""

    def config(self) -> SlamConfig:
        """Return the estimator's configuration; raises `OptionError`."""
        effort = {
            entry.name: getattr(self, entry.name)
            for entry in fields(self)
            if entry.name != "assumed"
        }
        # A preset states every field, so that no bound on a bearing's error is needed.
        assumed = replace(self.assumed, preset=self.assumed.preset or "panoramic")
        return SlamConfig(model=assumed.model(math.nan), **effort)


Estimator = Annotated[EstimatorOptions, tyro.conf.OmitArgPrefixes]


@dataclass(frozen=True)
class Slam:
    """Find out, scan after scan, where the robot is and which detections are one landmark.

    Standard output gets one JSON line for each scan, as soon as it is understood; everything else
    goes to standard error. A line that is malformed, or a scan that comes late or twice, is
    rejected with one line there, and the run goes on. At the end, which an interrupt or a closed
    pipe may bring, a stamped folder gets trajectory, map, associations and figures. Lengths are
    metres with --motion odometry, first steps else.
    """

    file: tyro.conf.Positional[Path]
    """Scan file: JSON lines (.jsonl, .json) or CSV (.csv); - reads JSON lines from a pipe."""
    estimator: Estimator = field(default_factory=EstimatorOptions)
    fit: bool = False
    """Before anything else, fit to the file what is assumed of landmarks and detections, by the
    evidence of the whole run: for the time of four to eight runs."""
    strict: bool = False
    """End at the first line that is rejected, with exit code 2."""
    checkpoint: Path | None = None
    """File to save the estimator in, now and then and at the end."""
    every: int = 100
    """Scans from one checkpoint to the next."""
    resume: Path | None = None
    """Checkpoint to go on from, with its own configuration. A file that begins like the run that
    made it is passed over as far as the checkpoint goes; others are taken for what comes after."""
    animate: bool = False
    """Also draw how map, path and alternatives came about (run.gif)."""
    rerun: bool = False
    """Watch the run in a window of the rerun viewer (pip install 'mht-slam[rerun]')."""
    rerun_file: Path | None = None
    """Write what it would show to this file (.rrd)."""
    output: Output = field(default_factory=OutputOptions)

    def run(self, console: Console) -> None:
        """Read the scans as they come, tell what they mean, and leave the results."""
        del console  # results are lines for other programs
        from mht_slam.cli.slam_results import write_slam_results
        from mht_slam.cli.slam_run import SlamRun

        checkpoints = self._checkpoints()
        slam, known = self._start()
        recorder, view = self._recorder(slam.n_scans), self._view()
        name = PIPE_NAME if self.file == PIPE else self.file
        run = SlamRun(
            slam,
            known,
            name,
            sys.stdout,  # taken before a progress bar may put something else in its place
            strict=self.strict,
            checkpoints=checkpoints,
            watch=_watchers(recorder, view),
        )
        configuration = {
            "seed": None,
            "options": to_json(self),
            "model": slam.config.observation_model.to_dict(),
        }
        with (
            self._stream() as stream,
            run_folder(self.output.output, "slam", configuration) as folder,
        ):
            with self._progress() as progress:
                ended = run.follow(stream, progress)
            if view is not None:
                view.close()
            if not slam.n_scans:
                raise ended or ScanFileError(f"{name}: no scan could be used: give at least one")
            try:
                write_slam_results(folder, slam, run.records, run.rejected)
                self._draw(folder, slam, recorder)
            except RuntimeError as cause:
                raise NoEstimateError(
                    f"the run as a whole has no solution ({cause}): see the online trajectory in "
                    f"{folder}"
                ) from cause
        if not isinstance(ended, BrokenPipeError):
            sys.stderr.write(f"{_summary(slam, run.rejected.total())}\nResults: {folder}\n")
        if ended is not None:
            raise ended

    def _checkpoints(self) -> Checkpoints | None:
        from mht_slam.cli.slam_run import Checkpoints

        whole_number(self.every, "every", at_least=1)
        if self.checkpoint is None:
            return None
        if not self.checkpoint.resolve().parent.is_dir():
            raise OptionError(f"checkpoint: {self.checkpoint.parent} is no folder: make it")
        return Checkpoints(self.checkpoint, self.every)

    def _recorder(self, resumed_at: int) -> FrameRecorder | None:
        """Return what takes the animation's frames, and keeps them beside the checkpoint."""
        if not self.animate:
            return None
        from mht_slam.plotting import FrameRecorder

        if self.checkpoint is None:
            return FrameRecorder()
        log = self.checkpoint.with_name(f"{self.checkpoint.name}.frames.jsonl")
        return FrameRecorder(log, resumed_at)

    def _view(self) -> RerunView | None:
        if not self.rerun and self.rerun_file is None:
            return None
        if self.rerun and self.rerun_file is not None:
            raise OptionError("rerun and rerun_file are given: give one of them")
        from mht_slam.plotting import RerunView

        return RerunView(self.rerun_file)

    def _draw(
        self, folder: Path, slam: MultiHypothesisSlam, recorder: FrameRecorder | None
    ) -> None:
        from mht_slam.plotting import slam_map_figure

        slam_map_figure(slam).savefig(folder / f"map.{self.output.figure_format}", dpi=150)
        if recorder is not None and recorder.frames:
            from matplotlib.animation import PillowWriter

            from mht_slam.plotting import slam_animation
            from mht_slam.plotting.slam_animation import FRAMES_PER_SECOND

            unit = slam.posterior.unit
            animation = slam_animation(recorder.frames, slam.online_trajectory, unit)
            animation.save(folder / ANIMATION_FILE, PillowWriter(FRAMES_PER_SECOND), dpi=80)

    def _start(self) -> tuple[MultiHypothesisSlam, list[BearingScan]]:
        """Return the estimator, and the scans that it has."""
        from mht_slam.incremental import checkpoint
        from mht_slam.incremental.estimator import MultiHypothesisSlam

        config = self.estimator.config()
        if self.fit:
            config = self._fitted(config)
        if self.resume is None:
            return MultiHypothesisSlam(config), []
        slam = MultiHypothesisSlam.load(self.resume)
        if self.estimator != EstimatorOptions() and slam.config != config:
            raise OptionError(
                f"resume: {self.resume} was made with other options of the estimator: give the "
                "same ones, or none"
            )
        history = checkpoint.read(self.resume).history
        known = [
            BearingScan(bearings, time=None if math.isnan(time) else time)
            for bearings, time in zip(history.bearings, history.times, strict=True)
        ]
        return slam, known

    def _fitted(self, config: SlamConfig) -> SlamConfig:
        from mht_slam.cli.slam_fit import fitted_to

        if self.file == PIPE:
            raise OptionError("fit: a pipe can be read only once: give a file")
        if self.resume is not None:
            raise OptionError("fit and resume are given: a checkpoint has its model, leave out fit")
        return fitted_to(self.file, config)

    @contextmanager
    def _stream(self) -> Iterator[ScanStream]:
        from mht_slam.datasets import stream_json_lines, stream_scans

        if self.file == PIPE:
            yield stream_json_lines(sys.stdin.buffer, PIPE_NAME)
        else:
            with stream_scans(self.file) as stream:
                yield stream

    @contextmanager
    def _progress(self) -> Iterator[Callable[[int], None]]:
        """Draw a bar for a file, unless the lines themselves show how far the run is."""
        if self.file == PIPE or sys.stdout.isatty():
            yield lambda _: None
            return
        from mht_slam.cli.study import progress_bar

        with self.file.open("rb") as file:
            total = sum(1 for _ in file)
        with progress_bar("estimating") as progress:
            yield lambda line: progress(line, total)


def _watchers(
    recorder: FrameRecorder | None, view: RerunView | None
) -> Callable[[MultiHypothesisSlam], None] | None:
    """Return what looks at the estimator after every scan."""
    if recorder is None and view is None:
        return None
    from mht_slam.plotting.slam_frames import frame_of

    def watch(slam: MultiHypothesisSlam) -> None:
        if recorder is not None:
            recorder.take(slam)
        if view is not None and len(slam.posterior):
            view.show(frame_of(slam))

    return watch


def _summary(slam: MultiHypothesisSlam, rejected: int) -> str:
    confirmed = int(slam.map.confirmed.sum())
    text = (
        f"{slam.n_scans} scans, {confirmed} landmarks confirmed of {len(slam.map)}, "
        f"loops closed: {len(slam.loops)}; {slam.status}."
    )
    return text + (f" Lines rejected: {rejected}." if rejected else "")
