"""The methods that a comparison knows by name, and how a user's own one is found."""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from scipy.special import softmax

from mht_slam.association import Association
from mht_slam.consistency.tightest import tightest_association
from mht_slam.errors import MhtSlamError, OptionError
from mht_slam.evaluation.baselines import nearest_bearing, order_keeping
from mht_slam.evaluation.bench.case import Assumptions, Case
from mht_slam.evaluation.ceilings import assignment_given_truth
from mht_slam.evaluation.trackers import nearest_bearing_tracker, order_keeping_tracker
from mht_slam.evidence.quadrature import evidence_by_quadrature, rank_by_evidence
from mht_slam.graph.refine import refine
from mht_slam.graph.solve import EvidenceMethod
from mht_slam.hypotheses import Posterior
from mht_slam.measurements import MIN_RUN_SCANS, StraightRun
from mht_slam.pipeline import solve
from mht_slam.polygon.ranking import rank

Answers: TypeAlias = Iterable[tuple[Association, float]]
"""Associations with scores, the larger the better."""
MethodFunction: TypeAlias = Callable[[StraightRun, Assumptions], Answers]

POLYGON_LISTED = 50
"""Hypotheses that a polygon method lists."""
MOST_CANDIDATES = 200
POLYGON_CANDIDATES = 10
"""First ones of the polygon ranking that join the candidates."""
GATE = np.pi / 2.0
"""Radians beyond which a tracker matches nothing: bearings move far between three scans."""
CEILING_GATE = 6.0

ORDER_KEEPING = "order-keeping"
POLYGON = "polygon iou edges"
GRAPH_EVIDENCE = "graph evidence"
KNOWN = "known association"
GIVEN_TRUTH = "assignment given truth"


@dataclass(frozen=True)
class Method:
    """A function from a run, and what may be assumed of it, to scored associations.

    Attributes
    ----------
    function : called as ``function(run, assumptions)``; returns pairs (association, score), the
        larger the better, in any order. Scores from 0 to 1 whose sum is at most 1 are read as
        probabilities, what is missing to 1 being that of "none of these"; any others only order
        the associations. Picklable where workers are other processes.
    three_scans_only, straight_only : whether the method knows no longer runs, or no headings that
        wander. Other cases are not asked of it, and count neither for nor against it.
    weighs_candidates : whether the method looks at the shared candidates; they are found only
        where some method does.
    """

    function: MethodFunction
    three_scans_only: bool = False
    straight_only: bool = False
    weighs_candidates: bool = True

    def takes(self, case: Case) -> bool:
        """Whether the method is asked about this case."""
        if self.three_scans_only and len(case.run) > MIN_RUN_SCANS:
            return False
        model = case.assumptions.model
        strict = model.motion == "straight" and model.heading_sigma == model.lateral_sigma == 0.0
        return strict or not self.straight_only


def known_methods(names: Sequence[str] | None = None) -> dict[str, Method]:
    """Return the named methods of `METHODS`; None means all.

    Raises `OptionError` for a name that is none.
    """
    chosen = list(METHODS) if names is None else list(names)
    unknown = [name for name in chosen if name not in METHODS]
    if unknown:
        raise OptionError(
            f"method is {unknown[0]!r}: give one of {', '.join(METHODS)}, or module:function"
        )
    return {name: METHODS[name] for name in chosen}


def load_method(text: str) -> Method:
    """Return the method that ``module:function`` names, importable from where Python runs.

    What stands there may be a function or a `Method`. Raises `OptionError` where there is none.
    """
    if not re.fullmatch(r"[\w.]+:\w+", text):
        raise OptionError(f"method is {text!r}: give module:function")
    module, name = text.split(":")
    try:
        found = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as cause:
        raise OptionError(f"method is {text!r}: {cause}") from cause
    return as_method(found, text)


def as_method(found: object, name: str) -> Method:
    """Return a function as a `Method`; raises `OptionError` for something else."""
    if isinstance(found, Method):
        return found
    if not callable(found):
        raise OptionError(f"method {name!r} is {type(found).__name__}: give a function")
    return Method(found)


def source_of(method: Method) -> str:
    """Source text of the file that defines a method's function, "" where there is none to read."""
    function: object = method.function
    while isinstance(function, partial):
        function = function.func
    try:
        module = inspect.getmodule(function)
        return inspect.getsource(module if module is not None else function)  # type: ignore[arg-type]
    except (OSError, TypeError):
        return ""


def with_candidates(run: StraightRun, assumptions: Assumptions) -> Assumptions:
    """Add the associations that graphs and quadrature weigh, for a run of three scans.

    They are all associations within e^-40 of the largest exact evidence, at most 200, the first of
    the polygon ranking, and the one that keeps the visual order. Quadrature knows no wandering
    headings: there bearings as uncertain as that makes them find the candidates, and nothing else
    is taken from it. None where all of this fails.
    """
    if len(run) > MIN_RUN_SCANS:
        return assumptions
    model = assumptions.model
    spread = float(np.hypot(model.sigma, assumptions.heading_wander))
    blurred = replace(model, motion="straight", sigma=spread, heading_sigma=0.0, lateral_sigma=0.0)

    def by_evidence() -> list[Association]:
        posterior = rank_by_evidence(
            run,
            model=blurred,
            top_k=MOST_CANDIDATES,
            max_missed=assumptions.max_missed,
            max_false=assumptions.max_false,
        )
        return [h.association for h in posterior]

    def by_polygons() -> list[Association]:
        return [a for a, _ in _polygon(run, assumptions, ratio="iou", region="edges")]

    found = set(_attempt(by_evidence))
    if len(found) < MOST_CANDIDATES:
        found |= set(_attempt(by_polygons)[:POLYGON_CANDIDATES])
        found |= set(_attempt(lambda: [a for a, _ in _kept_order(run, assumptions)]))
    return replace(assumptions, candidates=tuple(sorted(found, key=Association.sort_key)))


