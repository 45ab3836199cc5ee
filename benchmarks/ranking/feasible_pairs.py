"""How many pairs of hypotheses an exhaustive ranking has to score: two permanents."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mht_slam import StraightRun
from mht_slam.polygon.cones import cells

LARGEST = 20
"""20! is the last factorial that 64 bits hold, and 2^20 sets of columns still fit in memory."""


def feasible_pairs(run: StraightRun, *, epsilon: float, max_range: float = 100.0) -> int | None:
    """Count the pairs of hypotheses whose cells all exist, or None beyond `LARGEST` landmarks.

    A hypothesis of one pair of scans is a perfect matching of its filled cells, so their number is
    the permanent of the matrix that says which cells are filled; the two pairs multiply. Source:
    docs/method.md, section 3.
    """
    first, second, third = (scan.bearings for scan in run.scans[:3])
    if max(len(first), len(second), len(third)) > LARGEST:
        return None
    filled = [
        cells(*pair, epsilon=epsilon, max_range=max_range).filled
        for pair in ((first, second), (second, third))
    ]
    return permanent(filled[0]) * permanent(filled[1])


def permanent(matrix: npt.NDArray[np.bool_]) -> int:
    """Number of perfect matchings of a square matrix of zeros and ones, at most `LARGEST` rows.

    Row by row, for all sets of columns at once: how often do the rows so far take just this set.
    Whole numbers throughout, where an alternating sum such as Ryser's cancels.
    """
    n = len(matrix)
    ways = np.zeros(1 << n, dtype=np.int64)
    ways[0] = 1
    for row in matrix:
        more = np.zeros_like(ways)
        for column in np.flatnonzero(row):
            without, with_it = (a.reshape(-1, 2, 1 << column) for a in (ways, more))
            with_it[:, 1] += without[:, 0]
        ways = more
    return int(ways[-1])
