"""Real runs: the order tracker beside trivial trackers on DLR segments and Victoria Park windows.

    python benchmarks/tracking/recordings.py [--output DIR] [--workers N] [--set SET ...]

Runs at even places of a recording's table tune options, those at odd places are scored. Trivial
trackers get the gate and gap of the greatest pooled F1 on the tuning half; the tracker, in both
modes, goes once through its options one after the other from its defaults, and also stands there
untuned. F1 is over pairs of detections of one landmark, pooled over the runs; the interval of a
difference is a paired bootstrap over the runs.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from contenders import BASELINES, HUNGARIAN, PAPER, TRACKER, Contender, trivial_trackers

import mht_slam as ms
from mht_slam.datasets import (
    LabelledRun,
    read_dlr,
    read_victoria_park,
    relaxed_runs,
    straight_window_runs,
)
from mht_slam.errors import MhtSlamError
from mht_slam.evaluation.agreement import PairCounts, pair_counts, pooled, pooled_f1_difference
from mht_slam.evaluation.splits import halves

READERS: dict[str, Callable[[], list[LabelledRun]]] = {
    "dlr-relaxed": lambda: relaxed_runs(read_dlr()),
    "victoria-park": lambda: straight_window_runs(read_victoria_park()),
}
UNTUNED = f"{TRACKER}, untuned"
METHODS = (TRACKER, UNTUNED, *BASELINES)

DEFAULTS = ms.TrackerConfig(confirm=2)
"""A pair of detections is all that this F1 looks at."""
CHOICES: dict[str, tuple[float, ...]] = {
    "sigma": (np.deg2rad(0.25), np.deg2rad(0.5), np.deg2rad(1.0)),
    "detection_probability": (0.8, 0.9, 0.95),
    "stay_probability": (0.95, 0.98, 0.998),
    "false_alarm_rate": (0.02, 0.05, 0.15),
    "nearness": (0.03, 0.1),
    "step_change_sigma": (0.03, 0.1),
    "drift_sigma": (np.deg2rad(2.0), np.deg2rad(5.0)),
}
"""Options that tuning goes through, one after the other."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Tune, score, and write rows and summary."""
    options = _parse(arguments)
    try:
        sets = {name: halves(READERS[name]()) for name in options.set}
    except MhtSlamError as error:
        print(f"recordings: {error}", file=sys.stderr)
        return 2
    options.output.mkdir(parents=True, exist_ok=True)
    lines: list[str] = []
    rows: list[dict[str, object]] = []
    with ProcessPoolExecutor(options.workers) as pool:
        for name, (tuning, scored) in sets.items():
            found: dict[str, list[PairCounts]] = {}
            chosen = dict(tuned(tuning, pool))
            for method, (contender, config) in chosen.items():
                counts = list(pool.map(partial(counted, contender, config), scored))
                found[method] = counts
                words = describe(contender, config)
                rows += [
                    {"set": name, "run": run.name, "method": method, "options": words}
                    | count._asdict()
                    for run, count in zip(scored, counts, strict=True)
                ]
            lines += [*summarise(name, found, chosen, len(tuning)), ""]
    with (options.output / "rows.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    (options.output / "summary.md").write_text("\n".join(lines), encoding="utf-8")
    print("\n".join(lines))
    return 0


def tuned(
    runs: Sequence[LabelledRun], pool: Executor
) -> Iterator[tuple[str, tuple[Contender, ms.TrackerConfig]]]:
    """Yield every method with its options of the greatest pooled F1 on these runs."""
    for method in (TRACKER, PAPER):
        mode = "paper" if method == PAPER else "general"
        contender, config = Contender(method), replace(DEFAULTS, mode=mode)
        if method == TRACKER:
            yield UNTUNED, (contender, config)
        for name, values in CHOICES.items():
            tried = [replace(config, **{name: value}) for value in values]
            config = max(tried, key=lambda c: pooled_f1(contender, c, runs, pool))
        yield method, (contender, config)
    best: dict[str, tuple[float, Contender]] = {}
    for contender in trivial_trackers():
        f1 = pooled_f1(contender, DEFAULTS, runs, pool)
        if f1 > best.get(contender.method, (-1.0, contender))[0]:
            best[contender.method] = f1, contender
    for method, (_, contender) in best.items():
        yield method, (contender, DEFAULTS)


def pooled_f1(
    contender: Contender,
    config: ms.TrackerConfig,
    runs: Sequence[LabelledRun],
    pool: Executor,
) -> float:
    """F1 over all pairs of the runs together."""
    return pooled(pool.map(partial(counted, contender, config), runs, chunksize=4)).f1


def counted(contender: Contender, config: ms.TrackerConfig, run: LabelledRun) -> PairCounts:
    """Pairs that the contender, the truth, and both have."""
    return pair_counts(contender.associate(run.run.scans, config), run.truth)


def summarise(
    name: str,
    found: dict[str, list[PairCounts]],
    chosen: dict[str, tuple[Contender, ms.TrackerConfig]],
    n_tuning: int,
) -> Iterator[str]:
    """Yield the table of one set: pooled F1, precision, recall, and differences of F1."""
    yield f"{name}: {n_tuning} runs for tuning, {len(found[TRACKER])} scored."
    yield ""
    yield "| method | F1 | precision | recall | tracker minus it | options |"
    yield "|---|---|---|---|---|---|"
    for method in METHODS:
        total = pooled(found[method])
        gap = "" if method == TRACKER else _gap(found[TRACKER], found[method])
        precision, recall = total.common / total.answered, total.common / total.true
        figures = f"{total.f1:.3f} | {precision:.3f} | {recall:.3f}"
        yield f"| {method} | {figures} | {gap} | {describe(*chosen[method])} |"


def describe(contender: Contender, config: ms.TrackerConfig) -> str:
    """Write a contender's options in words: of the tracker those that are not the defaults."""
    if contender.gate_deg is not None:
        rate = ", no rate" if contender.method == HUNGARIAN else ""
        return f"gate {contender.gate_deg:g} deg, max_gap {contender.max_gap}{rate}"
    changed = [name for name in CHOICES if getattr(config, name) != getattr(DEFAULTS, name)]
    return ", ".join(f"{name} {getattr(config, name):.3g}" for name in changed)


def _gap(ours: Sequence[PairCounts], theirs: Sequence[PairCounts]) -> str:
    gap = pooled_f1_difference(ours, theirs, rng=np.random.default_rng(0))
    return f"{gap.estimate:+.3f} [{gap.low:+.3f}, {gap.high:+.3f}]"


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, default=Path("runs/tracking_recordings"))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--set", nargs="+", choices=list(READERS), default=list(READERS))
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
