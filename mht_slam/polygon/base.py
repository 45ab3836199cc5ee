"""Which two landmarks carry F_L: the base pair."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.errors import OptionError

_DECIMALS = 12


def choose_base(bearings: FloatArray, among: Sequence[int]) -> tuple[int, int]:
    """Return the two detections of the middle scan that are to be the base landmarks.

    They maximise ``|sin(b_i - b_j)| * min(|sin b_i|, |sin b_j|)`` over the detections `among`
    (increasing indices), so both are seen sideways and well apart; ties go to the smallest
    indices. `bearings` (n,) are radians from the direction of travel. Only the middle scan counts,
    so all hypotheses share the choice. Source: docs/method.md, section 3.

    >>> choose_base(np.array([0.1, 1.5, -0.2, 0.8]), range(4))
    (1, 3)
    """
    sideways = np.abs(np.sin(bearings))

    def quality(pair: tuple[int, int]) -> float:
        i, j = pair
        apart = abs(np.sin(bearings[i] - bearings[j]))
        return round(float(apart * min(sideways[i], sideways[j])), _DECIMALS)

    return max(combinations(among, 2), key=quality)


def given_base(base: object, n_detections: int) -> tuple[int, int]:
    """Validate a base the caller gave: two different detections of the middle scan, in order."""
    remedy = f"give two different detections of the middle scan, 0 to {n_detections - 1}"
    if not isinstance(base, (tuple, list)) or len(base) != 2:
        raise OptionError(f"base is {base!r}: {remedy}")
    for index in base:
        if isinstance(index, bool) or not isinstance(index, (int, np.integer)):
            raise OptionError(f"base is {base!r}: {remedy}")
    i, j = int(base[0]), int(base[1])
    if i == j or not (0 <= i < n_detections and 0 <= j < n_detections):
        raise OptionError(f"base is {base!r}: {remedy}")
    return i, j
