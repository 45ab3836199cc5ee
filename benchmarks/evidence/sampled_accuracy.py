"""How exact the sampled evidence is where headings wander: few points against many.

    python benchmarks/evidence/sampled_accuracy.py [--segments N] [--points N]

For the true association of the first N three-scan DLR segments the evidence is sampled with the
library's number of points and with more; the table shows how far the two are apart, for the
hypotheses whose best explanation stays within reach of probability.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.progress import track

import mht_slam as ms
from mht_slam.datasets.dlr import read_dlr
from mht_slam.datasets.dlr_runs import LabelledRun, three_scan_runs
from mht_slam.errors import MhtSlamError
from mht_slam.evidence import importance

HEADING_SIGMAS_DEG = (1.0, 3.0)
SIGMA_DEG = 0.5
HOPELESS = -15.0
"""Log evidence below which a segment's truth contradicts the model and nothing hangs on it."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Print one row for each heading deviation."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--segments", type=int, default=20)
    parser.add_argument("--points", type=int, default=8 * importance.N_POINTS)
    options = parser.parse_args(arguments)
    try:
        runs = [run for run in three_scan_runs(read_dlr()) if run.n <= 4][: options.segments]
    except MhtSlamError as error:
        print(f"sampled_accuracy: {error}", file=sys.stderr)
        return 2
    few = importance.N_POINTS
    print(
        f"| heading | segments | median, {few} against {options.points} points | 90 % | largest |"
    )
    print("| --- | --- | --- | --- | --- |")
    for heading in HEADING_SIGMAS_DEG:
        model = ms.ObservationModel(sigma=np.deg2rad(SIGMA_DEG), heading_sigma=np.deg2rad(heading))
        pairs = [
            (evidence(run, model, few), evidence(run, model, options.points))
            for run in track(runs, f"{heading:g} deg", console=Console(stderr=True))
        ]
        kept = np.array([pair for pair in pairs if pair[1] > HOPELESS])
        error = np.abs(kept[:, 0] - kept[:, 1])
        cells = (f"{q:.3f}" for q in np.quantile(error, [0.5, 0.9, 1.0]))
        print(f"| {heading:g} deg | {len(kept)} | {' | '.join(cells)} |")
    return 0


def evidence(labelled: LabelledRun, model: ms.ObservationModel, points: int) -> float:
    """Log evidence of the truth, sampled with so many points about each mode."""
    importance.N_POINTS = points
    importance._standard_points.cache_clear()
    return ms.refine(labelled.run, [labelled.truth], model=model)[0].log_evidence


if __name__ == "__main__":
    sys.exit(main())
