"""What is no number, no scan, no table and no option is refused by name, whatever it is instead."""

from __future__ import annotations

import datetime
import math
import os
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

import mht_slam as ms

Survives = Callable[..., Any]

TIMES = int(os.environ.get("MHT_SLAM_FUZZ_TIMES", "1"))
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


ODD = [
    None,
    True,
    math.nan,
    math.inf,
    -math.inf,
    "0.1",
    "",
    b"x",
    1j,
    10**400,
    -(10**400),
    [],
    {},
    {1, 2},
    object(),
    np.nan,
    np.array(np.nan),
    np.array([0.1, np.inf]),
    np.array([[0.1]]),
    np.array(["a"]),
    np.array([None]),
    np.datetime64("2020-01-01"),
    datetime.timedelta(1),
    np.float32(0.1),
    np.longdouble("1e4000"),
    np.int8(3),
    np.array(7),
    [[0.1], [0.2, 0.3]],
    [0.1, None],
    (0.1, "b"),
    range(3),
    len,
    ms.BearingScan,
]
numbers = st.one_of(
    st.floats(), st.integers(-3, 10), st.sampled_from([0.0, 0.1, 1.0, 5e-324, 1e308, 2**70])
)
anything = st.one_of(
    numbers,
    st.sampled_from(ODD),
    st.lists(st.one_of(numbers, st.sampled_from(ODD)), max_size=4),
    st.text(max_size=3),
)
mostly_numbers = st.one_of(numbers, numbers, anything)
scans = st.builds(ms.BearingScan, st.lists(st.floats(-3.0, 3.0), max_size=3))
names = st.one_of(st.none(), st.text(max_size=2), anything)


@examples(60)
@given(st.data())
def test_values_are_made_or_refused(survives: Survives, data: Any) -> None:
    draw = data.draw
    survives(
        ms.BearingScan,
        draw(st.one_of(st.lists(mostly_numbers, max_size=4), anything)),
        time=draw(st.one_of(st.none(), anything)),
        sigma=draw(st.one_of(st.none(), anything)),
        labels=draw(st.one_of(st.none(), st.lists(names, max_size=4), anything)),
        odometry=draw(st.one_of(st.none(), anything)),
    )
    survives(
        ms.Odometry, *(draw(mostly_numbers) for _ in range(3)), draw(st.one_of(st.none(), anything))
    )
    some = draw(st.one_of(st.lists(st.one_of(scans, anything), max_size=4), anything))
    survives(ms.StraightRun, some)
    survives(ms.RunPair, draw(st.lists(scans, min_size=2, max_size=2)), some)


@examples(60)
@given(st.data())
def test_associations_are_made_or_refused(survives: Survives, data: Any) -> None:
    draw = data.draw
    entries = st.one_of(st.integers(-2, 3), st.integers(-2, 3), st.integers(-2, 3), anything)
    counts = draw(st.one_of(st.lists(st.integers(0, 3), max_size=4), anything))
    width = len(counts) if isinstance(counts, list) else 3
    rows = st.lists(entries, min_size=width, max_size=width)
    table = draw(st.one_of(st.lists(rows, max_size=3), anything))
    made = survives(ms.Association, table, counts)
    if made is not None:
        survives(made.restrict, draw(anything))
        other = survives(ms.Association, [], made.n_detections)
        for score in (made.f1, made.precision, made.recall, made.exact):
            survives(score, other)
            survives(score, draw(anything))
        assert made == ms.Association(made.table, made.n_detections)
        assert len({made, made}) == 1
    labels = st.lists(st.one_of(st.integers(0, 2), st.none(), anything), max_size=3)
    survives(ms.Association.from_labels, draw(st.one_of(st.lists(labels, max_size=4), anything)))


