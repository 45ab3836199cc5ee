"""Trackers, zones and triangulation, given scans and layouts that make no sense."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

import mht_slam as ms

from .test_hostile_runs import associations, bearings, examples, mostly

Survives = Callable[..., Any]

COORDINATES = st.one_of(
    st.floats(-10.0, 10.0),
    st.sampled_from([0.0, -0.0, 1.0, 1.0 + 1e-15, 1e-300, -1e9, 1e160, -1e300, 1.7e308]),
)
PLACES = st.tuples(COORDINATES, COORDINATES)
SIGMAS = st.sampled_from([None, None, 1e-6, 0.01, 0.5, 3.1])


@st.composite
def scans(draw: st.DrawFn, most: int = 6) -> list[ms.BearingScan]:
    """Scans that have nothing to do with each other, or hardly differ."""
    first = draw(st.lists(bearings, max_size=most))
    found = []
    for _ in range(draw(st.integers(0, 12))):
        again = draw(st.booleans())
        values = first if again else draw(st.lists(bearings, max_size=most))
        found.append(ms.BearingScan(values, sigma=draw(SIGMAS)))
    return found


@examples(60)
@given(seen=scans(), data=st.data())
def test_tracking_survives(seen: list[ms.BearingScan], survives: Survives, data: Any) -> None:
    draw = data.draw
    config = survives(
        ms.TrackerConfig,
        sigma=draw(mostly(0.01, 1e-9, 1.0, 3.1)),
        detection_probability=draw(mostly(0.9, 1e-9, 1.0 - 1e-9)),
        stay_probability=draw(mostly(0.99, 1e-9, 1.0 - 1e-12)),
        false_alarm_rate=draw(mostly(0.05, 1e-12, 1e12)),
        new_rate=draw(mostly(0.01, 1e-12, 1e12)),
        nearness=draw(mostly(0.03, 0.0, 0.999)),
        nearness_sigma=draw(mostly(0.05, 1e-12, 1e12)),
        step_change_sigma=draw(mostly(0.03, 0.0, 1e9)),
        drift_sigma=draw(mostly(0.03, 0.0, 1e9)),
        turn_sigma=draw(mostly(0.05, 1e-12, 1e9)),
        turn_error_sigma=draw(mostly(0.01, 0.0, 1e-12, 1e9)),
        confirm=draw(st.sampled_from([1, 3])),
        window=draw(st.sampled_from([1, 4, 20])),
        n_alternatives=draw(st.sampled_from([1, 3, 10])),
        drop=draw(mostly(5.0, 1e-9, 1e9)),
        mode=draw(st.sampled_from(["general", "general", "paper"])),
    )
    if config is None:
        return
    tracker = ms.OrderTracker(config)
    for scan in seen:
        survives(tracker.update, scan)
    assert tracker.association.n_detections == tuple(len(scan) for scan in seen)
    probabilities = tracker.track_probabilities
    assert len(probabilities) == tracker.association.n_landmarks
    assert ((probabilities >= 0.0) & (probabilities <= 1.0)).all()


@examples(60)
@given(point=PLACES, landmarks=st.lists(PLACES, max_size=6), path=st.lists(PLACES, max_size=5))
def test_zones_and_order_changes_survive(
    point: tuple[float, float],
    landmarks: list[tuple[float, float]],
    path: list[tuple[float, float]],
    survives: Survives,
) -> None:
    survives(ms.zone, point, landmarks)
    for change in survives(ms.order_changes, path, landmarks) or ():
        assert 0.0 <= change.parameter <= 1.0


@examples(60)
@given(left=st.lists(bearings, max_size=5), right=st.lists(bearings, max_size=5), data=st.data())
def test_triangulation_survives(
    left: list[float], right: list[float], survives: Survives, data: Any
) -> None:
    first, second = ms.BearingScan(left), ms.BearingScan(right)
    found = survives(
        ms.triangulate,
        first,
        second,
        data.draw(associations((len(left), len(right)))),
        epsilon=data.draw(st.sampled_from([1e-12, 1e-4, 0.05, 1.0, math.pi / 2 - 1e-12])),
        sigma=data.draw(st.sampled_from([1e-6, 0.02, 3.1])),
        max_range=data.draw(mostly(100.0, 1e-12, 0.6, 1e9)),
    )
    if found is not None:
        variances = np.diagonal(found.covariances, axis1=1, axis2=2)
        assert (variances >= 0.0).all()
