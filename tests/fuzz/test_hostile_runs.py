"""Every function of the library, given runs that no robot should ever bring home."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

import mht_slam as ms

Survives = Callable[..., Any]

TIMES = int(os.environ.get("MHT_SLAM_FUZZ_TIMES", "1"))
"""How many times the few examples of an ordinary test run are drawn."""
FRESH = "MHT_SLAM_FUZZ_TIMES" in os.environ


def examples(count: int) -> settings:
    return settings(
        max_examples=count * TIMES,
        deadline=None,
        derandomize=not FRESH,
        database=None,
        phases=tuple(Phase) if FRESH else (Phase.explicit, Phase.generate),
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )


TINY = 1e-12
SPECIAL_BEARINGS = [
    0.0,
    -0.0,
    math.pi,
    -math.pi,
    math.nextafter(math.pi, 0.0),
    math.nextafter(-math.pi, 0.0),
    math.pi / 2,
    -math.pi / 2,
    TINY,
    -TINY,
    math.pi - TINY,
    5e-324,
    1e-300,
    1e6,
]
SPECIAL_PLACES = [-1e9, -5.0, -1.0, -TINY, 0.0, TINY, 0.5, 1.0, 2.0, 2.0 + TINY, 30.0, 1e9]
STEPS = [0.0, TINY, 1e-3, 0.3, 1.0, 1.0, 2.0, 1e3, 1e9]

bearings = st.one_of(st.floats(-math.pi, math.pi), st.sampled_from(SPECIAL_BEARINGS), st.just(0.7))
sigmas = st.sampled_from([None, None, 1e-12, 1e-4, 0.02, 0.5, 3.1, 1e3])


@st.composite
def loose_scans(draw: st.DrawFn, n_scans: int, least: int, most: int) -> list[list[float]]:
    """Bearings that have nothing to do with each other."""
    n = draw(st.integers(least, most))
    return [draw(st.lists(bearings, min_size=n, max_size=n)) for _ in range(n_scans)]


@st.composite
def uneven_scans(draw: st.DrawFn, n_scans: int, least: int, most: int) -> list[list[float]]:
    """Scans of any length, seldom as long as asked for."""
    del least
    return [draw(st.lists(bearings, max_size=most)) for _ in range(n_scans)]


@st.composite
def seen_scans(draw: st.DrawFn, n_scans: int, least: int, most: int) -> list[list[float]]:
    """Bearings of landmarks on the path, behind it, on top of each other, far out or parallel."""
    place = st.one_of(st.sampled_from(SPECIAL_PLACES), st.floats(-5.0, 5.0))
    landmarks = draw(st.lists(st.tuples(place, place), min_size=least, max_size=most))
    steps = draw(st.lists(st.sampled_from(STEPS), min_size=n_scans - 1, max_size=n_scans - 1))
    noise = draw(st.sampled_from([0.0, 0.0, TINY, 0.01, 0.3]))
    scans, x = [], 0.0
    for step in [0.0, *steps]:
        x += step
        scan = [math.atan2(b, a - x) for a, b in landmarks]
        scan = [angle + noise * draw(st.floats(-1.0, 1.0)) for angle in scan]
        scans.append(draw(st.permutations(scan)))
    return scans


@st.composite
def repeated_scans(draw: st.DrawFn, n_scans: int, least: int, most: int) -> list[list[float]]:
    """A robot that stands still, or a sensor that repeats itself."""
    scan = draw(st.lists(bearings, min_size=least, max_size=most))
    return [draw(st.permutations(scan)) if draw(st.booleans()) else scan for _ in range(n_scans)]


KINDS = [loose_scans, seen_scans, seen_scans, seen_scans, repeated_scans, uneven_scans]


@st.composite
def labels(draw: st.DrawFn, count: int) -> list[str | None] | None:
    """Seldom labels, and then from so few names that scans contradict each other."""
    if draw(st.integers(0, 5)):
        return None
    names: list[str | None] = list(draw(st.permutations(["a", "b", "c", "d", "e", "f"])))[:count]
    return [None if draw(st.booleans()) else name for name in names]


odometry = st.one_of(
    st.none(),
    st.builds(
        ms.Odometry,
        st.sampled_from([0.0, 1.0, -1.0, 1e6]),
        st.sampled_from([0.0, TINY, 1.0]),
        st.sampled_from([0.0, 0.1, math.pi, 50.0]),
        st.sampled_from([None, (0.01, 0.01, 0.001), (1e-12, 1e-12, 1e-12), (1e6, 1e6, 1e6)]),
    ),
)


@st.composite
def runs(
    draw: st.DrawFn,
    least: int,
    most: int,
    *,
    shortest: int = 3,
    longest: int = 4,
    one_pair_in: int = 5,
) -> ms.StraightRun | ms.RunPair:
    as_pair = draw(st.integers(1, one_pair_in)) == one_pair_in
    n_scans = 4 if as_pair else draw(st.integers(shortest, longest))
    kind = draw(st.sampled_from(KINDS))
    sigma, moved = draw(sigmas), draw(odometry)
    scans = [
        ms.BearingScan(scan, sigma=sigma, labels=draw(labels(len(scan))), odometry=moved)
        for scan in draw(kind(n_scans, least, most))
    ]
    return ms.RunPair(scans[:2], scans[2:]) if as_pair else ms.StraightRun(scans)


@st.composite
def associations(draw: st.DrawFn, counts: tuple[int, ...]) -> ms.Association:
    """Any partition: nothing but false alarms, all missed but one, order kept, or shuffled."""
    shuffled = draw(st.booleans())
    rows: list[list[object]] = []
    for count in counts:
        names: list[object] = list(range(max(counts)))
        if shuffled:
            names = draw(st.permutations(names))
        holes = draw(st.integers(0, 3)) == 0
        kept = [None if holes and draw(st.booleans()) else name for name in names[:count]]
        rows.append(kept)
    return ms.Association.from_labels(rows)


@st.composite
def candidates(draw: st.DrawFn, counts: tuple[int, ...]) -> list[ms.Association]:
    return draw(st.lists(associations(counts), max_size=3))


def mostly(usual: float, *others: float | None) -> st.SearchStrategy[float | None]:
    return st.sampled_from([usual, usual, usual, usual, *others])


straight_line = {
    "sigma": mostly(0.02, 1e-9, 1e-4, 0.5, 3.1),
    "bearing_dof": st.sampled_from([None, None, None, 3.0, 0.3, 1e9]),
    "landmark_sigma": mostly(30.0, 1e-6, 1.0, 1e9),
    "landmark_centre": st.sampled_from([(0.5, 0.0), (0.5, 0.0), (1e9, -1e9), (0.0, 0.0)]),
    "log_step_mean": mostly(0.0, -50.0, 50.0),
    "log_step_sigma": mostly(1.0, 1e-9, 100.0),
    "detection_probability": mostly(0.9, None, 1e-12, 1.0),
    "false_alarm_rate": mostly(0.1, None, 0.0, 1e12),
    "expected_landmarks": mostly(5.0, None, 1e-12, 1e12),
    "stay_probability": mostly(1.0, 1e-9, 0.7),
    "field_of_view": mostly(2.0 * math.pi, 1e-6, 1.5),
}
strict_models = st.builds(
    ms.ObservationModel,
    **straight_line
    | {
        "sigma": mostly(0.02, 1e-3, 0.5, 3.1, 1e-9),
        "log_step_sigma": mostly(1.0, 1e-9, 10.0, 100.0),
        "bearing_dof": st.none(),
        "stay_probability": st.just(1.0),
        "field_of_view": st.just(2.0 * math.pi),
    },
)
models = st.builds(
    ms.ObservationModel,
    **straight_line,
    motion=st.sampled_from(["straight", "straight", "smooth", "odometry", "free"]),
    stops=st.booleans(),
    heading_sigma=mostly(0.0, 0.05, 1e-12, 3.0),
    lateral_sigma=mostly(0.0, 0.1, 1e-12, 1e6),
    turn_sigma=mostly(0.05, 1e-12, 3.0),
    drift_sigma=mostly(0.1, 1e-12, 3.0),
    step_change_sigma=mostly(0.2, 1e-9, 100.0),
)

epsilons = st.sampled_from([TINY, 1e-4, 0.02, 0.05, 0.05, 0.3, 1.0, 1.5, math.pi / 2 - TINY])
spare = st.sampled_from([0, 0, 0, 1, 2])


@examples(25)
@given(run=runs(3, 4), data=st.data())
def test_ranking_survives(run: ms.StraightRun | ms.RunPair, survives: Survives, data: Any) -> None:
    draw = data.draw
    survives(
        ms.rank,
        run,
        epsilon=draw(epsilons),
        top_k=draw(st.sampled_from([1, 3, None])),
        method=draw(st.sampled_from(["exact", "exact", "exhaustive"])),
        ratio=draw(st.sampled_from(["iou", "overlap"])),
        region=draw(st.sampled_from(["edges", "vertices"])),
        base=draw(st.sampled_from([None, None, None, None, None, (0, 1), (2, 1), (0, 0), (7, 1)])),
        max_range=draw(mostly(100.0, TINY, 0.5, 3.0, 1e6)),
        max_missed=draw(spare) if len(run) == 3 else 0,
        max_false=draw(spare) if len(run) == 3 else 0,
        include_zero=draw(st.booleans()),
        refine_pair=draw(st.sampled_from([None, (0, 2)])) if len(run) == 3 else None,
        work_limit=draw(st.sampled_from([1, 50, 3000])),
    )


@examples(40)
@given(run=runs(0, 4, longest=5, one_pair_in=20), data=st.data())
def test_consistency_survives(
    run: ms.StraightRun | ms.RunPair, survives: Survives, data: Any
) -> None:
    draw = data.draw
    survives(
        ms.consistent_associations,
        run,
        epsilon=draw(epsilons),
        limit=draw(st.sampled_from([1, 20])),
        max_missed=draw(spare),
        max_false=draw(spare),
        max_nodes=draw(st.sampled_from([1, 300])),
    )


@examples(15)
@given(run=runs(0, 3, one_pair_in=20), data=st.data())
def test_tightness_survives(
    run: ms.StraightRun | ms.RunPair, survives: Survives, data: Any
) -> None:
    survives(ms.smallest_epsilon, run, data.draw(associations(run.n_detections)))
    survives(ms.tightest_association, run, max_nodes=data.draw(st.sampled_from([1, 100])))


@examples(30)
@given(run=runs(0, 3), model=models, data=st.data())
def test_refinement_survives(
    run: ms.StraightRun | ms.RunPair, model: ms.ObservationModel, survives: Survives, data: Any
) -> None:
    draw = data.draw
    survives(
        ms.refine,
        run,
        draw(candidates(run.n_detections)),
        model=model,
        evidence=draw(st.sampled_from(["marginal", "laplace"])),
        scale=draw(st.sampled_from([None, None, None, 1e-9, 2.0, 1e9])),
    )


@examples(20)
@given(run=runs(0, 3, one_pair_in=20), model=strict_models, data=st.data())
def test_quadrature_survives(
    run: ms.StraightRun | ms.RunPair, model: ms.ObservationModel, survives: Survives, data: Any
) -> None:
    counts = run.n_detections[:3]
    survives(ms.evidence_by_quadrature, run, data.draw(candidates(counts)), model=model)
    survives(
        ms.rank_by_evidence,
        run,
        model=model,
        top_k=data.draw(st.sampled_from([1, 4])),
        max_missed=data.draw(spare),
        max_false=data.draw(spare),
        work_limit=data.draw(st.sampled_from([1, 100])),
    )


@examples(10)
@given(run=runs(3, 3, longest=3), model=st.one_of(st.none(), models), data=st.data())
def test_solving_and_comparing_survive(
    run: ms.StraightRun | ms.RunPair,
    model: ms.ObservationModel | None,
    survives: Survives,
    data: Any,
) -> None:
    solution = survives(
        ms.solve,
        run,
        epsilon=data.draw(epsilons),
        top_k=data.draw(st.sampled_from([1, 4])),
        model=model,
        truth=data.draw(st.one_of(st.none(), associations(run.n_detections))),
    )
    if solution is not None:
        truth = (
            data.draw(associations(solution.ranking[0].association.n_detections))
            if len(solution.ranking)
            else None
        )
        survives(ms.compare, solution.ranking, solution.posterior, truth)


@examples(10)
@given(run=runs(2, 3, shortest=4, longest=5, one_pair_in=100), model=models, data=st.data())
def test_solving_all_scans_survives(
    run: ms.StraightRun | ms.RunPair, model: ms.ObservationModel, survives: Survives, data: Any
) -> None:
    survives(ms.solve, run, epsilon=data.draw(epsilons), top_k=1, model=model)


@examples(40)
@given(run=runs(0, 4), model=models, data=st.data())
def test_observability_survives(
    run: ms.StraightRun | ms.RunPair, model: ms.ObservationModel, survives: Survives, data: Any
) -> None:
    found = survives(ms.observability, run, data.draw(associations(run.n_detections)), model)
    if found is not None:
        assert found.redundancy >= found.redundancy_of_bearings
        assert len(set(found.free_directions)) == len(found.free_directions)


def test_many_detections_are_refused_or_searched(survives: Survives) -> None:
    many = ms.BearingScan(np.linspace(-3.0, 3.0, 150))
    run = ms.StraightRun([many] * 3)
    survives(ms.rank, run, epsilon=0.01, top_k=1, work_limit=10)
    survives(ms.consistent_associations, run, epsilon=0.01, max_nodes=10)
    few = ms.StraightRun([ms.BearingScan(np.linspace(-3.0, 3.0, 12))] * 3)
    survives(ms.rank, few, epsilon=1e-4, top_k=1, work_limit=10)
    survives(ms.consistent_associations, few, epsilon=0.01, max_nodes=10)
