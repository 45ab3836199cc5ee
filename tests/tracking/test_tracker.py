"""The tracker keeps identities: through crossings, misses, false alarms, turns and the seam."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from mht_slam.association import MISSED, Association
from mht_slam.errors import MeasurementError, OptionError
from mht_slam.evaluation.tracks import track_counts
from mht_slam.measurements import BearingScan
from mht_slam.simulation import Sensor
from mht_slam.tracking.exchanges import exchanges
from mht_slam.tracking.options import TrackerConfig
from mht_slam.tracking.order import apparent_angles
from mht_slam.tracking.tracker import OrderTracker
from mht_slam.tracking.zones import order_changes

from .conftest import DenseRun

DEGREE = math.radians(1.0)
CLEAR = TrackerConfig(sigma=0.02 * DEGREE, false_alarm_rate=0.001, detection_probability=0.99)
NOISY = Sensor(
    spread=0.5 * DEGREE, noise="gaussian", detection_probability=0.95, false_alarm_rate=0.03
)
SEEDS = st.integers(0, 2**32 - 1)
FIXTURE = [HealthCheck.function_scoped_fixture]


def tracked(scans: Sequence[BearingScan], config: TrackerConfig | None = None) -> OrderTracker:
    tracker = OrderTracker(config)
    for scan in scans:
        tracker.update(scan)
    return tracker


@settings(max_examples=12, deadline=None, suppress_health_check=FIXTURE)
@given(SEEDS, st.sampled_from([0.0, 0.03, -0.08]))
def test_noiseless_tracks_exchange_places_exactly_where_geometry_says(
    dense_run: DenseRun, seed: int, bend: float
) -> None:
    scene = dense_run(seed, bend=bend)
    # Bearings that a scan sees as one do not say which is whose, nor do those that are near each
    # other in the first scan, or straight ahead: nothing is known yet of how they move.
    closest = [apparent_angles(scan.bearings).min() for scan in scene.scans]
    assume(min(closest) > 2.0 * CLEAR.sigma and closest[0] > 0.5 * DEGREE)
    assume(all((np.abs(scan.bearings) < 1.0 * DEGREE).sum() < 2 for scan in scene.scans))
    found = tracked(scene.scans, CLEAR).association
    assert found == scene.truth
    predicted = {
        (change.segment, change.pair)
        for change in order_changes(scene.poses[:, :2], scene.landmarks)
    }
    seen = exchanges(scene.scans, found)
    assert all(exchange.after == exchange.before + 1 for exchange in seen)
    assert {(exchange.before, exchange.pair) for exchange in seen} == predicted


@pytest.mark.parametrize("seed", [61, 74])
def test_a_robot_that_keeps_turning_loses_nobody_though_its_turns_are_misjudged(
    dense_run: DenseRun, seed: int
) -> None:
    """While no nearness is known, turns that last are misjudged alike scan after scan."""
    scene = dense_run(seed, bend=-0.08)
    assert tracked(scene.scans, CLEAR).association == scene.truth
    trusting = dataclasses.replace(CLEAR, turn_error_sigma=0.0)
    assert tracked(scene.scans, trusting).association != scene.truth


def scans_of(landmarks: Sequence[tuple[float, float]], xs: np.ndarray) -> list[BearingScan]:
    points = np.array(landmarks)
    return [BearingScan(np.arctan2(points[:, 1], points[:, 0] - x)) for x in xs]


SURROUNDED = [(-4.0, -3.0), (4.0, -3.0), (4.0, 5.0), (0.0, 5.0), (-4.0, 5.0), (0.0, 2.0)]
"""The inner landmark passes before one of those all around."""


def test_the_paper_rule_alone_fails_where_landmarks_are_all_around() -> None:
    scans = scans_of(SURROUNDED, np.linspace(-1.0, 1.0, 20))
    truth = Association.from_labels([range(6)] * 20)
    assert tracked(scans, CLEAR).association == truth
    by_rule = tracked(scans, dataclasses.replace(CLEAR, mode="paper")).association
    assert not by_rule.exact(truth)
    assert {row[0] for row in by_rule.table.tolist() if len({*row} - {MISSED}) > 1} <= {3, 5}


def test_the_paper_rule_suffices_outside_landmarks_in_convex_position() -> None:
    square = [(0.0, 2.0), (3.0, 2.0), (3.0, 5.0), (0.0, 5.0)]
    scans = scans_of(square, np.arange(-4.03, 7.0, 0.1))
    truth = Association.from_labels([range(4)] * len(scans))
    assert len(exchanges(scans, truth)) >= 4
    for mode in ("paper", "general"):
        config = dataclasses.replace(CLEAR, mode=mode)
        assert tracked(scans, config).association == truth


@settings(max_examples=8, deadline=None, suppress_health_check=FIXTURE)
@given(SEEDS)
def test_the_order_of_the_detections_tells_nothing(dense_run: DenseRun, seed: int) -> None:
    scene = dense_run(seed, sensor=NOISY, n_scans=20)
    rng = np.random.default_rng(seed)
    orders = [rng.permutation(len(scan)) for scan in scene.scans]
    shuffled = [BearingScan(s.bearings[o]) for s, o in zip(scene.scans, orders, strict=True)]
    found, again = tracked(scene.scans), tracked(shuffled)
    back = [
        [-1 if entry == MISSED else int(orders[k][entry]) for k, entry in enumerate(row)]
        for row in again.association.table.tolist()
    ]
    assert Association(back, found.association.n_detections) == found.association
    assert sorted(again.track_probabilities) == pytest.approx(sorted(found.track_probabilities))


@settings(max_examples=8, deadline=None, suppress_health_check=FIXTURE)
@given(SEEDS)
def test_a_mirrored_world_is_tracked_alike(dense_run: DenseRun, seed: int) -> None:
    scene = dense_run(seed, sensor=NOISY, n_scans=20, bend=0.02)
    mirrored = [BearingScan(-scan.bearings) for scan in scene.scans]
    assert tracked(mirrored).association == tracked(scene.scans).association


def test_misses_and_false_alarms_break_no_track(dense_run: DenseRun) -> None:
    scores = []
    for seed in range(4):
        scene = dense_run(seed, n_landmarks=5, n_scans=60, sensor=NOISY)
        scores.append(track_counts(tracked(scene.scans).association, scene.truth).idf1)
    assert min(scores) > 0.9
    assert np.mean(scores) > 0.97


def test_a_sharp_turn_of_the_robot_loses_nobody() -> None:
    landmarks = np.array([(3.0, 2.0), (1.0, -3.0), (-2.0, 1.0), (6.0, 5.3), (-3.0, -4.0)])
    headings = np.where(np.arange(40) < 20, 0.0, math.radians(40.0))
    moves = 0.1 * np.column_stack([np.cos(headings), np.sin(headings)])
    points = np.cumsum(moves, axis=0) - moves
    scans = []
    for point, heading in zip(points, headings, strict=True):
        away = landmarks - point
        scans.append(BearingScan(np.arctan2(away[:, 1], away[:, 0]) - heading))
    assert tracked(scans, CLEAR).association == Association.from_labels([range(5)] * 40)


def test_half_of_the_last_turn_is_expected_again() -> None:
    """On a ring of equal gaps, turns by x and by x less a gap look alike."""
    gap = 40.0 * DEGREE
    ring = gap * np.arange(9)
    turns = gap * np.array([0.0] * 6 + [0.3, 0.55, 0.55, 0.0, 0.0, -0.3, -0.55, -0.55, 0.0])
    scans = [BearingScan(ring - heading) for heading in np.cumsum(turns)]
    truth = Association.from_labels([range(9)] * len(scans))
    assert tracked(scans, CLEAR).association == truth


def test_a_robot_that_drifts_off_its_heading_loses_nobody() -> None:
    drifts = {seed: drifting_run(seed, CLEAR.drift_sigma) for seed in (0, 1, 5, 13)}
    for scans, truth in drifts.values():
        assert tracked(scans, CLEAR).association == truth
    for wrong in (0.0, 10.0 * CLEAR.drift_sigma):
        config = dataclasses.replace(CLEAR, drift_sigma=wrong)
        lost = [tracked(scans, config).association != truth for scans, truth in drifts.values()]
        assert sum(lost) >= 2


def drifting_run(seed: int, drift: float) -> tuple[list[BearingScan], Association]:
    """Landmarks from four steps away on; the robot moves now left and now right of its heading."""
    rng = np.random.default_rng(seed)
    directions = drift * rng.standard_normal(39)
    moves = 0.1 * np.column_stack([np.cos(directions), np.sin(directions)])
    points = np.vstack([np.zeros((1, 2)), np.cumsum(moves, axis=0)])
    landmarks: list[np.ndarray] = []
    while len(landmarks) < 6:
        place = rng.uniform([-2.0, -3.0], [6.0, 3.0])
        if np.hypot(*(points - place).T).min() > 0.4:
            landmarks.append(place)
    away = np.array(landmarks) - points[:, None]
    scans = [BearingScan(np.arctan2(a[:, 1], a[:, 0])) for a in away]
    return scans, Association.from_labels([range(6)] * len(scans))


def test_landmarks_that_enter_and_leave_the_view_have_tracks_of_their_own() -> None:
    along = np.arange(0.0, 8.0, 0.1)
    landmarks = np.array([(2.0, 1.5), (4.0, 2.0), (6.0, -1.5), (7.5, 2.5)])
    scans, labels = [], []
    for x in along:
        away = landmarks - (x, 0.0)
        seen = np.flatnonzero(np.hypot(*away.T) < 2.5)
        scans.append(BearingScan(np.arctan2(away[seen, 1], away[seen, 0])))
        labels.append(seen.tolist())
    assert tracked(scans, CLEAR).association == Association.from_labels(labels)


def test_a_detection_now_and_then_is_a_false_alarm() -> None:
    scans = scans_of([(3.0, 2.0), (1.0, -3.0)], np.arange(0.0, 4.0, 0.1))
    stray = {5: 2.9, 14: -0.4, 27: 1.2}
    cluttered = [
        BearingScan([*scan.bearings, stray[k]] if k in stray else scan.bearings)
        for k, scan in enumerate(scans)
    ]
    association = tracked(cluttered, TrackerConfig(sigma=0.1 * DEGREE)).association
    assert association.false_alarms == tuple((k, 2) for k in stray)


def test_numbers_of_the_tracks_are_returned_scan_by_scan() -> None:
    tracker = OrderTracker(CLEAR)
    first = tracker.update(BearingScan([0.5, 2.0]))
    assert first.tolist() == [0, 1]
    assert tracker.update(BearingScan([2.001, 0.5005, -1.0])).tolist() == [1, 0, 2]
    assert tracker.update(BearingScan([])).tolist() == []
    assert tracker.association.n_landmarks == 0  # nobody has been seen three times


def test_probabilities_are_low_where_two_tracks_may_have_been_exchanged() -> None:
    """Two landmarks are one for some scans and part again: either may be either."""
    rng = np.random.default_rng(0)
    apart = np.concatenate([np.linspace(6, 0, 8), np.zeros(6), np.linspace(0, 6, 8)]) * DEGREE
    scans = [
        BearingScan(np.array([1.0 - d / 2, 1.0 + d / 2, -1.0]) + 0.2 * DEGREE * rng.normal(size=3))
        for d in apart
    ]
    tracker = tracked(scans, TrackerConfig(sigma=0.2 * DEGREE))
    rows = tracker.association.table[:, 0].tolist()
    probability = dict(zip(rows, tracker.track_probabilities.tolist(), strict=True))
    assert probability[2] > 0.99
    assert 0.05 < probability[0] < 0.99
    assert probability[0] == pytest.approx(probability[1], abs=0.05)


def test_no_scan_and_empty_scans_are_no_trouble() -> None:
    assert OrderTracker().association == Association([], [])
    assert tracked([BearingScan([])] * 3).association == Association([], [0, 0, 0])
    assert tracked([BearingScan([])] * 3).track_probabilities.size == 0
    assert tracked([BearingScan([0.1])] * 4, TrackerConfig(mode="paper")).association.n_landmarks


def test_what_is_no_scan_or_has_labels_is_refused() -> None:
    with pytest.raises(MeasurementError, match="scan is list"):
        OrderTracker().update([0.1])  # type: ignore[arg-type]
    tracker = tracked([BearingScan([0.1])])
    with pytest.raises(OptionError, match="scan 1 has labels"):
        tracker.update(BearingScan([0.1], labels=["oak"]))
    assert tracker.association.n_detections == (1,)
    with pytest.raises(OptionError, match="config is dict"):
        OrderTracker({})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("sigma", 0.0),
        ("detection_probability", 1.0),
        ("stay_probability", 0.0),
        ("false_alarm_rate", -1.0),
        ("nearness", 1.0),
        ("turn_sigma", math.nan),
        ("drift_sigma", -0.1),
        ("window", 0),
        ("n_alternatives", 1.5),
        ("mode", "rule"),
    ],
)
def test_options_that_make_no_sense_are_refused(name: str, value: object) -> None:
    with pytest.raises(OptionError, match=name):
        TrackerConfig(**{name: value})  # type: ignore[arg-type]
