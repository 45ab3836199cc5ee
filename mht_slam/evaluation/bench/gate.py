"""The regression gate: key figures of a comparison held against a committed baseline."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, TypeAlias, get_args

import numpy as np

from mht_slam.arrays import finite_number, one_of
from mht_slam.errors import OptionError
from mht_slam.evaluation.bench.jobs import CANDIDATES
from mht_slam.evaluation.bench.methods import GRAPH_EVIDENCE
from mht_slam.evaluation.bench.summary import Summary

Direction: TypeAlias = Literal["higher", "lower"]

RATE_TOLERANCE = 0.05
"""Of shares and means in [0, 1]."""
SCORE_TOLERANCE = 0.1
"""Of the log score, nats, and of the map error, baselines."""
TIME_TOLERANCE = 1.0
"""Of times as multiples of another method's, relative: twice as slow is worse."""
TIMED_AGAINST = "smallest epsilon"
TIMED = (CANDIDATES, GRAPH_EVIDENCE, "quadrature evidence")
"""What takes long enough for its time to be worth holding."""


@dataclass(frozen=True)
class KeyFigure:
    """A figure that must not get worse.

    Attributes
    ----------
    value : as it was measured.
    better : which direction is better.
    tolerance : how much worse it may be, in the figure's own unit.
    """

    value: float
    better: Direction
    tolerance: float

    def __post_init__(self) -> None:
        finite_number(self.value, "value")
        one_of(self.better, "better", get_args(Direction))
        finite_number(self.tolerance, "tolerance", at_least=0.0)


def key_figures(summary: Summary) -> dict[str, KeyFigure]:
    """Return the key figures of every method over all cells, by a name that says which.

    Times are medians as multiples of the median of `TIMED_AGAINST` in the same comparison.
    """
    found: dict[str, KeyFigure] = {}
    for row in summary.overall:
        found[f"{row.method}: exact"] = KeyFigure(row.exact.estimate, "higher", RATE_TOLERANCE)
        found[f"{row.method}: F1"] = KeyFigure(row.f1, "higher", RATE_TOLERANCE)
        found[f"{row.method}: failures"] = KeyFigure(float(row.failures), "lower", 0.0)
        if row.log_score is not None:
            name = f"{row.method}: log score"
            found[name] = KeyFigure(row.log_score, "higher", SCORE_TOLERANCE)
        if row.map_error is not None:
            name = f"{row.method}: map error"
            found[name] = KeyFigure(row.map_error.estimate, "lower", SCORE_TOLERANCE)
    return {**found, **_time_ratios(summary)}


def worse_figures(now: Mapping[str, KeyFigure], baseline: Mapping[str, KeyFigure]) -> list[str]:
    """Say, one line each, which figures of the baseline are worse now, or gone."""
    complaints = []
    for name, was in baseline.items():
        if name not in now:
            complaints.append(f"{name}: was {was.value:.4g} and is gone")
            continue
        change = now[name].value - was.value
        loss = -change if was.better == "higher" else change
        if loss > was.tolerance:
            complaints.append(
                f"{name}: was {was.value:.4g} and is {now[name].value:.4g}, {was.better} is "
                f"better, tolerance {was.tolerance:.3g}"
            )
    return complaints


def read_baseline(path: Path) -> dict[str, KeyFigure]:
    """Read a baseline; raises `OptionError` where the file is none, or holds no figure."""
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
        figures = {name: KeyFigure(**entry) for name, entry in entries.items()}
    except (ValueError, TypeError, AttributeError) as cause:
        raise OptionError(f"{path} is no baseline of key figures: {cause}") from cause
    if not figures:
        raise OptionError(f"{path} holds no key figure: a gate without figures holds nothing")
    return figures


def write_baseline(path: Path, figures: Mapping[str, KeyFigure]) -> None:
    """Write a baseline, one figure a line, with as many digits as matter."""
    lines = []
    for name, figure in sorted(figures.items()):
        entry = asdict(figure)
        entry |= {key: float(f"{entry[key]:.6g}") for key in ("value", "tolerance")}
        lines.append(f"  {json.dumps(name)}: {json.dumps(entry)}")
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def _time_ratios(summary: Summary) -> dict[str, KeyFigure]:
    taken: dict[str, list[float]] = {}
    for times in summary.outcome.times:
        for method, seconds in times.seconds.items():
            taken.setdefault(method, []).append(seconds)
    if TIMED_AGAINST not in taken:
        return {}
    against = _median(taken[TIMED_AGAINST])
    ratios = {name: _median(taken[name]) / against for name in TIMED if name in taken}
    return {
        f"{name}: time, multiples of {TIMED_AGAINST}": KeyFigure(
            ratio, "lower", TIME_TOLERANCE * ratio
        )
        for name, ratio in ratios.items()
    }


def _median(seconds: Sequence[float]) -> float:
    return float(np.median(seconds))
