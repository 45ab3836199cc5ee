"""What a scan costs the incremental estimator: against ISAM2, and over a long run.

    python benchmarks/recordings/incremental_cost.py [--output DIR] [--scans N] [--skip-recording]

Two measurements, both to be made on an otherwise idle machine:

- on windows of 100 scans of the DLR recording, time per scan with K hypotheses over the time that
  ISAM2 takes to update the graph of the known association with the same scan, in the same run;
- on round after round in a simulated yard, time per scan and memory over the length of the run.

Rows, summary and figure go to the output folder.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
import time
import tracemalloc
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from drive_sets import MODELS
from matplotlib.figure import Figure

import mht_slam as ms
from mht_slam.datasets import Drive, dlr_drive, windows
from mht_slam.errors import RecordingNotFoundError
from mht_slam.evaluation.known_association import DriveGraph
from mht_slam.simulation import OdometryNoise, simulate_drive

CAMERA, YARD = MODELS["dlr-windows"], MODELS["loop"]
HYPOTHESES = (1, 2, 5, 10, 20)
LEFT_OUT = 20
"""First scans of a window, while it fills, that are not timed."""
SCANS_PER_ROUND = 100
BIN = 100
"""Scans of a point of the figure."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, and write rows, summary and figure."""
    options = _parse(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    lines = []
    if not options.skip_recording:
        try:
            lines += list(_against_isam2(options.output))
        except RecordingNotFoundError as error:
            print(f"incremental_cost: {error}", file=sys.stderr)
            return 2
    lines += list(_long_run(options.output, options.scans))
    (options.output / "summary.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))
    return 0


def seconds_per_scan(drive: Drive, config: ms.SlamConfig) -> list[float]:
    """Return the time of each update."""
    slam = ms.MultiHypothesisSlam(config)
    seconds = []
    for scan in drive.scans:
        start = time.perf_counter()
        slam.update(scan)
        seconds.append(time.perf_counter() - start)
    return seconds


def _against_isam2(output: Path) -> Iterator[str]:
    rows = []
    drives = windows(dlr_drive(), 100)[::4]
    seconds_per_scan(drives[0], ms.SlamConfig(model=CAMERA))  # compiled before it is timed
    for drive in drives:
        graph = DriveGraph(replace(CAMERA, landmark_sigma=30.0))
        for scan, landmarks in zip(drive.scans, drive.truth().landmark_of_detection(), strict=True):
            graph.update(scan, landmarks)
        isam2 = np.median(graph.update_seconds[LEFT_OUT:])
        for count in HYPOTHESES:
            config = ms.SlamConfig(model=CAMERA, hypotheses=count)
            ours = np.median(seconds_per_scan(drive, config)[LEFT_OUT:])
            rows.append((drive.name, count, isam2, ours, ours / isam2))
    with (output / "against_isam2.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["drive", "hypotheses", "isam2_seconds", "seconds", "ratio"])
        table.writerows(rows)
    yield "| hypotheses K | time per scan / ISAM2 update, median of windows | per hypothesis |"
    yield "|---|---|---|"
    for count in HYPOTHESES:
        ratios = [row[4] for row in rows if row[1] == count]
        ratio = float(np.median(ratios))
        between = f"{min(ratios):.1f} to {max(ratios):.1f}"
        yield f"| {count} | {ratio:.1f} ({between}) | {ratio / count:.1f} |"
    yield ""


def _long_run(output: Path, n_scans: int) -> Iterator[str]:
    drive = simulate_drive(
        "loop",
        30,
        n_scans,
        np.random.default_rng(0),
        sigma=YARD.sigma,
        odometry=OdometryNoise(),
        rounds=max(1.0, n_scans / SCANS_PER_ROUND),
    )
    config = ms.SlamConfig(model=YARD)
    seconds = seconds_per_scan(drive, config)
    held, landmarks = [], []
    slam = ms.MultiHypothesisSlam(config)
    tracemalloc.start()  # in a run of its own: it slows what it watches
    for number, scan in enumerate(drive.scans, start=1):
        slam.update(scan)
        if number % BIN == 0:
            log = sum(map(sys.getsizeof, slam.log_entries()))
            held.append(tracemalloc.get_traced_memory()[0] - log)
            landmarks.append(len(slam.committed.ids))
    tracemalloc.stop()
    quarter = len(seconds) // 4
    ratio = float(np.median(seconds[-quarter:]) / np.median(seconds[:quarter]))
    growth = held[-1] / held[len(held) // 4] if len(held) > 3 else math.nan
    (output / "long_run.json").write_text(
        json.dumps({"seconds": seconds, "bytes": held, "landmarks": landmarks}), encoding="utf-8"
    )
    _figure(seconds, held, ratio, growth).savefig(output / "long_run.png", dpi=150)
    yield f"Run of {n_scans} scans, {n_scans / SCANS_PER_ROUND:.0f} rounds: time per scan, last"
    yield f"over first quarter {ratio:.2f}; memory without the log, end over first quarter's end"
    yield f"{growth:.2f}; landmarks in the map {landmarks[-1] if landmarks else 0} (30 are there)."


def _figure(seconds: list[float], held: list[float], ratio: float, growth: float) -> Figure:
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    parts = np.array(seconds[: len(seconds) // BIN * BIN]).reshape(-1, BIN)
    at = BIN * (np.arange(len(parts)) + 0.5)
    first = float(np.median(parts[: max(1, len(parts) // 4)]))
    low, middle, high = np.quantile(parts, [0.1, 0.5, 0.9], axis=1) / first
    upper.fill_between(at, low, high, color="0.85", label="80 % of scans")
    upper.plot(at, middle, color="black", label="median")
    upper.set_ylabel("time per scan\n(first quarter's median = 1)")
    upper.set_ylim(bottom=0.0)
    upper.legend(loc="upper left", ncols=2)
    lower.plot(BIN * np.arange(1, len(held) + 1), np.array(held) / 2**20, color="black")
    lower.set_ylabel("memory without the log, MiB")
    lower.set_ylim(bottom=0.0)
    lower.set_xlabel("scans")
    figure.suptitle(
        f"{len(seconds)} scans: time per scan in the last quarter is {ratio:.2f} of the first's,\n"
        f"memory at the end {growth:.2f} of that at the end of the first quarter"
    )
    return figure


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--output", type=Path, default=Path("runs/incremental-cost"))
    parser.add_argument("--scans", type=int, default=5000, help="length of the long run")
    parser.add_argument("--skip-recording", action="store_true", help="the long run alone")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
