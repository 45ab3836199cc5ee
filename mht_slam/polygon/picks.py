"""What third landmarks may pick, for one choice of base cells in both pairs of scans.

A *base pair* is a choice of both base landmarks' options in either pair of scans. A *pick* gives
one third landmark an option in either pair, and has an intersection ratio. Bounds come first,
regions only where they still matter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.compiled import compiled
from mht_slam.polygon.base_regions import BaseRegions, outline_row, ratio_bound, room_for
from mht_slam.polygon.ratio import intersection_ratio
from mht_slam.polygon.relaxation import price_detections, reduced

SLACK = 1e-9
"""How far a sum of log ratios may be off by rounding."""

FOUND, NONE, ROOM, SPENT = 0, 1, 2, 3
"""A base pair has picks; none is left; regions need room; no more ratios may be computed."""


class Choices(NamedTuple):
    """What the landmarks of one set may pick, labels included.

    Attributes
    ----------
    first, second : regions of both pairs for the base.
    thirds : (T,) places of the third landmarks in the regions' slots.
    allowed_1, allowed_2 : (T, O) which options each third landmark may have.
    base_allowed_1, base_allowed_2 : (B,) which options the base landmarks may have.
    linked : (O1, O2) which options of both pairs one landmark may have.
    detections_1, detections_2 : (O, columns) numbers of the detections behind an option, over all
        scans but the middle one.
    is_outer : (D,) whether a detection is one of theirs, among those of all scans.
    all_taken : whether hypotheses take all of them.
    of_union : whether the ratio is that over the union.
    """

    first: BaseRegions
    second: BaseRegions
    thirds: IntArray
    allowed_1: BoolArray
    allowed_2: BoolArray
    base_allowed_1: BoolArray
    base_allowed_2: BoolArray
    linked: BoolArray
    detections_1: IntArray
    detections_2: IntArray
    is_outer: BoolArray
    all_taken: bool
    of_union: bool


class Picks(NamedTuple):
    """The picks of one base pair; all arrays are rewritten for the next.

    Attributes
    ----------
    begin, end : (T,) where the picks of each third landmark are.
    options : (N, 2) option in either pair of scans.
    ratio, log_ratio : (N,) intersection ratio.
    value : (N,) log ratio less the prices of the detections; best first for each landmark.
    detections : (N, C) their numbers.
    price : (D,) prices of the detections; zero for those of the base landmarks.
    bound : (1,) what the sum of log ratios does not exceed.
    n_ratios : (1,) intersection ratios computed so far.
    """

    begin: IntArray
    end: IntArray
    options: IntArray
    ratio: FloatArray
    log_ratio: FloatArray
    value: FloatArray
    detections: IntArray
    price: FloatArray
    bound: FloatArray
    n_ratios: IntArray


def no_picks(choices: Choices) -> Picks:
    """Room for the picks of any base pair."""
    n_thirds = len(choices.thirds)
    n_each = choices.linked.size
    n_picks = n_thirds * n_each
    n_columns = choices.detections_1.shape[1] + choices.detections_2.shape[1]
    return Picks(
        begin=np.arange(n_thirds) * n_each,
        end=np.arange(n_thirds) * n_each,
        options=np.zeros((n_picks, 2), dtype=np.int64),
        ratio=np.zeros(n_picks),
        log_ratio=np.zeros(n_picks),
        value=np.zeros(n_picks),
        detections=np.zeros((n_picks, n_columns), dtype=np.int64),
        price=np.zeros(len(choices.is_outer)),
        bound=np.zeros(1),
        n_ratios=np.zeros(1, dtype=np.int64),
    )


@compiled
def base_pair_bounds(choices: Choices, b1: int) -> FloatArray:
    """(B2,) what the sum of log ratios does not exceed, for one choice of base cells in pair 1.

    -inf where one ratio is zero, or labels forbid the base.
    """
    first, second = choices.first, choices.second
    bounds = np.full(len(second.options), -np.inf)
    one = first.options[b1]
    for b2 in range(len(bounds)):
        other = second.options[b2]
        if not (
            choices.base_allowed_1[b1]
            and choices.base_allowed_2[b2]
            and choices.linked[one[0], other[0]]
            and choices.linked[one[1], other[1]]
        ):
            continue
        total = 0.0
        for t in range(len(choices.thirds)):
            total += _log_of_best_bound(choices, b1, b2, t)
            if total == -np.inf:
                break
        bounds[b2] = total
    return bounds


@compiled
def next_picks(
    choices: Choices,
    order: IntArray,
    bounds: FloatArray,
    place: int,
    needed: float,
    max_ratios: int,
    picks: Picks,
) -> tuple[int, int]:
    """Find the next base pair that can have a sum of log ratios of at least `needed`.

    `order` holds flat numbers of base pairs, `bounds` their bounds, best first; the search begins
    at `place`. Returns `FOUND`, `NONE`, `ROOM` or `SPENT` and the place reached. Writes the picks
    that can be part of such a sum; of others nothing is lost.
    """
    n_second = len(choices.second.options)
    room_1 = len(choices.first.outline_count) - room_for(choices.first, choices.allowed_1)
    room_2 = len(choices.second.outline_count) - room_for(choices.second, choices.allowed_2)
    while place < len(order) and bounds[place] >= needed - SLACK:
        if choices.first.n_outlines[0] > room_1 or choices.second.n_outlines[0] > room_2:
            return ROOM, place
        if picks.n_ratios[0] >= max_ratios:
            return SPENT, place
        b1, b2 = order[place] // n_second, order[place] % n_second
        if _find_picks(choices, b1, b2, needed, picks) and _price(choices, b1, b2, needed, picks):
            return FOUND, place
        place += 1
    return NONE, place


@compiled
def _log_of_best_bound(choices: Choices, b1: int, b2: int, t: int) -> float:
    """Logarithm of the largest bound on the ratios of one third landmark."""
    # The loops stand here and in `_picks_of`: as a function of its own the test of a pick is not
    # inlined, because `Choices` is large, and takes several times as long.
    best = 0.0
    third = choices.thirds[t]
    slots_1, slots_2 = choices.first.slot[b1, third], choices.second.slot[b2, third]
    for o1 in range(len(slots_1)):
        if slots_1[o1] < 0 or not choices.allowed_1[t, o1]:
            continue
        for o2 in range(len(slots_2)):
            if slots_2[o2] < 0 or not choices.allowed_2[t, o2] or not choices.linked[o1, o2]:
                continue
            bound = ratio_bound(
                choices.first, slots_1[o1], choices.second, slots_2[o2], choices.of_union
            )
            best = max(best, bound)
    return float(np.log(best))


@compiled
def _find_picks(choices: Choices, b1: int, b2: int, needed: float, picks: Picks) -> bool:
    """Write the picks of a base pair; False where no hypothesis of it is enough.

    Landmarks with the least bound come first: they are the likeliest to rule the base pair out.
    """
    n_thirds = len(choices.thirds)
    best = np.empty(n_thirds)
    for t in range(n_thirds):
        best[t] = _log_of_best_bound(choices, b1, b2, t)
    waiting = np.ones(n_thirds, dtype=np.bool_)
    for _ in range(n_thirds):
        t = _least(best, waiting)
        waiting[t] = False
        others = best.sum() - best[t]
        best[t] = _picks_of(choices, b1, b2, t, needed - SLACK - others, picks)
        if others + best[t] < needed - SLACK or best[t] == -np.inf:
            return False
    return True


@compiled
def _least(values: FloatArray, waiting: BoolArray) -> int:
    least, at = np.inf, 0
    for i in range(len(values)):
        if waiting[i] and values[i] < least:
            least, at = values[i], i
    return at


@compiled
def _picks_of(choices: Choices, b1: int, b2: int, t: int, least: float, picks: Picks) -> float:
    """Write the picks of one landmark with a log ratio of at least `least`; return the best."""
    first, second = choices.first, choices.second
    third = choices.thirds[t]
    slots_1, slots_2 = first.slot[b1, third], second.slot[b2, third]
    n_columns_1 = choices.detections_1.shape[1]
    count = picks.begin[t]
    best = -np.inf
    for o1 in range(len(slots_1)):
        if slots_1[o1] < 0 or not choices.allowed_1[t, o1]:
            continue
        for o2 in range(len(slots_2)):
            if slots_2[o2] < 0 or not choices.allowed_2[t, o2] or not choices.linked[o1, o2]:
                continue
            bound = ratio_bound(first, slots_1[o1], second, slots_2[o2], choices.of_union)
            if bound == 0.0 or np.log(bound) < least:
                continue
            picks.n_ratios[0] += 1
            row_1, row_2 = outline_row(first, slots_1[o1]), outline_row(second, slots_2[o2])
            ratio = intersection_ratio(
                first.outlines[row_1][: first.outline_count[row_1]],
                second.outlines[row_2][: second.outline_count[row_2]],
                first.outline_area[row_1],
                second.outline_area[row_2],
                choices.of_union,
            )
            if ratio == 0.0 or np.log(ratio) < least:
                continue
            picks.options[count, 0], picks.options[count, 1] = o1, o2
            picks.ratio[count], picks.log_ratio[count] = ratio, np.log(ratio)
            best = max(best, picks.log_ratio[count])
            for column in range(n_columns_1):
                picks.detections[count, column] = choices.detections_1[o1, column]
            for column in range(choices.detections_2.shape[1]):
                picks.detections[count, n_columns_1 + column] = choices.detections_2[o2, column]
            count += 1
    picks.end[t] = count
    return best


@compiled
def _price(choices: Choices, b1: int, b2: int, needed: float, picks: Picks) -> bool:
    """Price the detections and drop the picks that these rule out; False where none is left."""
    is_open = choices.is_outer.copy()
    for base in range(2):
        for detection in choices.detections_1[choices.first.options[b1, base]]:
            is_open[detection] = False
        for detection in choices.detections_2[choices.second.options[b2, base]]:
            is_open[detection] = False
    bound = price_detections(
        picks.begin,
        picks.end,
        picks.detections,
        picks.log_ratio,
        needed - SLACK,
        is_open,
        choices.all_taken,
        picks.price,
    )
    picks.bound[0] = bound
    if bound < needed - SLACK:
        return False
    for t in range(len(choices.thirds)):
        best = -np.inf
        for pick in range(picks.begin[t], picks.end[t]):
            picks.value[pick] = reduced(picks.log_ratio[pick], picks.detections[pick], picks.price)
            best = max(best, picks.value[pick])
        kept = picks.begin[t]
        for pick in range(picks.begin[t], picks.end[t]):
            if bound - best + picks.value[pick] >= needed - SLACK:
                _exchange(picks, pick, kept)
                kept += 1
        picks.end[t] = kept
        _sort(picks, picks.begin[t], kept)
    return True


@compiled
def _sort(picks: Picks, begin: int, end: int) -> None:
    """Best value first, by insertion: there are few."""
    for i in range(begin + 1, end):
        j = i
        while j > begin and picks.value[j - 1] < picks.value[j]:
            _exchange(picks, j - 1, j)
            j -= 1


@compiled
def _exchange(picks: Picks, i: int, j: int) -> None:
    for table in (picks.options, picks.detections):
        for column in range(table.shape[1]):
            table[i, column], table[j, column] = table[j, column], table[i, column]
    for entries in (picks.ratio, picks.log_ratio, picks.value):
        entries[i], entries[j] = entries[j], entries[i]
