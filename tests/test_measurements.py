"""Scans, runs and odometry hold what they promise, and refuse what cannot be a measurement."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.errors import MeasurementError, MhtSlamError
from mht_slam.measurements import (
    BearingScan,
    Odometry,
    RunPair,
    StraightRun,
    scan_selection,
    wrap_angle,
)

ANGLES = st.floats(min_value=-50.0, max_value=50.0)
BEARINGS = st.lists(ANGLES, max_size=6)


def a_full_scan() -> BearingScan:
    return BearingScan(
        [0.5, -1.0, 4.0],
        time=2.5,
        sigma=[0.01, 0.02, 0.03],
        labels=["oak", None, "elm"],
        odometry=Odometry(1.0, 0.0, 0.1, [0.1, 0.2, 0.3]),
    )


@given(ANGLES)
def test_wrapping_moves_an_angle_by_whole_turns_into_the_half_open_turn(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -np.pi < wrapped <= np.pi
    turns = (angle - wrapped) / (2 * np.pi)
    assert turns == pytest.approx(round(turns), abs=1e-9)


@given(BEARINGS)
def test_wrapping_twice_is_wrapping_once(angles: list[float]) -> None:
    once = wrap_angle(np.array(angles))
    assert np.array_equal(wrap_angle(once), once)


@pytest.mark.parametrize("angle", [np.pi, -3.0, -0.0, 1e-300, np.nextafter(-np.pi, 0)])
def test_angles_inside_are_left_bit_for_bit(angle: float) -> None:
    assert np.float64(wrap_angle(angle)).tobytes() == np.float64(angle).tobytes()


@pytest.mark.parametrize("angle", [-np.pi, 3 * np.pi, np.nextafter(-np.pi, -4)])
def test_backward_is_plus_pi_never_minus_pi(angle: float) -> None:
    assert wrap_angle(angle) == pytest.approx(np.pi, abs=1e-12)


@given(BEARINGS)
def test_detection_i_is_the_callers_bearing_i(angles: list[float]) -> None:
    scan = BearingScan(angles)
    assert len(scan) == scan.n_detections == len(angles)
    assert np.allclose(np.exp(1j * scan.bearings), np.exp(1j * np.array(angles)), atol=1e-9)
    assert scan.bearings.dtype == np.float64


def test_the_callers_arrays_are_copied_and_stay_the_callers() -> None:
    bearings, sigma = np.array([0.1, 0.2]), np.array([0.01, 0.01])
    covariance = np.diag([1.0, 2.0, 3.0])
    odometry = Odometry(1, 0, 0, covariance)
    scan = BearingScan(bearings, sigma=sigma, odometry=odometry)
    bearings[0], sigma[0], covariance[0, 0] = 3.0, 9.0, 9.0
    assert scan.bearings[0] == 0.1
    assert scan.sigma is not None
    assert scan.sigma[0] == 0.01
    assert odometry.covariance is not None
    assert odometry.covariance[0, 0] == 1.0


def unpickled(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))  # noqa: S301 - our own bytes


@pytest.mark.parametrize("remake", [lambda scan: scan, copy.copy, copy.deepcopy, unpickled])
def test_no_way_leads_to_a_writeable_array(remake: Callable[[BearingScan], BearingScan]) -> None:
    scan = remake(a_full_scan())
    assert scan.odometry is not None
    for array in (scan.bearings, scan.sigma, scan.odometry.covariance):
        assert array is not None
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


@pytest.mark.parametrize("remake", [copy.deepcopy, unpickled])
def test_copies_are_equal_and_hash_alike(remake: Callable[[Any], Any]) -> None:
    scan = a_full_scan()
    pair = RunPair((scan, scan), (scan, BearingScan([])))
    for value in (scan, scan.odometry, StraightRun([scan] * 3), pair):
        assert remake(value) == value
        assert hash(remake(value)) == hash(value)


@pytest.mark.parametrize(
    "other",
    [
        BearingScan([0.5, -1.0]),
        BearingScan([0.5, -1.0, 2.0], time=1.0),
        BearingScan([0.5, -1.0, 2.0], sigma=0.1),
        BearingScan([0.5, -1.0, 2.0], labels=[None, None, "a"]),
        BearingScan([0.5, -1.0, 2.0], odometry=Odometry(1, 0, 0)),
        BearingScan([-1.0, 0.5, 2.0]),
        "a scan",
    ],
)
def test_scans_that_differ_in_any_field_are_not_equal(other: object) -> None:
    assert BearingScan([0.5, -1.0, 2.0]) != other


def test_equal_scans_hash_alike_even_at_minus_zero() -> None:
    assert BearingScan([0.0]) == BearingScan([-0.0])
    assert hash(BearingScan([0.0])) == hash(BearingScan([-0.0]))


def test_odometry_is_equal_only_with_the_same_covariance() -> None:
    assert Odometry(1, 2, 3) == Odometry(1, 2, 3)
    assert Odometry(1, 2, 3) != Odometry(1, 2, 3, [1, 1, 1])
    assert Odometry(1, 2, 3) != Odometry(1, 2, 4)
    assert Odometry(1, 2, 3) != (1, 2, 3)


def test_a_scalar_sigma_holds_for_every_detection() -> None:
    assert np.array_equal(BearingScan([1, 2, 3], sigma=0.1).sigma, [0.1, 0.1, 0.1])


def test_three_variances_are_a_diagonal_covariance() -> None:
    assert np.array_equal(Odometry(0, 0, 0, [1, 2, 3]).covariance, np.diag([1.0, 2.0, 3.0]))


@pytest.mark.parametrize(
    ("bearings", "words"),
    [
        ([0.1, np.nan], ("bearings[1]", "nan", "radians")),
        ([np.inf, 0.1], ("bearings[0]", "inf", "drop the detection")),
        ([0.1, "north"], ("bearings[1]", "north", "radians")),
        ([0.1, None], ("bearings[1]", "None", "radians")),
        ([0.1, 1j], ("bearings[1]", "1j", "radians")),
        ([True], ("bearings[0]", "True", "radians")),
        (["0.1"], ("bearings[0]", "0.1", "radians")),
        ([10**400], ("bearings", "numbers", "radians")),
        ([[0.1, 0.2]], ("bearings", "(1, 2)", "one dimension")),
        ([[0.1], [0.1, 0.2]], ("bearings", "rectangular", "radians")),
        (0.3, ("bearings", "()", "one dimension")),
        (None, ("bearings", "None", "radians")),
        ("abc", ("bearings", "abc", "radians")),
    ],
)
def test_bearings_that_are_none_are_refused_by_field_entry_and_remedy(
    bearings: Any, words: tuple[str, ...]
) -> None:
    with pytest.raises(MeasurementError) as caught:
        BearingScan(bearings)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"sigma": 0.0}, ("sigma[0]", "0.0", "above zero")),
        ({"sigma": [0.1, -0.2]}, ("sigma[1]", "-0.2", "above zero")),
        ({"sigma": 5e-324}, ("sigma[0]", "5e-324", "at least 1e-15")),
        ({"sigma": np.longdouble("1e4000")}, ("sigma", "inf", "radians")),
        ({"sigma": [0.1, np.nan]}, ("sigma[1]", "nan", "radians")),
        ({"sigma": [0.1]}, ("sigma", "(1,)", "(2)")),
        ({"sigma": "wide"}, ("sigma", "wide", "radians")),
        ({"labels": "ab"}, ("labels", "one string", "per detection")),
        ({"labels": 3}, ("labels", "3", "per detection")),
        ({"labels": ["a"]}, ("labels", "1 entries", "2 detections")),
        ({"labels": ["a", "a"]}, ("labels[1]", "'a'", "at most once")),
        ({"labels": ["a", 4]}, ("labels[1]", "4", "string or None")),
        ({"time": np.nan}, ("time", "nan", "finite")),
        ({"time": "noon"}, ("time", "noon", "number")),
        ({"odometry": (1, 0, 0)}, ("odometry", "(1, 0, 0)", "Odometry")),
    ],
)
def test_options_of_a_scan_are_refused_by_field_entry_and_remedy(
    options: dict[str, Any], words: tuple[str, ...]
) -> None:
    with pytest.raises(MeasurementError) as caught:
        BearingScan([0.1, 0.2], **options)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((np.nan, 0, 0), ("dx", "nan", "finite")),
        ((0, "left", 0), ("dy", "left", "number")),
        ((0, 0, True), ("dtheta", "True", "number")),
        ((0, 0, 0, [1, 1]), ("covariance", "(2,)", "(3, 3)")),
        ((0, 0, 0, [1, 1, -1]), ("covariance", "positive definite")),
        ((0, 0, 0, [[1, 1, 0], [0, 1, 0], [0, 0, 1]]), ("covariance", "symmetric")),
        ((0, 0, 0, [1, np.inf, 1]), ("covariance[1]", "inf", "metres")),
    ],
)
def test_odometry_is_refused_by_field_value_and_remedy(
    arguments: tuple[Any, ...], words: tuple[str, ...]
) -> None:
    with pytest.raises(MeasurementError) as caught:
        Odometry(*arguments)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize("n_scans", [0, 1, 2])
def test_a_straight_run_needs_three_scans(n_scans: int) -> None:
    with pytest.raises(MeasurementError, match=f"{n_scans} scans: .* at least 3"):
        StraightRun([BearingScan([0.1])] * n_scans)


def test_a_run_refuses_what_is_no_scan_and_says_where() -> None:
    scan = BearingScan([0.1])
    with pytest.raises(MeasurementError, match=r"scans\[2\] is list: give a BearingScan"):
        StraightRun([scan, scan, [0.1]])  # type: ignore[list-item]
    with pytest.raises(MeasurementError, match="scans is 7"):
        StraightRun(7)  # type: ignore[arg-type]
    with pytest.raises(MeasurementError, match=r"second has 3 scans: give exactly two"):
        RunPair([scan] * 2, [scan] * 3)


def test_a_scan_in_which_everything_was_missed_is_part_of_a_run() -> None:
    run = StraightRun([BearingScan([0.1]), BearingScan([]), BearingScan([0.1, 0.2])])
    assert run.n_detections == (1, 0, 2)
    assert len(run) == 3


def test_a_run_pair_lists_the_scans_of_the_first_run_first() -> None:
    scans = [BearingScan([0.1] * k) for k in (1, 2, 3, 4)]
    pair = RunPair(scans[:2], scans[2:])
    assert list(pair.scans) == scans
    assert pair.n_detections == (1, 2, 3, 4)
    assert len(pair) == 4


def test_selecting_scans_keeps_them_in_the_order_of_travel() -> None:
    run = StraightRun([BearingScan([0.1] * k) for k in range(5)])
    assert run.select((0, 2, 4)).n_detections == (0, 2, 4)


@pytest.mark.parametrize(
    ("scans", "message"),
    [
        ((0, 2, 1), "increasing"),
        ((0, 0, 1), "increasing"),
        ((0, 1, 5), "names scan 5: the run has scans 0 to 4"),
        ((-1, 1, 2), "names scan -1"),
        ((0, 1, 2.5), "scan indices"),
        ("abc", "scan indices"),
        (3, "scan indices"),
        ((0, 1), "2 indices: give 3"),
    ],
)
def test_a_selection_that_is_none_is_refused(scans: Any, message: str) -> None:
    with pytest.raises(MeasurementError, match=message):
        scan_selection(scans, 5, exactly=3)


def test_measurement_errors_are_the_librarys_and_value_errors() -> None:
    assert issubclass(MeasurementError, MhtSlamError)
    assert issubclass(MeasurementError, ValueError)
