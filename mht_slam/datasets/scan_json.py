"""Scans as JSON lines: one scan a line, everything a `BearingScan` can hold."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.datasets.scan_records import Place, ScanRecord, check_landmarks, exact_degrees
from mht_slam.errors import MeasurementError, ScanFileError
from mht_slam.measurements import BearingScan, Odometry

SCAN_KEYS = ("time", "bearings_deg", "sigma_deg", "labels", "odometry", "landmarks")
ODOMETRY_KEYS = ("dx", "dy", "dtheta_deg", "covariance")


def parse_json_lines(text: str, path: Path) -> list[ScanRecord]:
    """Read one scan from every line that is not blank; raises `ScanFileError`."""
    return [
        parse_json_line(line, Place(path, number))
        for number, line in enumerate(text.split("\n"), start=1)
        if line.strip()
    ]


def parse_json_line(line: str, place: Place) -> ScanRecord:
    """Read the one scan of a line; raises `ScanFileError` that names the place."""
    values = _load(line, place)
    if not isinstance(values, dict):
        raise place.error("line", f"{_kind(values)}", 'give one object {"bearings_deg": [...]}')
    _check_keys(values, SCAN_KEYS, ("bearings_deg",), "", place)
    bearings = _numbers(values["bearings_deg"], "bearings_deg", place)
    odometry = values.get("odometry")
    try:
        scan = BearingScan(
            np.array([math.radians(bearing) for bearing in bearings]),
            time=_optional_number(values.get("time"), "time", place),
            sigma=_sigma(values.get("sigma_deg"), place),
            labels=_labels(values.get("labels"), place),
            odometry=None if odometry is None else _odometry(odometry, place),
        )
    except MeasurementError as cause:
        raise place.measurement_error(cause) from cause
    landmarks = _landmarks(values.get("landmarks"), place)
    if landmarks is not None:
        check_landmarks(landmarks, len(scan), place)
    return ScanRecord(scan, landmarks, place.line)


def format_json_lines(
    scans: Sequence[BearingScan], landmarks: Sequence[Sequence[int]] | None
) -> str:
    """Return the text of the file, one line a scan; `landmarks` are the true ids of each scan."""
    lines = []
    for i, scan in enumerate(scans):
        values: dict[str, Any] = {}
        if scan.time is not None:
            values["time"] = scan.time
        values["bearings_deg"] = _degrees(scan.bearings)
        if scan.sigma is not None:
            sigmas = _degrees(scan.sigma)
            values["sigma_deg"] = sigmas[0] if len(set(sigmas)) == 1 else sigmas
        if scan.labels is not None:
            values["labels"] = list(scan.labels)
        if scan.odometry is not None:
            values["odometry"] = _odometry_values(scan.odometry)
        if landmarks is not None:
            values["landmarks"] = list(landmarks[i])
        lines.append(json.dumps(values, allow_nan=False) + "\n")
    return "".join(lines)


def _load(line: str, place: Place) -> object:
    def refuse_constant(name: str) -> object:
        raise place.error("line", f"{name} is no number of JSON", "give finite numbers")

    def unique_keys(pairs: list[tuple[str, object]]) -> dict[str, object]:
        keys = [key for key, _ in pairs]
        for key in keys:
            if keys.count(key) > 1:
                raise place.error(key, "the key is there twice", "give it once")
        return dict(pairs)

    try:
        return json.loads(line, parse_constant=refuse_constant, object_pairs_hook=unique_keys)
    except json.JSONDecodeError as cause:
        raise place.error(
            f"column {cause.colno}", f"not JSON ({cause.msg})", "give one JSON object a line"
        ) from None
    except ScanFileError:
        raise
    except ValueError:  # Python refuses to convert thousands of digits
        raise place.error("line", "a number of too many digits", "give finite numbers") from None
    except RecursionError:
        raise place.error("line", "nested too deeply", "give one flat object a line") from None


def _check_keys(
    values: dict[str, object],
    known: tuple[str, ...],
    needed: tuple[str, ...],
    prefix: str,
    place: Place,
) -> None:
    for key in values:
        if key not in known:
            raise place.error(prefix + key, "unknown key", f"use {', '.join(known)}")
    for key in needed:
        if key not in values:
            raise place.error(prefix + key, "missing", "it is needed here")


def _number(value: object, field: str, place: Place) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise place.error(field, f"{_kind(value)}", "give a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise place.error(field, "not finite", "give a finite number")
    return number


def _optional_number(value: object, field: str, place: Place) -> float | None:
    return None if value is None else _number(value, field, place)


def _numbers(value: object, field: str, place: Place) -> list[float]:
    return [
        _number(entry, f"{field}[{i}]", place)
        for i, entry in enumerate(_list(value, field, "numbers", place))
    ]


def _list(value: object, field: str, of: str, place: Place) -> list[object]:
    if not isinstance(value, list):
        raise place.error(field, f"{_kind(value)}", f"give a list of {of}")
    return value


def _sigma(value: object, place: Place) -> FloatArray | float | None:
    if value is None:
        return None
    if isinstance(value, list):
        sigmas = _numbers(value, "sigma_deg", place)
        return np.array([math.radians(sigma) for sigma in sigmas])
    return math.radians(_number(value, "sigma_deg", place))


def _labels(value: object, place: Place) -> list[str | None] | None:
    if value is None:
        return None
    labels: list[str | None] = []
    for i, label in enumerate(_list(value, "labels", "strings and nulls", place)):
        if label is not None and not isinstance(label, str):
            raise place.error(f"labels[{i}]", f"{_kind(label)}", "give a string or null")
        labels.append(label)
    return labels


def _landmarks(value: object, place: Place) -> tuple[int, ...] | None:
    if value is None:
        return None
    ids: list[int] = []
    for i, entry in enumerate(_list(value, "landmarks", "whole numbers", place)):
        if isinstance(entry, bool) or not isinstance(entry, int):
            raise place.error(f"landmarks[{i}]", f"{_kind(entry)}", "give a whole number")
        ids.append(entry)
    return tuple(ids)


def _odometry(value: object, place: Place) -> Odometry:
    if not isinstance(value, dict):
        raise place.error("odometry", f"{_kind(value)}", f"give {', '.join(ODOMETRY_KEYS)}")
    _check_keys(value, ODOMETRY_KEYS, ("dx", "dy", "dtheta_deg"), "odometry.", place)
    covariance = value.get("covariance")
    return Odometry(
        dx=_number(value["dx"], "odometry.dx", place),
        dy=_number(value["dy"], "odometry.dy", place),
        dtheta=math.radians(_number(value["dtheta_deg"], "odometry.dtheta_deg", place)),
        covariance=None if covariance is None else _covariance(covariance, place),
    )


def _covariance(value: object, place: Place) -> FloatArray:
    """Read nine numbers, nested or flat, or three variances: metres and radians."""
    field = "odometry.covariance"
    rows = _list(value, field, "3 variances, 9 numbers or 3 rows of 3", place)
    if all(isinstance(row, list) for row in rows) and len(rows) == 3:
        flat = [x for i, row in enumerate(rows) for x in _numbers(row, f"{field}[{i}]", place)]
        allowed: tuple[int, ...] = (9,)
        lengths = [len(row) for row in rows if isinstance(row, list)]
        if lengths != [3, 3, 3]:
            raise place.error(field, f"rows of {lengths} numbers", "give 3 rows of 3")
    else:
        flat = _numbers(value, field, place)
        allowed = (3, 9)
    if len(flat) not in allowed:
        raise place.error(field, f"{len(flat)} numbers", "give 3 variances or 9 numbers")
    return np.array(flat).reshape((3,) if len(flat) == 3 else (3, 3))


def _odometry_values(odometry: Odometry) -> dict[str, Any]:
    values: dict[str, Any] = {
        "dx": odometry.dx,
        "dy": odometry.dy,
        "dtheta_deg": exact_degrees(odometry.dtheta),
    }
    if odometry.covariance is not None:
        values["covariance"] = odometry.covariance.tolist()
    return values


def _degrees(radians: FloatArray) -> list[float]:
    return [exact_degrees(angle) for angle in radians.tolist()]


def _kind(value: object) -> str:
    names = {dict: "an object", list: "a list", str: "a string", bool: "true or false"}
    if value is None:
        return "null"
    return names.get(type(value), f"{value!r}")
