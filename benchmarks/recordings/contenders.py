"""What the study of all scans compares: sets of runs, baselines, ceilings, and the estimator."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import mht_slam as ms
from mht_slam.datasets import (
    LabelledRun,
    all_scan_runs,
    read_dlr,
    read_victoria_park,
    relaxed_runs,
    straight_window_runs,
)
from mht_slam.errors import MhtSlamError
from mht_slam.evaluation.agreement import pair_counts, pooled
from mht_slam.evaluation.baselines import nearest_bearing, order_keeping
from mht_slam.evaluation.ceilings import assignment_given_truth, seen_span
from mht_slam.evaluation.splits import halves
from mht_slam.evaluation.trackers import nearest_bearing_tracker, order_keeping_tracker

STRICT, RELAXED, SHORT = "dlr-strict", "dlr-relaxed", "dlr-relaxed-12"
PARK = "victoria-park"
READERS: dict[str, Callable[[], list[LabelledRun]]] = {
    STRICT: lambda: all_scan_runs(read_dlr()),
    RELAXED: lambda: relaxed_runs(read_dlr()),
    SHORT: lambda: relaxed_runs(read_dlr(), kind="relaxed_le12scans"),
    PARK: lambda: straight_window_runs(read_victoria_park()),
}
"""The sets, and how their runs are read."""
HALVES = ("tuning", "scored")

MODELS = {
    STRICT: ms.ObservationModel(
        sigma=np.deg2rad(0.35),
        bearing_dof=4.0,
        motion="smooth",
        turn_sigma=np.deg2rad(3.0),
        drift_sigma=np.deg2rad(6.0),
        step_change_sigma=0.15,
        landmark_sigma=20.0,
    ),
    RELAXED: ms.presets.forward_camera(),
    SHORT: ms.presets.forward_camera(),
    PARK: ms.presets.laser(),
}
"""What the estimator assumes of each set, from the tuning halves only.

Most are presets, which say where their numbers come from. `STRICT` has no detections to leave out,
hence the heavier noise of the recording's description; of three such models it did best on the
tuning half, by one run.
"""
ESTIMATOR_CODE = (
    "mht_slam.models",
    "mht_slam.pipeline",
    "mht_slam.tree",
    "mht_slam.graph",
    "mht_slam.evidence",
    "mht_slam.factors",
)
BASELINE_CODE = ("mht_slam.datasets", "mht_slam.evaluation")
"""What answers and baselines rest on: figures of different code do not mix."""
N_ANSWERS = 50
"""Answers of the estimator that are kept for each run."""

ORDER_KEEPING = "order-keeping"
ORDER_TRACKER, BEARING_TRACKER = "order-keeping tracker", "nearest-bearing tracker"
ESTIMATOR = "all scans, evidence"
CEILING, CEILING_IN_VIEW = "given truth", "given truth and view"
CEILING_SIGMA = np.deg2rad(0.5)
CEILING_GATES = (3.0, 6.0, 10.0)
GATES_DEG = (2.0, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0)
MAX_GAPS = (0, 1, 2, 4, 8)


@dataclass(frozen=True)
class Contender:
    """A method with its options; trackers and ceilings have several, of which tuning picks one."""

    method: str
    gate: float | None = None
    max_gap: int | None = None
    with_rate: bool | None = None

    @property
    def options(self) -> str:
        """Return them in words, gates of trackers in degrees and of ceilings in sigmas."""
        unit = " sigma" if self.method in (CEILING, CEILING_IN_VIEW) else " deg"
        words = [] if self.gate is None else [f"gate {self.gate:g}{unit}"]
        words += [] if self.max_gap is None else [f"max_gap {self.max_gap}"]
        words += [] if self.with_rate is None else ["with rate" if self.with_rate else "no rate"]
        return ", ".join(words)

    def associate(self, labelled: LabelledRun) -> ms.Association:
        """Return the method's association of a run; only ceilings look at more than the run."""
        run, rate = labelled.run, bool(self.with_rate)
        if self.method == ORDER_KEEPING:
            return order_keeping(run)
        if self.method == "nearest bearing":
            return nearest_bearing(run, with_rate=rate)
        gate, max_gap = self.gate or 0.0, self.max_gap or 0
        if self.method == BEARING_TRACKER:
            return nearest_bearing_tracker(run, np.deg2rad(gate), max_gap, with_rate=rate)
        if self.method == ORDER_TRACKER:
            return order_keeping_tracker(run, np.deg2rad(gate), max_gap, with_rate=rate)
        return assignment_given_truth(
            run,
            labelled.reference_poses,
            labelled.reference_landmarks,
            CEILING_SIGMA,
            gate,
            in_view=seen_span(labelled.truth) if self.method == CEILING_IN_VIEW else None,
        )