@examples(60)
@given(st.data())
def test_models_are_made_or_refused(survives: Survives, data: Any) -> None:
    fields = sorted(ms.ObservationModel(sigma=0.1).to_dict())
    chosen = data.draw(st.lists(st.sampled_from(fields), max_size=4, unique=True))
    options = {"sigma": 0.02} | {name: data.draw(anything) for name in chosen}
    model = survives(ms.ObservationModel, **options)
    if model is not None:
        assert "nan" not in model.describe()


RUN = ms.StraightRun(
    ms.BearingScan([math.atan2(y, x - at) for x, y in ((1.0, 3.0), (2.0, -2.0), (3.5, 1.5))])
    for at in (0.0, 1.0, 2.2)
)
TRUTH = ms.Association([[0, 0, 0], [1, 1, 1], [2, 2, 2]], (3, 3, 3))
MODEL = ms.ObservationModel(sigma=0.02)
RANKING = ms.rank(RUN, epsilon=0.05)
POSTERIOR = ms.refine(RUN, [TRUTH], model=MODEL, evidence="laplace")

CALLS: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "rank": (
        ms.rank,
        {
            "run": RUN,
            "epsilon": 0.05,
            "top_k": 1,
            "method": "exact",
            "ratio": "iou",
            "region": "edges",
            "base": None,
            "max_range": 100.0,
            "scans": (0, 1, 2),
            "max_missed": 0,
            "max_false": 0,
            "refine_pair": None,
            "work_limit": 100,
        },
    ),
    "consistent": (
        ms.consistent_associations,
        {
            "run": RUN,
            "epsilon": 0.05,
            "limit": 2,
            "scans": None,
            "max_missed": 0,
            "max_false": 0,
            "max_nodes": 50,
        },
    ),
    "smallest": (ms.smallest_epsilon, {"run": RUN, "association": TRUTH, "scans": None}),
    "tightest": (ms.tightest_association, {"run": RUN, "scans": None, "max_nodes": 50}),
    "refine": (
        ms.refine,
        {
            "run": RUN,
            "candidates": [TRUTH],
            "sigma": None,
            "heading_sigma": 0.0,
            "lateral_sigma": 0.0,
            "model": MODEL,
            "evidence": "laplace",
            "scale": None,
        },
    ),
    "quadrature": (
        ms.evidence_by_quadrature,
        {"run": RUN, "candidates": [TRUTH], "sigma": None, "model": MODEL, "scans": (0, 1, 2)},
    ),
    "best": (
        ms.rank_by_evidence,
        {
            "run": RUN,
            "sigma": None,
            "top_k": 1,
            "model": MODEL,
            "scans": (0, 1, 2),
            "max_missed": 0,
            "max_false": 0,
            "work_limit": 50,
        },
    ),
    "solve": (
        ms.solve,
        {
            "run": RUN,
            "epsilon": 0.05,
            "sigma": 0.02,
            "top_k": 1,
            "scale": None,
            "heading_sigma": 0.0,
            "lateral_sigma": 0.0,
            "model": None,
            "evidence": "laplace",
            "max_range": 100.0,
            "scans": (0, 1, 2),
            "truth": None,
        },
    ),
    "compare": (ms.compare, {"ranking": RANKING, "posterior": POSTERIOR, "truth": TRUTH}),
    "observability": (
        ms.observability,
        {"run": RUN, "association": TRUTH, "model": MODEL, "scans": None},
    ),
    "credible set": (POSTERIOR.credible_set, {"level": 0.95}),
}


@pytest.mark.parametrize("name", CALLS)
def test_the_calls_work_as_they_stand(name: str, survives: Survives) -> None:
    function, options = CALLS[name]
    assert survives(function, **options) is not None


@examples(120)
@given(name=st.sampled_from(sorted(CALLS)), data=st.data())
def test_odd_options_are_refused(name: str, survives: Survives, data: Any) -> None:
    function, options = CALLS[name]
    option = data.draw(st.sampled_from(sorted(options)))
    survives(function, **(options | {option: data.draw(anything)}))
