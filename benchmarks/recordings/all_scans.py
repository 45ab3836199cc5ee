"""All scans of real runs: the estimator, trivial baselines and ceilings on two recordings.

    python benchmarks/recordings/all_scans.py [--output DIR] [--workers N] [--half HALF]
        [--set SET ...] [--limit N] [--without-estimate]

The sets: DLR strict (all scans of a nearly straight segment, detections of the landmarks labelled
in all of them), DLR relaxed (all detections, with misses and false alarms), the same cut to at most
twelve scans, and the straight windows of Victoria Park (all detections). Runs at even places of a
recording's table tune options and models, those at odd places are scored. Baselines and ceilings
get the options of the greatest pooled F1 on the tuning half. An answer is exact when it has all the
same-landmark pairs of the truth and no other, and forgiven when it has after exchanges of landmarks
that a scan sees less than 1 deg apart.

The estimator's answers are kept, a line each, in answers.jsonl; a second call does only what is
missing there for the same code and model. A run on which it fails counts as wrong, with no pair.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from all_scans_summary import Row, draw, summarise
from contenders import (
    BASELINE_CODE,
    ESTIMATOR,
    ESTIMATOR_CODE,
    HALVES,
    MODELS,
    READERS,
    Contender,
    Explanation,
    code_version,
    entrants,
    estimate,
    explain,
    f1_on,
    read_halves,
)
from rich.console import Console
from rich.progress import track

import mht_slam as ms
from mht_slam.datasets import LabelledRun
from mht_slam.errors import MhtSlamError
from mht_slam.evaluation.agreement import PairCounts, exact_up_to_exchanges, pair_counts
from mht_slam.evaluation.baselines import order_changes

FORGIVEN_WITHIN = np.deg2rad(1.0)


@dataclass(frozen=True)
class Answers:
    """What the estimator said of one run: a line of answers.jsonl.

    `answers` has table and probability of each association; `error` what it raised, or None.
    """

    set_name: str
    run: str
    code: str
    model: str
    seconds: float
    error: str | None
    answers: list[tuple[list[list[int]], float]]
    explanation: dict[str, Any]

    @property
    def key(self) -> tuple[str, ...]:
        """What they answer, and who."""
        return self.set_name, self.run, self.code, self.model


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is missing, and write rows, sweep, summary and figure."""
    options = _parse(arguments)
    console = Console(stderr=True)
    try:
        sets = {name: read_halves(name) for name in options.set}
    except MhtSlamError as error:
        print(f"all_scans: {error}", file=sys.stderr)
        return 2
    options.output.mkdir(parents=True, exist_ok=True)
    wanted = HALVES if options.half == "both" else (options.half,)
    rows: list[Row] = []
    with ProcessPoolExecutor(options.workers) as pool:
        chosen = tuned(sets, pool, console, options.output / "sweep.csv")
        runs = {
            (name, half): halves[half][: options.limit]
            for name, halves in sets.items()
            for half in wanted
        }
        for (name, half), members in runs.items():
            for contender in chosen[name]:
                rows += [baseline_row(name, half, contender, member) for member in members]
        if not options.without_estimate:
            path = options.output / "answers.jsonl"
            rows += estimator_rows(runs, path, pool, console)
    write_table(options.output / "rows.csv", [asdict(row) for row in rows])
    lines = list(summarise(rows, {name: MODELS[name].describe() for name in sets}))
    (options.output / "summary.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    draw(rows).savefig(options.output / "all_scans.png", dpi=150)
    print("\n".join(lines))
    print(f"\nrows, sweep, summary and figure in {options.output}")
    return 0


def tuned(
    sets: dict[str, dict[str, list[LabelledRun]]], pool: Executor, console: Console, path: Path
) -> dict[str, list[Contender]]:
    """For each set every baseline and ceiling with its best options on the whole tuning half."""
    code = code_version(BASELINE_CODE, Contender)
    known = read_sweep(path, code)
    jobs = [(name, contender) for name in sets for contender in entrants(name)]
    missing = [(n, c) for n, c in jobs if (n, c.method, c.options) not in known]
    figures = pool.map(f1_on, [(c, sets[n]["tuning"]) for n, c in missing], chunksize=4)
    counted = track(figures, "tuning baselines", total=len(missing), console=console)
    known |= {(n, c.method, c.options): f1 for (n, c), f1 in zip(missing, counted, strict=True)}
    scores = {(n, c): known[n, c.method, c.options] for n, c in jobs}
    write_table(
        path,
        [
            {"code": code, "set": name, "method": c.method, "options": c.options, "tuning_f1": f1}
            for (name, c), f1 in scores.items()
        ],
    )
    best: dict[tuple[str, str], tuple[float, Contender]] = {}
    for (name, contender), f1 in scores.items():
        if f1 > best.get((name, contender.method), (-1.0, contender))[0]:
            best[name, contender.method] = f1, contender
    return {
        name: [contender for (of_set, _), (_, contender) in best.items() if of_set == name]
        for name in sets
    }


def read_sweep(path: Path, code: str) -> dict[tuple[str, str, str], float]:
    """Read the sweep of an earlier call of the same code; empty where there is none."""
    if not path.exists():
        return {}
    with path.open(newline="", encoding="utf-8") as file:
        return {
            (row["set"], row["method"], row["options"]): float(row["tuning_f1"])
            for row in csv.DictReader(file)
            if row.get("code") == code
        }


def baseline_row(set_name: str, half: str, contender: Contender, labelled: LabelledRun) -> Row:
    """One baseline or ceiling on one run."""
    start = time.perf_counter()
    answer = contender.associate(labelled)
    seconds = time.perf_counter() - start
    return scored_row(
        set_name, half, labelled, contender.method, contender.options, answer, seconds=seconds
    )


def estimator_rows(
    runs: dict[tuple[str, str], list[LabelledRun]], path: Path, pool: Executor, console: Console
) -> list[Row]:
    """Answers of the estimator, those known and those that are missing."""
    code = code_version(ESTIMATOR_CODE, estimate, explain)
    known = {answers.key: answers for answers in read_answers(path)}
    jobs = [
        (set_name, labelled, code)
        for (set_name, _), members in runs.items()
        for labelled in members
        if (set_name, labelled.name, code, MODELS[set_name].describe()) not in known
    ]
    futures = [pool.submit(answer_run, job) for job in jobs]
    for future in track(as_completed(futures), "runs", total=len(jobs), console=console):
        answers = future.result()
        known[answers.key] = answers
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(answers)) + "\n")
    return [
        answered_row(half, labelled, known[set_name, labelled.name, code, model])
        for (set_name, half), members in runs.items()
        for model in [MODELS[set_name].describe()]
        for labelled in members
    ]


