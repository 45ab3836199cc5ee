"""Regions in F_L and their intersection ratios for every choice of base cells and third cell.

All hypotheses share the two base detections of the middle scan, so a hypothesis only picks, for
each landmark and each pair of scans, one of few *options*: the detection in the pair's other scan,
or, for a pair that does not contain the middle scan, a detection in each of its scans.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.errors import OptionError
from mht_slam.measurements import BearingScan
from mht_slam.polygon.cones import Cells, cells, corners
from mht_slam.polygon.landmark_frame import Triple, base_cells_meet, landmark_frame_region
from mht_slam.polygon.ratio import Outlines, ratio_table

MAX_REGIONS = 200_000
"""The most regions in F_L of one pair of scans."""

MAX_RATIOS = 100_000_000
"""The most intersection ratios that are kept in memory for one base."""


@dataclass(frozen=True)
class PairOfScans:
    """One pair of scans: its columns in the associations, its cells, and a landmark's options.

    Attributes
    ----------
    columns : the two columns of the associations' tables.
    others : those of them that are not the middle scan's.
    cells : the pair's cells in its own F_R.
    cell_of : (middle detections, options) flat index of the cell that an option gives a landmark.
    detections : (options, len(others)) the detections an option stands for.
    clash : (options, options) whether two landmarks cannot have both options.
    """

    columns: tuple[int, int]
    others: tuple[int, ...]
    cells: Cells
    cell_of: IntArray
    detections: IntArray
    clash: BoolArray

    @classmethod
    def of(
        cls,
        scans: tuple[BearingScan, ...],
        columns: tuple[int, int],
        middle: int,
        *,
        epsilon: float,
        max_range: float,
    ) -> PairOfScans:
        """Build the pair of two of `scans`; column `middle` names the landmarks."""
        first, second = (scans[column] for column in columns)
        n_first, n_second = len(first), len(second)
        flat = np.arange(n_first * n_second).reshape(n_first, n_second)
        if middle in columns:
            cell_of = flat if middle == columns[0] else flat.T
            detections = np.arange(cell_of.shape[1])[:, None]
        else:
            cell_of = np.tile(flat.ravel(), (len(scans[middle]), 1))
            detections = np.column_stack(np.divmod(flat.ravel(), max(n_second, 1)))
        clash = (detections[:, None] == detections).any(axis=2)
        others = tuple(column for column in columns if column != middle)
        both = cells(first.bearings, second.bearings, epsilon=epsilon, max_range=max_range)
        return cls(columns, others, both, cell_of, detections, clash)

    @cached_property
    def filled(self) -> BoolArray:
        """Flat, whether a cell has area."""
        return self.cells.filled.ravel()


@dataclass(frozen=True)
class ThirdLandmark:
    """Intersection ratios of one third landmark for one base.

    Attributes
    ----------
    index_first, index_second : (options, options, options) row, or column, of `ratios` for the
        options of first base landmark, second base landmark and third; the last one, which holds
        zeros, where there is no region.
    ratios : intersection ratio of the region from the first pair with that from the second.
    """

    index_first: IntArray
    index_second: IntArray
    ratios: FloatArray


def third_landmarks(
    pairs: tuple[PairOfScans, PairOfScans],
    base: tuple[int, int],
    *,
    ratio: str,
    region: str,
) -> dict[int, ThirdLandmark]:
    """Ratios of all third landmarks, by their detection in the middle scan.

    Raises `OptionError` beyond `MAX_REGIONS` or `MAX_RATIOS`, where labels let many detections
    through that exhaustive tables have no room for.
    """
    (regions_1, index_1), (regions_2, index_2) = (
        _pair_regions(pair, base, region) for pair in pairs
    )
    tables = {}
    n_ratios = 0
    for landmark in range(len(pairs[0].cell_of)):
        if landmark in base:
            continue
        chosen_1, local_1 = _of_landmark(index_1, pairs[0].cell_of[landmark])
        chosen_2, local_2 = _of_landmark(index_2, pairs[1].cell_of[landmark])
        n_ratios += len(chosen_1) * len(chosen_2)
        if n_ratios > MAX_RATIOS:
            raise _too_large(f"{MAX_RATIOS:,} intersection ratios")
        ratios = np.zeros((len(chosen_1) + 1, len(chosen_2) + 1))
        ratios[:-1, :-1] = ratio_table(regions_1[chosen_1], regions_2[chosen_2], ratio)
        tables[landmark] = ThirdLandmark(local_1, local_2, ratios)
    return tables


def _pair_regions(
    pair: PairOfScans, base: tuple[int, int], region: str
) -> tuple[Outlines, IntArray]:
    """All regions of one pair, and their index by (option, option, third cell), -1 for none."""
    n_options, n_cells = len(pair.clash), len(pair.filled)
    polygons = pair.cells.polygons.ravel()
    outlines = {int(c): corners(polygons[c]) for c in np.flatnonzero(pair.filled)}
    others = [m for m in range(len(pair.cell_of)) if m not in base]
    possible = np.zeros(n_cells, dtype=np.bool_)
    index = np.full((n_options, n_options, n_cells), -1, dtype=np.int64)
    triples: list[Triple] = []
    for o1, o2 in base_options(pair, base):
        free = ~(pair.clash[o1] | pair.clash[o2])
        possible[:] = False
        possible[pair.cell_of[others][:, free]] = True
        thirds = np.flatnonzero(possible & pair.filled)
        index[o1, o2, thirds] = len(triples) + np.arange(len(thirds))
        first, second = (outlines[pair.cell_of[b, o]] for b, o in zip(base, (o1, o2), strict=True))
        triples += [Triple(first, second, outlines[third]) for third in thirds.tolist()]
        if len(triples) > MAX_REGIONS:
            raise _too_large(f"{MAX_REGIONS:,} regions in F_L")
    regions = Outlines.of([landmark_frame_region(triple, region) for triple in triples])
    return regions, index


def _too_large(size: str) -> OptionError:
    return OptionError(
        f'method "exhaustive" would need more than {size}: rank fewer detections, or take a '
        "smaller epsilon"
    )


def base_options(pair: PairOfScans, base: tuple[int, int]) -> IntArray:
    """(N, 2) options of the two base landmarks whose cells exist and are disjoint."""
    first, second = pair.cell_of[base[0]], pair.cell_of[base[1]]
    possible = pair.filled[first][:, None] & pair.filled[second][None, :] & ~pair.clash
    options = np.argwhere(possible)
    polygons = pair.cells.polygons.ravel()
    meet = base_cells_meet(polygons[first[options[:, 0]]], polygons[second[options[:, 1]]])
    return options[~meet]


def _of_landmark(index: IntArray, cell_of: IntArray) -> tuple[IntArray, IntArray]:
    """Regions of one landmark, and their numbers by (option, option, option of the landmark)."""
    whole = index[:, :, cell_of]
    chosen = np.unique(whole[whole >= 0])
    local = np.where(whole >= 0, np.searchsorted(chosen, whole), len(chosen))
    return chosen, local
