"""Array types, and the checks that stand at the border of the library.

Arrays that belong to a value are float64 or int64, owned by it, and read-only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from mht_slam.errors import MhtSlamError, OptionError

FloatArray: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]


def finite_array(
    value: npt.ArrayLike, name: str, error: type[MhtSlamError], *, remedy: str
) -> FloatArray:
    """Copy `value` into a read-only float64 array of finite numbers.

    Raises `error`, naming the first offending entry and the `remedy`, for anything that is not
    numeric or not finite. The shape is left to the caller.
    """
    try:
        raw = np.asarray(value)
    except ValueError as cause:  # ragged nesting
        raise error(f"{name} is not a rectangular array of numbers: {remedy}") from cause
    if raw.dtype.kind not in "iuf" and raw.size:
        entries = np.asarray(value, dtype=object)
        for index in np.ndindex(entries.shape):
            if not _is_real(entries[index]):
                raise error(f"{_place(name, index)} is {entries[index]!r}, no number: {remedy}")
        raise error(f"{name} holds {raw.dtype} values where numbers are needed: {remedy}")
    with np.errstate(over="ignore"):  # a wider float beyond every double becomes inf
        array = np.array(raw, dtype=np.float64)
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        index = tuple(bad[0].tolist())
        raise error(f"{_place(name, index)} is {array[index]}: {remedy}")
    return freeze(array)


def freeze(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Make `array` read-only in place and return it."""
    array.flags.writeable = False
    return array


def finite_number(
    value: object,
    name: str,
    *,
    above: float = -math.inf,
    at_least: float = -math.inf,
    below: float = math.inf,
    at_most: float = math.inf,
    error: type[MhtSlamError] = OptionError,
) -> float:
    """Return `value` as a float inside the stated bounds, or raise `error` naming them."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise error(f"{name} is {value!r}: give a number")
    try:
        number = float(value)
    except OverflowError:  # a whole number beyond every float
        number = math.inf
    if not (math.isfinite(number) and above < number < below and at_least <= number <= at_most):
        bounds = [
            f"{word} {bound:g}"
            for word, bound in (
                ("above", above),
                ("at least", at_least),
                ("below", below),
                ("at most", at_most),
            )
            if math.isfinite(bound)
        ]
        raise error(f"{name} is {number}: give a finite number {' and '.join(bounds)}".rstrip())
    return number


def whole_number(
    value: object, name: str, *, at_least: int, error: type[MhtSlamError] = OptionError
) -> int:
    """Return `value` as an int of at least `at_least`, or raise `error` naming the field."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < at_least:
        raise error(f"{name} is {value!r}: give a whole number of at least {at_least}")
    return int(value)


def one_of(value: object, name: str, choices: Sequence[str]) -> None:
    """Raise `OptionError` naming the option and its choices, unless `value` is one of them."""
    if not isinstance(value, str) or value not in choices:
        raise OptionError(f"{name} is {value!r}: give one of {', '.join(map(repr, choices))}")


def _is_real(entry: object) -> bool:
    return isinstance(entry, (int, float, np.integer, np.floating)) and not isinstance(entry, bool)


def _place(name: str, index: tuple[int, ...]) -> str:
    return f"{name}[{', '.join(map(str, index))}]" if index else name
