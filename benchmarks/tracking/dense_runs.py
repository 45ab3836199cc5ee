"""Dense simulated runs: who keeps identities best, over steps, landmarks, noise, paths and worlds.

    python benchmarks/tracking/dense_runs.py [--output DIR] [--workers N] [--runs N]
        [--world WORLD ...] [--path PATH ...] [--base]

Every row of the study varies one thing about a base setting: .1 m a scan, 10 landmarks, .5 deg;
always 100 scans, 5 % misses and 3 % false alarms. Trivial trackers get the gate and gap of the
greatest pooled IDF1 on tuning runs of the very row; the tracker has one set of options for all rows
and knows the noise. Tracks of fewer than three detections are dropped, for all alike. The ceiling
assigns detections given the true poses and landmarks. Finished rows are kept in rows.csv; a second
call does only what is missing there for the same code.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import sys
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from contenders import (
    BASELINES,
    CEILING,
    CONFIRM,
    PAPER,
    TRACKER,
    Contender,
    given_truth,
    trivial_trackers,
)
from dense_scenes import (
    DETECTION_PROBABILITY,
    FALSE_SHARE,
    PATHS,
    WORLDS,
    Setting,
    dense_scene,
)
from rich.console import Console
from rich.progress import track

import mht_slam as ms
from mht_slam.evaluation.significance import paired_bootstrap
from mht_slam.evaluation.tracks import TrackCounts, pooled_tracks, track_counts
from mht_slam.simulation import Scene

N_TUNING = 4
STEPS, LANDMARKS, SIGMAS_DEG = (0.05, 0.1, 0.2, 0.3), (3, 5, 10, 20, 30), (0.25, 0.5, 1.0)
BASE = Setting("yard", "straight", step=0.1, n_landmarks=10, sigma_deg=0.5)
COLUMNS = ("code", "setting", "run", "method", "options", *TrackCounts._fields)
CODE = (
    "mht_slam/tracking",
    "mht_slam/matchings.py",
    "mht_slam/evaluation/tracks.py",
    "mht_slam/evaluation/trackers.py",
    "benchmarks/tracking/contenders.py",
    "benchmarks/tracking/dense_runs.py",
    "benchmarks/tracking/dense_scenes.py",
)

Row = dict[str, str]


def settings() -> Iterator[Setting]:
    """Yield the rows of the study."""
    for world in WORLDS:
        for path in PATHS:
            base = replace(BASE, world=world, path=path)
            yield base
            yield from (replace(base, step=step) for step in STEPS if step != base.step)
            yield from (replace(base, n_landmarks=n) for n in LANDMARKS if n != base.n_landmarks)
            yield from (replace(base, sigma_deg=s) for s in SIGMAS_DEG if s != base.sigma_deg)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is missing and write rows and summary."""
    options = _parse(arguments)
    options.output.mkdir(parents=True, exist_ok=True)
    path, code = options.output / "rows.csv", code_version()
    wanted = [
        setting
        for setting in settings()
        if setting.world in options.world
        and setting.path in options.path
        and not (options.base and setting != replace(BASE, world=setting.world, path=setting.path))
    ]
    known = [row for row in read_rows(path) if row["code"] == code]
    done = {(row["setting"], row["run"]) for row in known}
    missing = [s for s in wanted if any((s.name, f"{r}") not in done for r in range(options.runs))]
    if not known and path.exists():
        path.replace(path.with_suffix(".old.csv"))
    with ProcessPoolExecutor(options.workers) as pool:
        jobs = [(setting, options.runs, code) for setting in missing]
        counted = track(
            pool.map(answer, jobs), "rows", total=len(jobs), console=Console(stderr=True)
        )
        for rows in counted:
            append_rows(path, rows)
    names = [setting.name for setting in wanted]
    rows = [row for row in read_rows(path) if row["code"] == code and row["setting"] in names]
    lines = list(summarise(rows, names, options.runs))
    (options.output / "summary.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))
    return 0


def answer(job: tuple[Setting, int, str]) -> list[Row]:
    """Let all contenders answer all runs of one setting."""
    setting, n_runs, code = job
    config = ms.TrackerConfig(sigma=float(np.deg2rad(setting.sigma_deg)))
    field = [Contender(TRACKER), Contender(PAPER), *tuned(setting, config)]
    rows: list[Row] = []
    for run in range(n_runs):
        scene = scene_of(setting, run, tuning=False)
        answers = [(c.method, _options(c), answered(c, scene, config)) for c in field]
        ceiling = given_truth(
            scene.scans,
            scene.poses,
            scene.landmarks,
            sigma=config.sigma,
            detection_probability=DETECTION_PROBABILITY,
            false_alarm_rate=FALSE_SHARE * setting.n_landmarks / (2.0 * np.pi),
        )
        answers.append((CEILING, "", ceiling))
        for method, words, association in answers:
            counts = track_counts(association, scene.truth, shortest=CONFIRM)
            values = (code, setting.name, run, method, words, *counts)
            rows.append(dict(zip(COLUMNS, map(str, values), strict=True)))
    return rows


def tuned(setting: Setting, config: ms.TrackerConfig) -> list[Contender]:
    """Every trivial tracker with its best options on the setting's tuning runs."""
    scenes = [scene_of(setting, run, tuning=True) for run in range(N_TUNING)]
    best: dict[str, tuple[float, Contender]] = {}
    for contender in trivial_trackers():
        counts = [
            track_counts(answered(contender, scene, config), scene.truth, shortest=CONFIRM)
            for scene in scenes
        ]
        idf1 = pooled_tracks(counts).idf1
        if idf1 > best.get(contender.method, (-1.0, contender))[0]:
            best[contender.method] = idf1, contender
    return [contender for _, contender in best.values()]


def answered(contender: Contender, scene: Scene, config: ms.TrackerConfig) -> ms.Association:
    """Return a contender's association of a scene."""
    mode = "paper" if contender.method == PAPER else "general"
    return contender.associate(scene.scans, replace(config, mode=mode))


def scene_of(setting: Setting, run: int, *, tuning: bool) -> Scene:
    """Return a run of a setting; tuning and scored runs share no seed."""
    seed = [zlib.crc32(setting.name.encode()), int(tuning), run]
    return dense_scene(setting, np.random.default_rng(seed))


def summarise(rows: Sequence[Row], names: Sequence[str], n_runs: int) -> Iterator[str]:
    """Yield the table: pooled IDF1, switches a run, and the tracker against the best baseline."""
    methods = (TRACKER, *BASELINES, CEILING)
    counts: dict[tuple[str, str], list[TrackCounts]] = {}
    for row in sorted(rows, key=lambda row: int(row["run"])):
        if int(row["run"]) < n_runs:
            values = TrackCounts(*(int(row[name]) for name in TrackCounts._fields))
            counts.setdefault((row["setting"], row["method"]), []).append(values)
    yield f"IDF1 / identity switches a run, {n_runs} runs of 100 scans a row."
    yield ""
    yield f"| setting | {' | '.join(methods)} | tracker minus best baseline |"
    yield "|---" * (len(methods) + 2) + "|"
    worse = 0
    for name in names:
        pooled = {method: pooled_tracks(counts[name, method]) for method in methods}
        cells = [f"{c.idf1:.3f} / {c.switches / n_runs:.1f}" for c in pooled.values()]
        gaps = {}
        for method in BASELINES:
            ours, theirs = ([c.idf1 for c in counts[name, m]] for m in (TRACKER, method))
            gaps[method] = paired_bootstrap(ours, theirs, rng=np.random.default_rng(0))
        worse += any(gap.high < 0.0 for gap in gaps.values())
        best = gaps[max(BASELINES, key=lambda method: pooled[method].idf1)]
        gap = f"{best.estimate:+.3f} [{best.low:+.3f}, {best.high:+.3f}]"
        yield f"| {name} | {' | '.join(cells)} | {gap} |"
    yield ""
    yield (
        f"Rows in which the tracker is significantly worse than a baseline (95 % paired "
        f"bootstrap of IDF1 a run): {worse} of {len(names)}."
    )


def code_version() -> str:
    """Short digest of the sources that answers rest on."""
    root = Path(__file__).parents[2]
    digest = hashlib.sha256()
    for place in CODE:
        found = root / place
        for source in sorted(found.rglob("*.py")) if found.is_dir() else [found]:
            digest.update(source.read_bytes())
    return digest.hexdigest()[:12]


def read_rows(path: Path) -> list[Row]:
    """Read the rows that are whole; empty where there is no file."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [row for row in csv.DictReader(file) if None not in row.values()]


def append_rows(path: Path, rows: Sequence[Row]) -> None:
    """Add the rows of one setting."""
    new = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS)
        if new:
            writer.writeheader()
        writer.writerows(rows)


def _options(contender: Contender) -> str:
    if contender.gate_deg is None:
        return ""
    return f"gate {contender.gate_deg:g} deg, max_gap {contender.max_gap}"


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, default=Path("runs/dense_runs"))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--runs", type=int, default=10, help="scored runs of each row")
    parser.add_argument("--world", nargs="+", choices=WORLDS, default=list(WORLDS))
    parser.add_argument("--path", nargs="+", choices=PATHS, default=list(PATHS))
    parser.add_argument("--base", action="store_true", help="the base settings alone")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
