"""Tables of the study of drives."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
from drive_scores import Row
from drive_sets import HALVES

from mht_slam.evaluation.agreement import pooled, pooled_f1_interval
from mht_slam.evaluation.significance import wilson_interval

HEADER = (
    "method",
    "option",
    "drives, failed",
    "F1, pooled",
    "F1 without false pairs",
    "F1, least",
    "position error",
    "within 10 % of known",
    "without scale",
    "heading, deg",
    "landmarks found, split or false",
    "one to one",
    "placed",
    "seconds",
)
INTRODUCTION = """\
F1 over same-landmark pairs of detections, pooled over drives, with 95 % bootstrap intervals
over drives; for a single drive also that of the pairs within its parts, with intervals over the
parts; F1 without the answer's pairs of two unlabelled detections; and that of the worst drive.
Position and heading errors are medians over drives of the root mean square over a drive, after
alignment with scale; then the share of drives within 10 % of the graph of the known
association, with 95 % Wilson interval, and the position error after alignment without scale.
Landmarks of three detections or more: the share of the true ones found, and of the answer's
that are none; the share of drives in which all are partners; the share of those with a position
that are in their place."""
KNOWN = "known association"
SEED = " seed "
"""What the names of simulated drives of one size differ by, and follows."""
WITHIN = 1.1
"""A trajectory error at most this many times that of the known association counts as near it."""


def best_options(rows: Sequence[Row]) -> dict[tuple[str, str], str]:
    """For each set and method the option of the greatest pooled F1 on the tuning half."""
    best: dict[tuple[str, str], tuple[float, str]] = {}
    tuned = [row for row in rows if row.half == "tuning" and not row.part]
    for name, method, option in dict.fromkeys((r.set_name, r.method, r.option) for r in tuned):
        mine = [r for r in tuned if (r.set_name, r.method, r.option) == (name, method, option)]
        f1 = pooled(row.counts for row in mine).f1
        if f1 > best.get((name, method), (-1.0, ""))[0]:
            best[name, method] = f1, option
    return {key: option for key, (_, option) in best.items()}


def summarise(rows: Sequence[Row], models: Mapping[str, str]) -> Iterator[str]:
    """Markdown: a table for each set and half, and the parts of long drives."""
    yield from INTRODUCTION.splitlines()
    best = best_options(rows)
    for name in dict.fromkeys(row.set_name for row in rows):
        for half in HALVES:
            mine = [r for r in rows if (r.set_name, r.half) == (name, half)]
            kept = [r for r in mine if best.get((name, r.method), r.option) == r.option]
            kept = [r for r in kept if not r.error.startswith("not applicable")]
            if kept:
                yield from _table(name, half, kept)
        if name in models:
            yield ""
            yield f"Model: {models[name]}."


def _table(name: str, half: str, rows: Sequence[Row]) -> Iterator[str]:
    whole = [row for row in rows if not row.part]
    yield ""
    yield f"## {name}, {half} half"
    yield ""
    yield "| " + " | ".join(HEADER) + " |"
    yield "|" + " --- |" * len(HEADER)
    known = {row.drive: row.position_sim for row in whole if row.method == KNOWN}
    for method in dict.fromkeys(row.method for row in whole):
        mine = [row for row in whole if row.method == method]
        parts = [row for row in rows if row.method == method and row.part]
        yield "| " + " | ".join((method, *_cells(mine, parts, known))) + " |"
    failed = [row for row in whole if row.error]
    if failed:
        yield ""
        for row in failed[:20]:
            yield f"- {row.method} failed on {row.drive}: {row.error[:200]}"
    yield from _sizes(whole)
    if any(row.part for row in rows):
        yield from _parts(rows)


def _sizes(rows: Sequence[Row]) -> Iterator[str]:
    """Simulated drives size by size, one column a method that associates."""
    sizes = list(dict.fromkeys(row.drive.rpartition(SEED)[0] for row in rows if SEED in row.drive))
    if len(sizes) < 2:
        return
    forms = [row for row in rows if row.answered]
    methods = [m for m in dict.fromkeys(row.method for row in forms) if m != KNOWN]
    yield ""
    yield "Size by size: F1, pooled, and the share of drives in which all landmarks are partners."
    yield ""
    yield "| drives | " + " | ".join(methods) + " |"
    yield "|" + " --- |" * (1 + len(methods))
    for size in sizes:
        cells = []
        for method in methods:
            mine = [r for r in rows if r.method == method and r.drive.startswith(size + SEED)]
            one_to_one = np.mean([row.one_to_one for row in mine])
            cells.append(f"{pooled(row.counts for row in mine).f1:.3f}, {one_to_one:.2f}")
        yield f"| {size} | " + " | ".join(cells) + " |"


def _cells(rows: Sequence[Row], parts: Sequence[Row], known: Mapping[str, float]) -> Iterator[str]:
    yield rows[0].option
    yield f"{len(rows)}, {sum(bool(row.error) for row in rows)}"
    forms = any(row.answered or row.error for row in rows)
    if forms:
        if len(rows) > 1:
            yield _f1(rows)
        else:
            within = f", within parts {_f1(parts)}" if parts else ""
            yield f"{rows[0].counts.f1:.3f}{within}"
        yield f"{pooled(row.counts_labelled for row in rows).f1:.3f}"
        yield f"{min(row.counts.f1 for row in rows):.3f}"
    else:
        yield from ("-", "-", "-")
    yield _median(row.position_sim for row in rows)
    near = [row.position_sim <= WITHIN * known[row.drive] for row in rows if row.drive in known]
    placed = any(math.isfinite(row.position_sim) for row in rows)
    if near and placed:
        rate = wilson_interval(sum(near), len(near))
        yield f"{rate.estimate:.2f} [{rate.low:.2f}, {rate.high:.2f}]"
    else:
        yield "-"
    yield _median(row.position_se for row in rows)
    yield _median((row.heading_deg for row in rows), digits=2)
    if not forms:
        yield from ("-", "-")
    else:
        yield (
            f"{_share(rows, 'matched', 'true_landmarks'):.3f}, "
            f"{1.0 - _share(rows, 'matched', 'confirmed'):.3f}"
        )
        yield f"{np.mean([row.one_to_one for row in rows]):.2f}"
    positioned = any(row.positioned for row in rows)
    yield f"{_share(rows, 'placed', 'positioned'):.3f}" if positioned else "-"
    yield _median((row.seconds for row in rows), digits=2)


def _f1(rows: Sequence[Row]) -> str:
    interval = pooled_f1_interval([row.counts for row in rows], rng=np.random.default_rng(0))
    return f"{interval.estimate:.3f} [{interval.low:.3f}, {interval.high:.3f}]"


def _parts(rows: Sequence[Row]) -> Iterator[str]:
    """A long drive part by part, one column a method."""
    methods = list(dict.fromkeys(row.method for row in rows if row.part))
    yield ""
    yield "Part by part: F1, and position error after its own alignment."
    yield ""
    yield "| drive, scans | " + " | ".join(methods) + " |"
    yield "|" + " --- |" * (1 + len(methods))
    of = {(row.drive, row.part, row.method): row for row in rows if row.part}
    for drive, part in dict.fromkeys((row.drive, row.part) for row in rows if row.part):
        found = [of.get((drive, part, method)) for method in methods]
        cells = [
            "-" if row is None else f"{row.counts.f1:.2f}, {_number(row.position_sim, 3)}"
            for row in found
        ]
        yield f"| {drive} {part} | " + " | ".join(cells) + " |"


def _share(rows: Iterable[Row], part: str, whole: str) -> float:
    listed = list(rows)
    total = sum(getattr(row, whole) for row in listed)
    return sum(getattr(row, part) for row in listed) / total if total else 1.0


def _median(values: Iterable[float], digits: int = 3) -> str:
    known = [value for value in values if math.isfinite(value)]
    return _number(float(np.median(known)) if known else math.nan, digits)


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"
