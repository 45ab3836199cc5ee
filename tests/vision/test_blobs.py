"""Components are those of a panorama closed round its seam; a valley cuts touching cones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from mht_slam.arrays import BoolArray
from mht_slam.vision.blobs import Blob, connected_blobs, parts

WIDTH = 60


def flood(matching: BoolArray) -> set[frozenset[tuple[int, int]]]:
    """The slow, obvious components: neighbours of neighbours, columns round the seam."""
    width = matching.shape[1]
    left = {(int(r), int(c)) for r, c in np.argwhere(matching)}
    components = set()
    while left:
        frontier = [left.pop()]
        members = set(frontier)
        while frontier:
            row, column = frontier.pop()
            for down in (-1, 0, 1):
                for right in (-1, 0, 1):
                    place = (row + down, (column + right) % width)
                    if place in left:
                        left.remove(place)
                        members.add(place)
                        frontier.append(place)
        components.add(frozenset(members))
    return components


def has_gap(component: frozenset[tuple[int, int]]) -> bool:
    """Whether it is narrow enough to be a landmark, and without holes to be filled."""
    columns = sorted({column for _, column in component})
    gaps = np.diff([*columns, columns[0] + WIDTH])
    return WIDTH - gaps.max() < WIDTH // 2 - 10


@given(arrays.arrays(np.bool_, (3, WIDTH), elements=st.sampled_from([True, False, False, False])))
def test_blobs_are_the_components_of_the_closed_panorama(matching: BoolArray) -> None:
    expected = {component for component in flood(matching) if has_gap(component)}
    found = set()
    for blob in connected_blobs(matching, min_area=1):
        window = matching[np.ix_(blob.rows, blob.columns % WIDTH)]
        own = np.argwhere(blob.mask & window)
        found.add(frozenset((int(blob.rows[r]), int(blob.columns[c]) % WIDTH) for r, c in own))
        assert np.array_equal(window & ~blob.mask, blob.others)
    assert found == expected


def test_holes_are_filled_and_small_blobs_are_left_out() -> None:
    matching = np.zeros((20, 100), dtype=np.bool_)
    matching[5:12, 30:37] = True
    matching[8, 33] = False
    matching[3, 80] = True
    (blob,) = connected_blobs(matching, min_area=5)
    assert (blob.area, blob.height, blob.width) == (49, 7, 7)


def test_a_band_all_around_is_no_blob() -> None:
    matching = np.zeros((20, 100), dtype=np.bool_)
    matching[5:8] = True
    assert list(connected_blobs(matching, min_area=1)) == []


def cones(apart: int, second_height: int = 20) -> Blob:
    """Two cones of slope 2 whose axes are `apart` columns from each other."""
    columns = np.arange(-20, 60)
    rows = np.arange(40)
    above = np.maximum(20 - 2 * np.abs(columns), second_height - 2 * np.abs(columns - apart))
    mask = rows[:, None] >= 40 - above
    return Blob(rows, columns, mask, np.zeros_like(mask))


def test_two_cones_that_touch_are_cut_at_the_valley() -> None:
    pieces = parts(cones(12))
    assert len(pieces) == 2
    assert all(piece.touching for piece in pieces)
    whole = cones(12).mask
    assert np.array_equal(pieces[0].mask | pieces[1].mask, whole)
    assert not (pieces[0].mask & pieces[1].mask).any()
    assert np.array_equal(pieces[0].others, pieces[1].mask)
    assert pieces[0].columns[pieces[0].mask.any(axis=0)].max() == 5


@pytest.mark.parametrize("blob", [cones(0), cones(3), cones(7, second_height=8)])
def test_without_a_valley_there_is_one_blob(blob: Blob) -> None:
    assert parts(blob) == [blob]
