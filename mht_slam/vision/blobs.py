"""Connected pixels of the cones' colour, across the seam, and the cut between touching cones."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import binary_fill_holes, label
from scipy.signal import find_peaks

from mht_slam.arrays import BoolArray, IntArray

CORNERS_TOO = np.ones((3, 3), dtype=np.int64)
"""Pixels that meet at a corner are connected."""

MARGIN = 5
"""Pixels around a blob, which hold its rim and its background."""

VALLEY_DEPTH = 0.3
"""A valley of the height profile cuts where it is deeper than this share of the lower peak."""
SHALLOWEST_VALLEY = 2
"""A valley of fewer pixels than this is roughness of the edge."""


@dataclass(frozen=True, eq=False)
class Blob:
    """Connected pixels in a window of the panorama that has no seam.

    Attributes
    ----------
    rows : (h,) rows of the window, inside the panorama.
    columns : (w,) columns of the window, consecutive; they may run past either edge.
    mask : (h, w) the blob's pixels, holes filled.
    others : (h, w) pixels of the cones' colour that are not the blob's.
    touching : whether it was cut from a neighbour.
    """

    rows: IntArray
    columns: IntArray
    mask: BoolArray
    others: BoolArray
    touching: bool = False

    @property
    def height(self) -> int:
        """Rows from its highest to its lowest pixel."""
        return int(np.ptp(np.flatnonzero(self.mask.any(axis=1)))) + 1

    @property
    def width(self) -> int:
        """Columns from its first to its last pixel."""
        return int(np.ptp(np.flatnonzero(self.mask.any(axis=0)))) + 1

    @property
    def area(self) -> int:
        """Number of pixels."""
        return int(self.mask.sum())


def connected_blobs(matching: BoolArray, min_area: int) -> Iterator[Blob]:
    """Yield the blobs of a panorama's matching pixels (rows, columns) of at least `min_area`.

    Pixels are connected by sides and corners, and across the seam between the last column and the
    first. A blob that goes round more than half of the panorama is left out: it is no landmark.
    """
    height, width = matching.shape
    for rows, columns in _components(matching):
        if len(rows) < min_area:
            continue
        unrolled = _unrolled(columns, width)
        if np.ptp(unrolled) >= width // 2 - 2 * MARGIN:
            continue
        first, last = int(unrolled.min()) - MARGIN, int(unrolled.max()) + MARGIN
        top, bottom = max(0, int(rows.min()) - MARGIN), min(height, int(rows.max()) + MARGIN + 1)
        window_rows, window_columns = np.arange(top, bottom), np.arange(first, last + 1)
        mask = np.zeros((len(window_rows), len(window_columns)), dtype=np.bool_)
        mask[rows - top, unrolled - first] = True
        here = matching[np.ix_(window_rows, window_columns % width)]
        filled = binary_fill_holes(mask)
        yield Blob(window_rows, window_columns, filled, here & ~filled)


def parts(blob: Blob) -> list[Blob]:
    """Cut a blob in which cones touch where its profile of heights has a valley.

    The profile counts the blob's pixels in each column: a single cone or post has one peak. Cones
    that overlap by so much that no valley is left stay one blob.
    """
    profile = blob.mask.sum(axis=0)
    cuts = _valleys(profile)
    if not cuts:
        return [blob]
    cut = []
    for first, last in pairwise([0, *cuts, len(profile)]):
        mask = np.zeros_like(blob.mask)
        mask[:, first:last] = blob.mask[:, first:last]
        others = blob.others | (blob.mask & ~mask)
        cut.append(Blob(blob.rows, blob.columns, mask, others, touching=True))
    return cut


def _valleys(profile: IntArray) -> list[int]:
    """Columns of the valleys between peaks, those too shallow to cut left out."""
    peaks = find_peaks(profile.astype(np.float64))[0].tolist()
    while len(peaks) > 1:
        valleys = [first + int(profile[first:last].argmin()) for first, last in pairwise(peaks)]
        lower = [int(min(profile[first], profile[last])) for first, last in pairwise(peaks)]
        depths = [peak - int(profile[valley]) for peak, valley in zip(lower, valleys, strict=True)]
        excess = [
            depth - max(SHALLOWEST_VALLEY, VALLEY_DEPTH * peak)
            for depth, peak in zip(depths, lower, strict=True)
        ]
        shallowest = int(np.argmin(excess))
        if excess[shallowest] >= 0.0:
            return valleys
        # The lower peak is a shoulder of its neighbour.
        second = profile[peaks[shallowest]] > profile[peaks[shallowest + 1]]
        peaks.pop(shallowest + int(second))
    return []


def _components(matching: BoolArray) -> Iterator[tuple[IntArray, IntArray]]:
    """Rows and columns of the pixels of each component."""
    labels, count = label(matching, structure=CORNERS_TOO)
    joined = _joined_across_seam(labels.astype(np.int64), count)
    rows, columns = np.nonzero(labels)
    names = joined[labels[rows, columns]]
    order = np.argsort(names, kind="stable")
    ends = np.flatnonzero(np.diff(names[order])) + 1
    for members in np.split(order, ends):
        if len(members):
            yield rows[members], columns[members]


def _joined_across_seam(labels: IntArray, count: int) -> IntArray:
    """Name (count + 1,) of each label's component, when the panorama is closed."""
    names = np.arange(count + 1)
    last, first = labels[:, -1], labels[:, 0]
    for shift in (-1, 0, 1):
        there = np.roll(first, shift)
        if shift == -1:
            there[-1] = 0
        elif shift == 1:
            there[0] = 0
        for left, right in zip(last.tolist(), there.tolist(), strict=True):
            if left and right and names[left] != names[right]:
                names[names == names[left]] = names[right]
    return names


def _unrolled(columns: IntArray, width: int) -> IntArray:
    """Columns moved by whole turns so that the blob has no seam: a gap lies outside of it."""
    present = np.unique(columns)
    gaps = np.diff(present, append=present[0] + width)
    start = int(present[(int(np.argmax(gaps)) + 1) % len(present)])
    return start + (columns - start) % width
