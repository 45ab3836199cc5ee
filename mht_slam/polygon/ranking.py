"""`rank`: the polygon method from options to the ordered list of hypotheses."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial

import numpy as np

from mht_slam.arrays import IntArray, finite_number, one_of, whole_number
from mht_slam.association import MISSED, Association, refuse_unequal
from mht_slam.errors import OptionError, TooFewLandmarksError
from mht_slam.hypotheses import RankedAssociation, Ranking
from mht_slam.measurements import BearingScan, RunPair, StraightRun, scan_selection
from mht_slam.polygon.base import choose_base, given_base
from mht_slam.polygon.best import Listing
from mht_slam.polygon.exact import exact_search
from mht_slam.polygon.exhaustive import exhaustive_search
from mht_slam.polygon.landmark_frame import REGIONS, base_cells_meet
from mht_slam.polygon.problem import MIN_LANDMARKS, Problem, cell_exists
from mht_slam.polygon.ratio import RATIOS
from mht_slam.polygon.tables import PairOfScans
from mht_slam.polygon.unified_map import MapRecipe, draw_map
from mht_slam.progress import Progress

DEFAULT_SCANS = (0, 1, 2)
MAX_DETECTIONS = 100
"""The most detections of one scan: a scan has a cell with each detection of the next."""

MAX_RANGE = 1e6
"""The largest `max_range`, baselines: cells cut farther out lose their near corners to rounding."""

METHODS = ("exact", "exhaustive")

WORK_LIMIT = 5_000_000
"""Default limit on the steps of an exact search."""

_RIGHT_ANGLE = np.pi / 2.0


def rank(
    run: StraightRun | RunPair,
    *,
    epsilon: float,
    top_k: int | None = 10,
    method: str = "exact",
    ratio: str = "iou",
    region: str = "edges",
    base: tuple[int, int] | None = None,
    max_range: float = 100.0,
    scans: Sequence[int] = DEFAULT_SCANS,
    max_missed: int = 0,
    max_false: int = 0,
    include_zero: bool = False,
    refine_pair: tuple[int, int] | None = None,
    work_limit: int = WORK_LIMIT,
    progress: Progress | None = None,
) -> Ranking:
    """Rank associations by the paper's polygon method, best first.

    A hypothesis gives each landmark a cell in both pairs of scans: (O1, O2) and (O2, O3) of a
    `StraightRun`, the two runs of a `RunPair`. Both pairs are moved to F_L, the frame of two base
    landmarks, where the score is the geometric mean of the intersection ratios of all other
    landmarks' regions. Zero if any ratio is zero, a cell is empty, or base cells overlap.

    Parameters
    ----------
    run : what was seen. Forward is the direction of travel.
    epsilon : the vision error, radians, in (0, pi/2): half the opening of every cone.
    top_k : how many hypotheses to list; None means all.
    method : "exact" searches for the head of the list and proves it; "exhaustive" goes through all
        hypotheses, (n!)^2 for a run and (n!)^3 for a pair. Both list the same.
    ratio : "iou", intersection over union, or "overlap", intersection over the smaller area.
    region : "edges", an outer bound of each region's convex hull, its area at most half a per cent
        too large; or "vertices", combinations of the cells' corners only.
    base : detections of the middle scan (of s2 for a `RunPair`) at (0, 0) and (1, 0) of F_L; None
        chooses them by the rule of docs/method.md, section 3.
    max_range : baselines of each pair, about that pair's midpoint, at which cells are cut; at most
        1e6.
    scans : indices of three scans of a `StraightRun`, in order of travel.
    max_missed : the most -1 entries of a table. 0 ranks full tables only.
    max_false : the most detections that belong to no landmark.
    include_zero : list associations of score zero too, with the reason.
    refine_pair : first and last of `scans`: that pair's regions refine the map, not the score.
    work_limit : the most steps of the exact search: choices of base cells bounded, intersection
        ratios computed, partial hypotheses extended; some hundred thousand a second. Where they do
        not suffice, the ranking is not `complete`; its `gap` says how much better an unlisted
        hypothesis can be.
    progress : called with the work done and its total so far, now and then: hypotheses, or for
        "exact" choices of base cells.

    Labels of the scans are hard constraints: an association that contradicts them is not listed.
    With `max_missed` or `max_false`, associations with more landmarks seen in every scan come
    first, and only these landmarks are scored; others must have a cell where a pair sees them.

    Raises `OptionError` for options outside these, or more hypotheses than can be gone through;
    `UnequalScansError` where scans differ in length more than `max_missed` and `max_false` allow;
    `TooFewLandmarksError` where no three landmarks can be seen in every scan; `MeasurementError`
    for `scans` that do not exist. Source: the paper's section 3; docs/method.md, section 3.

    >>> import numpy as np
    >>> from mht_slam.measurements import BearingScan, StraightRun
    >>> landmarks = np.array([[1.0, 3.0], [2.0, -2.0], [3.5, 1.5]])
    >>> run = StraightRun(
    ...     BearingScan(np.arctan2(landmarks[:, 1], landmarks[:, 0] - x)) for x in (0.0, 1.0, 2.2)
    ... )
    >>> ranking = rank(run, epsilon=np.deg2rad(3))
    >>> ranking[0].association.table.tolist()
    [[0, 0, 0], [1, 1, 1], [2, 2, 2]]
    >>> [region.name for region in ranking[0].map_in_landmark_frame.observation_points]
    ['O1', 'O2', 'O3']
    """
    if not isinstance(run, (StraightRun, RunPair)):
        raise OptionError(f"run is {type(run).__name__}: give a StraightRun or a RunPair")
    finite_number(epsilon, "epsilon", above=0.0, below=_RIGHT_ANGLE)
    finite_number(max_range, "max_range", above=0.0, at_most=MAX_RANGE)
    if top_k is not None:
        whole_number(top_k, "top_k", at_least=1)
    whole_number(max_missed, "max_missed", at_least=0)
    whole_number(max_false, "max_false", at_least=0)
    whole_number(work_limit, "work_limit", at_least=1)
    one_of(method, "method", METHODS)
    one_of(ratio, "ratio", RATIOS)
    one_of(region, "region", REGIONS)
    chosen, columns, middle = _selection(run, scans)
    refining = _refining_columns(run, chosen, refine_pair)
    members = tuple(run.scans[scan] for scan in chosen)
    full_base = _checked(members, middle, base, max_missed, max_false)
    problem = Problem(
        scans=members,
        pairs=(
            PairOfScans.of(members, columns[0], middle, epsilon=epsilon, max_range=max_range),
            PairOfScans.of(members, columns[1], middle, epsilon=epsilon, max_range=max_range),
        ),
        middle=middle,
        base=None if base is None else full_base,
        ratio=ratio,
        region=region,
        top_k=top_k,
        max_missed=max_missed,
        max_false=max_false,
        include_zero=include_zero,
    )
    if method == "exact":
        listing = exact_search(problem, min(work_limit, sys.maxsize), progress)
    else:
        listing = exhaustive_search(problem, progress)
    recipe = MapRecipe(
        bearings=tuple(scan.bearings for scan in members),
        scans=chosen,
        pairs=columns + refining,
        n_ranked=len(columns),
        epsilon=epsilon,
        max_range=max_range,
        region=region,
    )
    return Ranking(
        hypotheses=tuple(_ranked(problem, recipe, score, table) for score, table in listing.listed),
        scans=chosen,
        base=full_base,
        complete=listing.complete,
        gap=_gap(listing),
        epsilon=float(epsilon),
        options={
            "top_k": top_k,
            "method": method,
            "ratio": ratio,
            "region": region,
            "base": base,
            "max_range": max_range,
            "max_missed": max_missed,
            "max_false": max_false,
            "include_zero": include_zero,
            "refine_pair": refine_pair,
            "work_limit": work_limit,
        },
        n_scored=listing.n_scored,
        n_steps=listing.n_steps,
    )


def _gap(listing: Listing) -> float:
    """How far an unlisted score can exceed the last one listed."""
    last = listing.listed[-1][0] if listing.listed else 0.0
    return 0.0 if listing.complete else max(listing.bound - last, 0.0)


def _selection(
    run: StraightRun | RunPair, scans: Sequence[int]
) -> tuple[tuple[int, ...], tuple[tuple[int, int], tuple[int, int]], int]:
    """Scans of the columns, columns of the two pairs, and the column that names the landmarks."""
    if isinstance(run, StraightRun):
        return scan_selection(scans, len(run), exactly=3), ((0, 1), (1, 2)), 1
    if not isinstance(scans, Sequence) or tuple(scans) not in (DEFAULT_SCANS, (0, 1, 2, 3)):
        raise OptionError(f"scans is {scans!r}: a RunPair is ranked over all its scans, leave it")
    return (0, 1, 2, 3), ((0, 1), (2, 3)), 1


def _refining_columns(
    run: StraightRun | RunPair, chosen: tuple[int, ...], refine_pair: tuple[int, int] | None
) -> tuple[tuple[int, int], ...]:
    if refine_pair is None:
        return ()
    if isinstance(run, RunPair):
        raise OptionError("refine_pair refines the map of a StraightRun: leave it for a RunPair")
    if not isinstance(refine_pair, Sequence) or tuple(refine_pair) != (chosen[0], chosen[2]):
        raise OptionError(
            f"refine_pair is {refine_pair!r}: give the first and the last scan ranked, "
            f"{(chosen[0], chosen[2])}"
        )
    return ((0, 2),)


def _checked(
    members: tuple[BearingScan, ...],
    middle: int,
    base: tuple[int, int] | None,
    max_missed: int,
    max_false: int,
) -> tuple[int, int]:
    """Check the numbers of detections and the base; return the base of full tables."""
    counts = [len(scan) for scan in members]
    if max(counts) > MAX_DETECTIONS:
        raise OptionError(
            f"the scans have {counts} detections: at most {MAX_DETECTIONS} a scan can be ranked, "
            "rank fewer"
        )
    refuse_unequal(counts, max_missed, max_false)
    if min(counts) < MIN_LANDMARKS:
        raise TooFewLandmarksError(
            f"the scans have {counts} detections: at least {MIN_LANDMARKS} landmarks must be seen "
            "in every scan, two carry the frame and the others are compared"
        )
    if base is not None:
        return given_base(base, counts[middle])
    return choose_base(members[middle].bearings, range(counts[middle]))


def _ranked(
    problem: Problem, recipe: MapRecipe, score: float, table: IntArray
) -> RankedAssociation:
    association = Association(table, problem.n_detections)
    table = association.table
    full = table[(table != MISSED).all(axis=1)]
    seen = tuple(sorted(full[:, problem.middle].tolist()))
    base = problem.base_among(seen)
    rows = None if base is None else _rows_of(table[:, problem.middle], base)
    no_frame = _why_no_frame(problem, table, seen, rows)
    reason = None
    if score == 0.0:
        reason = no_frame or _why_zero(problem, table)
    return RankedAssociation(
        association=association,
        score=score,
        base=base,
        zero_reason=reason,
        _draw_map=None if no_frame or rows is None else partial(draw_map, recipe, table, rows),
    )


def _rows_of(column: IntArray, base: tuple[int, int]) -> tuple[int, int]:
    first, second = (int(np.flatnonzero(column == detection)[0]) for detection in base)
    return first, second


def _why_no_frame(
    problem: Problem, table: IntArray, seen: tuple[int, ...], base: tuple[int, int] | None
) -> str | None:
    """Why F_L does not exist, or None."""
    if len(seen) < MIN_LANDMARKS:
        return f"fewer than {MIN_LANDMARKS} landmarks are seen in every scan"
    if base is None:
        return "a base landmark is not seen in every scan"
    for pair in problem.pairs:
        name = _name(pair)
        places = [(table[row, pair.columns[0]], table[row, pair.columns[1]]) for row in base]
        if not all(pair.cells.filled[place] for place in places):
            return f"a base cell of {name} is empty"
        first, second = (np.array([pair.cells.polygons[p]], dtype=np.object_) for p in places)
        if base_cells_meet(first, second)[0]:
            return f"the base cells of {name} overlap"
    return None


def _why_zero(problem: Problem, table: IntArray) -> str:
    for number, row in enumerate(table):
        if not cell_exists(problem, row):
            return f"a cell of landmark {number} is empty"
    return "a landmark's regions in the two pairs do not meet"


def _name(pair: PairOfScans) -> str:
    first, second = pair.columns
    return f"pair (O{first + 1}, O{second + 1})"
