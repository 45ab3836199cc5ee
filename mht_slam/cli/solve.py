"""`mht-slam solve FILE`: rank, refine and compare, then go on over all scans of a file."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import tyro
from rich.console import Console

from mht_slam.association import Association
from mht_slam.cli.options import Method, MethodOptions, Output, OutputOptions, Work, WorkOptions
from mht_slam.cli.run_folder import to_json
from mht_slam.errors import OptionError
from mht_slam.measurements import RunPair, StraightRun


@dataclass(frozen=True)
class Solve:
    """Find out which detections of a file's scans are one landmark, and map the landmarks.

    The associations of three scans (or of two pairs) are ranked, refined and compared. A file of
    more scans is solved over all of them from there. Where the file holds the truth, it is marked.
    Odometry in the file is used with --motion odometry only.
    """

    file: tyro.conf.Positional[Path]
    """Scan file: JSON lines (.jsonl, .json) or CSV (.csv)."""
    scans: tuple[int, int, int] | None = None
    """Solve these three scans alone, in order of travel; the first has number 0."""
    pair: bool = False
    """Take the file's four scans as two straight runs of two scans each."""
    method: Method = field(default_factory=MethodOptions)
    work: Work = field(default_factory=WorkOptions)
    output: Output = field(default_factory=OutputOptions)

    def run(self, console: Console) -> None:
        """Read the file and solve it."""
        from mht_slam.cli.study import Study, run_study
        from mht_slam.datasets import read_scans

        content = read_scans(self.file)
        run: StraightRun | RunPair
        truth: Association | None
        if self.pair:
            if self.scans is not None or len(content.scans) != 4:
                raise OptionError(
                    f"pair: the file has {len(content.scans)} scans: --pair takes a file of "
                    "exactly four, whole, without --scans"
                )
            run, truth = RunPair(content.scans[:2], content.scans[2:]), content.truth
        else:
            run = StraightRun(content.scans)
            truth = content.truth
            if self.scans is not None:
                run.select(self.scans)  # says what is wrong with them before any work
                truth = None if truth is None else truth.restrict(self.scans)
        study = Study(
            command="solve",
            run=run,
            scans=self.scans,
            truth=truth,
            layout=None,
            configuration={"seed": None, "options": to_json(self)},
        )
        run_study(study, self.method, self.work, self.output, console)