def read_halves(set_name: str) -> dict[str, list[LabelledRun]]:
    """Return the two halves of a set, by name."""
    return dict(zip(HALVES, halves(READERS[set_name]()), strict=True))


def entrants(set_name: str) -> Iterator[Contender]:
    """Yield every baseline and ceiling of a set, with all the options that tuning chooses from."""
    if set_name == STRICT:  # every landmark in every scan: full tables are the best reading
        yield Contender(ORDER_KEEPING)
        for rate in (False, True):
            yield Contender("nearest bearing", with_rate=rate)
    else:
        for method in (ORDER_TRACKER, BEARING_TRACKER):
            for gate in GATES_DEG:
                for max_gap in MAX_GAPS:
                    for rate in (False, True):
                        yield Contender(method, gate, max_gap, rate)
    for method in (CEILING, CEILING_IN_VIEW):
        if method == CEILING or set_name != STRICT:  # there, everything is in view
            for gate in CEILING_GATES:
                yield Contender(method, gate)


def f1_on(job: tuple[Contender, Sequence[LabelledRun]]) -> float:
    """Pooled F1 of a contender over some runs: what tuning maximises."""
    contender, runs = job
    return pooled(pair_counts(contender.associate(run), run.truth) for run in runs).f1


def estimate(run: ms.StraightRun, model: ms.ObservationModel) -> list[tuple[ms.Association, float]]:
    """Return the estimator's associations of all scans with probabilities, the likeliest first."""
    posterior = ms.solve(run, epsilon=3.0 * model.sigma, model=model).posterior
    return [(h.association, h.probability) for h in posterior if h.failure is None][:N_ANSWERS]


@dataclass(frozen=True)
class Explanation:
    """Why an answer is wrong: the truth was never proposed, or it scored lower.

    Attributes
    ----------
    proposed : whether the truth is among the answers.
    truth_rank : its rank among them, from 1; None where it is not.
    truth_log_evidence, best_log_evidence : of the truth and of the first answer under the model;
        None where not computed.
    """

    proposed: bool
    truth_rank: int | None
    truth_log_evidence: float | None = None
    best_log_evidence: float | None = None


def explain(
    labelled: LabelledRun,
    model: ms.ObservationModel,
    answers: Sequence[tuple[ms.Association, float]],
) -> Explanation:
    """Compare the truth with the first answer of the estimator, under its own model."""
    ranks = (k for k, (a, _) in enumerate(answers, start=1) if a.exact(labelled.truth))
    rank = next(ranks, None)
    if rank == 1 or not answers:
        return Explanation(proposed=rank is not None, truth_rank=rank)
    best, truth = answers[0][0], labelled.truth
    try:
        posterior = ms.refine(labelled.run, [best, truth], model=model)
    except MhtSlamError:
        return Explanation(proposed=rank is not None, truth_rank=rank)
    evidence = {h.association: h.log_evidence for h in posterior if h.failure is None}
    return Explanation(rank is not None, rank, evidence.get(truth), evidence.get(best))


def code_version(modules: Iterable[str], *definitions: Callable[..., object]) -> str:
    """Short digest of the sources of modules or packages, and of these functions or classes."""
    digest = hashlib.sha256("".join(map(inspect.getsource, definitions)).encode())
    for name in modules:
        spec = find_spec(name)
        if spec is None or spec.origin is None:
            continue
        origin = Path(spec.origin)
        package = origin.name == "__init__.py"
        for source in sorted(origin.parent.glob("*.py")) if package else [origin]:
            digest.update(source.read_bytes())
    return digest.hexdigest()[:8]