def known_association(case: Case) -> Answers:
    """Ceiling of maps: the truth itself."""
    return [(case.truth, 1.0)]


def given_truth(case: Case) -> Answers:
    """Ceiling of associations: assign each scan to the true map from its true pose."""
    sigma = case.assumptions.model.sigma
    return [
        (assignment_given_truth(case.run, case.poses, case.landmarks, sigma, CEILING_GATE), 1.0)
    ]


def _attempt(call: Callable[[], list[Association]]) -> list[Association]:
    try:
        return call()
    except MhtSlamError:
        return []


def _polygon(run: StraightRun, assumptions: Assumptions, *, ratio: str, region: str) -> Answers:
    """Rank by polygons; scores are made to sum to one, so that they can be held to their word."""
    ranking = rank(
        run,
        epsilon=assumptions.enlarged_epsilon,
        top_k=POLYGON_LISTED,
        ratio=ratio,
        region=region,
        max_missed=assumptions.max_missed,
        max_false=assumptions.max_false,
    )
    total = sum(h.score for h in ranking)
    return [(h.association, h.score / total) for h in ranking]


def _polygon_method(ratio: str, region: str) -> Method:
    function = partial(_polygon, ratio=ratio, region=region)
    return Method(function, three_scans_only=True, weighs_candidates=False)


def _graph_likelihood(run: StraightRun, assumptions: Assumptions) -> Answers:
    """Order by the likelihood at each graph's optimum; shares are its softmax."""
    solved = [h for h in _graphs(run, assumptions, "laplace") if h.log_likelihood is not None]
    logs = np.array([h.log_likelihood for h in solved], dtype=np.float64)
    shares = softmax(logs).tolist() if len(logs) else []
    return [(h.association, p) for h, p in zip(solved, shares, strict=True)]


def _graph_evidence(
    run: StraightRun, assumptions: Assumptions, *, evidence: EvidenceMethod
) -> Answers:
    posterior = _graphs(run, assumptions, evidence)
    return [(h.association, h.probability) for h in posterior if h.failure is None]


def _graphs(run: StraightRun, assumptions: Assumptions, evidence: EvidenceMethod) -> Posterior:
    """Refine the candidates; a longer run is solved over all its scans."""
    if len(run) > MIN_RUN_SCANS:
        solution = solve(
            run, epsilon=assumptions.epsilon, model=assumptions.model, evidence=evidence
        )
        return solution.posterior
    return refine(run, assumptions.candidates, model=assumptions.model, evidence=evidence)


def _quadrature(run: StraightRun, assumptions: Assumptions) -> Answers:
    posterior = evidence_by_quadrature(run, assumptions.candidates, model=assumptions.model)
    return [(h.association, h.probability) for h in posterior if h.failure is None]


def _smallest_epsilon(run: StraightRun, assumptions: Assumptions) -> Answers:  # noqa: ARG001
    """Name the association that needs the smallest errors; full tables only."""
    tightest = tightest_association(run)
    return [] if tightest.association is None else [(tightest.association, -tightest.epsilon)]


def _kept_order(run: StraightRun, assumptions: Assumptions) -> Answers:
    if _full(run, assumptions):
        return [(order_keeping(run), 1.0)]
    return [(order_keeping_tracker(run, GATE, len(run)), 1.0)]


def _nearest(run: StraightRun, assumptions: Assumptions) -> Answers:
    if _full(run, assumptions):
        return [(nearest_bearing(run), 1.0)]
    return [(nearest_bearing_tracker(run, GATE, len(run)), 1.0)]


def _full(run: StraightRun, assumptions: Assumptions) -> bool:
    """Whether a full table is wanted, and possible."""
    none_missed = assumptions.max_missed == assumptions.max_false == 0
    return none_missed and len(set(run.n_detections)) == 1


METHODS: Mapping[str, Method] = MappingProxyType(
    {
        POLYGON: _polygon_method("iou", "edges"),
        "polygon overlap edges": _polygon_method("overlap", "edges"),
        "polygon iou vertices": _polygon_method("iou", "vertices"),
        "polygon overlap vertices": _polygon_method("overlap", "vertices"),
        "graph likelihood": Method(_graph_likelihood),
        GRAPH_EVIDENCE: Method(partial(_graph_evidence, evidence="marginal")),
        "graph evidence, Laplace": Method(partial(_graph_evidence, evidence="laplace")),
        "quadrature evidence": Method(_quadrature, three_scans_only=True, straight_only=True),
        "smallest epsilon": Method(_smallest_epsilon, weighs_candidates=False),
        ORDER_KEEPING: Method(_kept_order, weighs_candidates=False),
        "nearest bearing": Method(_nearest, weighs_candidates=False),
    }
)
"""Our methods, the trivial ones last."""

CEILINGS: Mapping[str, Callable[[Case], Answers]] = MappingProxyType(
    {GIVEN_TRUTH: given_truth, KNOWN: known_association}
)
"""What knows more than a method may; in every table, apart from the methods."""