def answer_run(job: tuple[str, LabelledRun, str]) -> Answers:
    """Let the estimator answer one run; whatever it raises is its answer."""
    set_name, labelled, code = job
    model = MODELS[set_name]
    start = time.perf_counter()
    error, answers = None, []
    try:
        answers = estimate(labelled.run, model)
        if any(a.n_detections != labelled.run.n_detections for a, _ in answers):
            error, answers = "answers of other scans", []
        elif not answers:
            error = "no answer"
    except Exception as cause:  # a method that throws has failed the run
        error = f"{type(cause).__name__}: {cause}"
    seconds = time.perf_counter() - start
    explanation = explain(labelled, model, answers)
    return Answers(
        set_name=set_name,
        run=labelled.name,
        code=code,
        model=model.describe(),
        seconds=seconds,
        error=error,
        answers=[(association.table.tolist(), p) for association, p in answers],
        explanation=asdict(explanation),
    )


def read_answers(path: Path) -> Iterator[Answers]:
    """Read the lines that are whole: the last one may have been cut, and is cut off."""
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole, encoding="utf-8")
    names = {field.name for field in fields(Answers)}
    for line in whole.splitlines():
        entry = json.loads(line)
        if set(entry) == names:
            yield Answers(**entry)


def answered_row(half: str, labelled: LabelledRun, said: Answers) -> Row:
    """The estimator's first answer on one run, with its probability and what explains it."""
    first, probability = None, None
    if said.answers:
        table, probability = said.answers[0]
        first = ms.Association(table, labelled.run.n_detections)
    return scored_row(
        said.set_name,
        half,
        labelled,
        ESTIMATOR,
        "",
        first,
        seconds=said.seconds,
        top_probability=probability,
        explanation=Explanation(**said.explanation),
        error=said.error,
    )


def scored_row(
    set_name: str,
    half: str,
    labelled: LabelledRun,
    method: str,
    options: str,
    answer: ms.Association | None,
    *,
    seconds: float,
    top_probability: float | None = None,
    explanation: Explanation | None = None,
    error: str | None = None,
) -> Row:
    """Hold an answer, or the lack of one, against the truth."""
    truth, run = labelled.truth, labelled.run
    nothing = ms.Association([], run.n_detections)
    said = nothing if answer is None else answer
    why = explanation or Explanation(proposed=False, truth_rank=None)
    return Row(
        set_name=set_name,
        half=half,
        run=labelled.name,
        method=method,
        options=options,
        order_changes=order_changes(run, truth),
        exact=answer is not None and answer.exact(truth),
        forgiven=answer is not None and exact_up_to_exchanges(answer, truth, run, FORGIVEN_WITHIN),
        counts=pair_counts(said, truth),
        counts_labelled=pair_counts(said, truth, count_false=False),
        top_probability=top_probability,
        proposed=None if explanation is None else why.proposed,
        truth_rank=why.truth_rank,
        truth_log_evidence=why.truth_log_evidence,
        best_log_evidence=why.best_log_evidence,
        seconds=seconds,
        error=error,
    )


def write_table(path: Path, entries: Sequence[dict[str, Any]]) -> None:
    """Write one line for each entry; counts become three columns each."""
    flat = [_flat(entry) for entry in entries]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(flat[0]))
        writer.writeheader()
        writer.writerows(flat)


def _flat(entry: dict[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in entry.items():
        if isinstance(value, tuple):
            ending = name.removeprefix("counts")
            flat |= {f"{key}{ending}": v for key, v in PairCounts(*value)._asdict().items()}
        else:
            flat[name] = value
    return flat


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, default=Path("runs/all_scans"))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--half", choices=("both", *HALVES), default="both")
    parser.add_argument("--set", nargs="+", choices=list(READERS), default=list(READERS))
    parser.add_argument("--limit", type=int, help="first N runs of each half only")
    parser.add_argument("--without-estimate", action="store_true", help="baselines and ceilings")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
