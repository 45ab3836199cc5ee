"""The covers of all detections by clusters that weigh most, by best-first branch and bound.

An association covers every detection once: by a cluster (what one landmark is seen by) or as a
false alarm. Its weight is a sum over step ratios of products of its clusters' weights. The tree
gives the middle scan's detections their clusters one after the other, then what is left of the
first scan, then of the last.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray
from mht_slam.progress import Progress

DUST = 1e-20
"""Share of the heaviest cover found below which a branch is only added to what lies outside."""
REST = 1e-3
"""Share of the weight that may lie in unopened branches once the list is proven."""
TIE = 1e-9
"""Relative difference of weights that counts as none."""
ROUNDING = 1e-13
"""Share of a row's sum that rounding may take from a bound."""
REPORT_EVERY = 64

Cover = tuple[tuple[int, int, int], ...]
"""Clusters and false alarms: a detection of each scan, -1 where missed.

A false alarm has `FALSE_ALARM` in the scans that it is not of.
"""

FALSE_ALARM = -2


@dataclass(frozen=True)
class CoverWeights:
    """Weights of all clusters over Q step ratios, linear, none negative.

    Attributes
    ----------
    base : (Q,) weight of each ratio.
    middle : (n2, n1 + 1, n3 + 1, Q) clusters of each detection of the middle scan; the last index
        of the first and third scan stands for a miss.
    first : (n1, n3 + 1, Q) clusters that the middle scan misses.
    last : (n3, Q) landmarks that only the last scan sees.
    false_alarm : for each scan (n,) weights of its detections as false alarms.
    """

    base: FloatArray
    middle: FloatArray
    first: FloatArray
    last: FloatArray
    false_alarm: tuple[FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True)
class CoverList:
    """What the search found.

    Attributes
    ----------
    covers : heaviest first, with their weights. Equal weights are not ordered.
    outside : bound on the weight of everything else.
    complete : whether nothing else weighs more than the last one listed.
    n_nodes : how many branches were opened.
    """

    covers: list[tuple[float, Cover]]
    outside: float
    complete: bool
    n_nodes: int


@dataclass(order=True)
class _Branch:
    """A partial cover; `bound` is minus the most that all its completions weigh together."""

    bound: float
    order: int
    parts: Cover = field(compare=False)


def heaviest_covers(
    weights: CoverWeights,
    *,
    top_k: int,
    max_missed: int,
    max_false: int,
    work_limit: int,
    progress: Progress | None = None,
) -> CoverList:
    """Find the covers of largest weight, with at most so many misses and false alarms.

    Branches are opened in the order of a bound on the weight of all their completions together:
    at every ratio the product, over the rows left, of the sums over the clusters whose detections
    are free. The list is proven once no bound exceeds the weight of its last cover; the search
    goes on until the unopened branches hold no more than `REST` of the weight, and ends after
    `work_limit` of them. Ties with the last one are listed too, beyond `top_k`.
    """
    tree = _Tree(weights, max_missed, max_false)
    counter = itertools.count()
    heap = [_Branch(-np.inf, next(counter), ())]
    found: list[tuple[float, Cover]] = []
    best: list[float] = []
    dust, n_nodes, total = 0.0, 0, 0.0
    while heap and n_nodes < work_limit:
        enough = best[0] if len(best) == top_k else 0.0
        if -heap[0].bound < enough * (1.0 - TIE):
            waiting = -sum(branch.bound for branch in heap)
            if waiting <= REST * total or len(heap) == 0:
                break
        branch = heapq.heappop(heap)
        n_nodes += 1
        if progress is not None and n_nodes % REPORT_EVERY == 0:
            progress(n_nodes, work_limit)
        for bound, parts, is_whole in tree.children(branch.parts):
            if is_whole:
                found.append((bound, parts))
                total += bound
                heapq.heappush(best, bound) if len(best) < top_k else heapq.heappushpop(best, bound)
            elif bound > DUST * total:
                heapq.heappush(heap, _Branch(-bound, next(counter), parts))
            else:
                dust += bound
    found.sort(key=lambda entry: -entry[0])
    last = found[min(top_k, len(found)) - 1][0] if found else 0.0
    listed = [entry for entry in found if entry[0] >= last * (1.0 - TIE)]
    waiting = -sum(branch.bound for branch in heap) + dust
    proven = max((-branch.bound for branch in heap), default=0.0) < last * (1.0 - TIE)
    return CoverList(
        covers=listed,
        outside=waiting + sum(weight for weight, _ in found[len(listed) :]),
        complete=not heap or (proven and len(found) >= top_k),
        n_nodes=n_nodes,
    )


_Counts = dict[tuple[int, int], FloatArray]
"""Weight by numbers of misses and of false alarms, in arrays (first, last, ratio)."""


class _Tree:
    """How partial covers grow, and what their completions can weigh."""

    def __init__(self, weights: CoverWeights, max_missed: int, max_false: int) -> None:
        self.weights = weights
        self.max_missed = max_missed
        self.max_false = max_false
        self.n_middle, self.n_first, self.n_last = (
            len(weights.middle),
            len(weights.first),
            len(weights.last),
        )

    def children(self, parts: Cover) -> Iterator[tuple[float, Cover, bool]]:
        """Every next part of a partial cover: bound, the longer cover, whether it is whole."""
        middle = list(range(len(parts), self.n_middle))
        first = _unused(self.n_first, [part[0] for part in parts])
        last = _unused(self.n_last, [part[2] for part in parts])
        prefix = self._prefix(parts)
        alive = np.flatnonzero(prefix)
        if len(alive) == 0:
            return
        ratios = slice(int(alive[0]), int(alive[-1]) + 1)
        weights = self.weights
        if middle:
            m = middle.pop(0)
            rest = self._rest(middle, first, last, ratios, takes_first=True, takes_last=True)
            own = weights.middle[m][np.ix_([*first, self.n_first], [*last, self.n_last])]
            alone = weights.false_alarm[1][m]
            names = [[(i, m, k) for k in [*last, -1]] for i in [*first, -1]]
            false_name = (FALSE_ALARM, m, FALSE_ALARM)
        elif first:
            i = first.pop(0)
            rest = self._rest([], first, last, ratios, takes_first=False, takes_last=True)
            own = weights.first[i][np.ix_([*last, self.n_last])][None]
            alone = weights.false_alarm[0][i]
            names = [[(i, -1, k) for k in [*last, -1]]]
            false_name = (i, FALSE_ALARM, FALSE_ALARM)
        elif last:
            k = last.pop(0)
            rest = self._rest([], [], last, ratios, takes_first=False, takes_last=False)
            own = weights.last[k][None, None]
            alone = weights.false_alarm[2][k]
            names = [[(-1, -1, k)]]
            false_name = (FALSE_ALARM, FALSE_ALARM, k)
        else:
            yield float(prefix.sum()), parts, True
            return
        missed = sum(part.count(-1) for part in parts)
        n_false = sum(FALSE_ALARM in part for part in parts)
        left = (self.max_missed - missed, self.max_false - n_false)
        heads = prefix[ratios] * own[..., ratios]
        costs = np.array([[name.count(-1) for name in row] for row in names])
        bounds = np.zeros(costs.shape)
        for cost in range(left[0] + 1):
            some = costs == cost
            if some.any():
                tails = _within(rest, left[0] - cost, left[1])
                bounds[some] = np.einsum("cq,cq->c", heads[some], _at(tails, some))
        for a, b in zip(*np.nonzero(bounds), strict=True):
            yield float(bounds[a, b]), (*parts, names[a][b]), self._is_whole(names[a][b], parts)
        if left[1] > 0:
            tails = _within(rest, left[0], left[1] - 1)
            none = np.zeros(costs.shape, dtype=np.bool_)
            none[-1, -1] = True
            bound = float((prefix[ratios] * alone[ratios] * _at(tails, none)[0]).sum())
            if bound > 0.0:
                yield bound, (*parts, false_name), self._is_whole(false_name, parts)

    def _is_whole(self, part: tuple[int, int, int], parts: Cover) -> bool:
        covered = [sum(p[scan] >= 0 for p in (*parts, part)) for scan in range(3)]
        return covered == [self.n_first, self.n_middle, self.n_last]

    def _prefix(self, parts: Cover) -> FloatArray:
        """(Q,) weight of a partial cover."""
        total = self.weights.base.copy()
        for part in parts:
            total *= self._weight(part)
        return total

    def _weight(self, part: tuple[int, int, int]) -> FloatArray:
        i, m, k = part
        weights = self.weights
        if FALSE_ALARM in part:
            scan = next(scan for scan, entry in enumerate(part) if entry != FALSE_ALARM)
            chosen = weights.false_alarm[scan][part[scan]]
        elif m >= 0:
            chosen = weights.middle[m, i, k]
        else:
            chosen = weights.first[i, k] if i >= 0 else weights.last[k]
        return np.asarray(chosen, dtype=np.float64)

    def _rest(
        self,
        middle: list[int],
        first: list[int],
        last: list[int],
        ratios: slice,
        *,
        takes_first: bool,
        takes_last: bool,
    ) -> _Counts:
        """Bound on what the rows left weigh, for every choice of the part that goes before them.

        That part takes one of `first`, or none (the last index of the first axis), where
        `takes_first`; likewise of `last`, along the second axis.
        """
        weights = self.weights
        n_choices = (len(first) * takes_first + 1, len(last) * takes_last + 1)
        total: _Counts = {(0, 0): np.ones((1, 1, 1))}
        for m in middle:
            own = weights.middle[m, ..., ratios]
            core = own[np.ix_(first, last)]
            one_miss = own[first, self.n_last], own[self.n_first, last]
            by_count: _Counts = {
                (0, 0): _without(core, takes_first=takes_first, takes_last=takes_last)
            }
            if self.max_missed >= 1:
                by_count[1, 0] = _without(
                    one_miss[0][:, None], takes_first=takes_first, takes_last=False
                ) + _without(one_miss[1][None], takes_first=False, takes_last=takes_last)
            if self.max_missed >= 2:
                by_count[2, 0] = own[self.n_first, self.n_last][None, None]
            if self.max_false >= 1:
                by_count[0, 1] = weights.false_alarm[1][m, ratios][None, None]
            total = self._product(total, by_count)
        first_left = len(first) - takes_first * (np.arange(n_choices[0]) < len(first))
        for position, i in enumerate(first):
            own = weights.first[i, :, ratios]
            by_count = {(0, 0): np.full((1, 1, 1), 1.0 if middle else 0.0)}
            if self.max_missed >= 1:
                by_count[1, 0] = _without(own[last][None], takes_first=False, takes_last=takes_last)
            if self.max_missed >= 2:
                by_count[2, 0] = own[self.n_last][None, None]
            if self.max_false >= 1:
                by_count[0, 1] = weights.false_alarm[0][i, ratios][None, None]
            if takes_first:
                by_count = _replaced(by_count, 0, position, n_choices[0])
            total = self._product(total, by_count)
        for position, k in enumerate(last):
            may_wait = np.logical_or(bool(middle), first_left > 0).astype(np.float64)
            by_count = {(0, 0): may_wait[:, None, None]}
            if self.max_missed >= 2:
                by_count[2, 0] = weights.last[k, ratios][None, None]
            if self.max_false >= 1:
                by_count[0, 1] = weights.false_alarm[2][k, ratios][None, None]
            if takes_last:
                by_count = _replaced(by_count, 1, position, n_choices[1])
            total = self._product(total, by_count)
        shape = (*n_choices, ratios.stop - ratios.start)
        return {count: np.broadcast_to(value, shape) for count, value in total.items()}

    def _product(self, a: _Counts, b: _Counts) -> _Counts:
        product: _Counts = {}
        for (missed_a, false_a), weight_a in a.items():
            for (missed_b, false_b), weight_b in b.items():
                count = (missed_a + missed_b, false_a + false_b)
                if count[0] > self.max_missed or count[1] > self.max_false:
                    continue
                term = weight_a * weight_b
                product[count] = product[count] + term if count in product else term
        return product


def _unused(count: int, used: list[int]) -> list[int]:
    return [i for i in range(count) if i not in used]


def _without(core: FloatArray, *, takes_first: bool, takes_last: bool) -> FloatArray:
    """Sum of (a, b, Q) weights without one row, one column, or both; the last choice is none."""
    total = core.sum(axis=(0, 1))
    result = np.broadcast_to(
        total, (core.shape[0] * takes_first + 1, core.shape[1] * takes_last + 1, len(total))
    ).copy()
    if takes_first:
        result[:-1] -= core.sum(axis=1)[:, None]
    if takes_last:
        result[:, :-1] -= core.sum(axis=0)[None]
    if takes_first and takes_last:
        result[:-1, :-1] += core
    return np.asarray(np.maximum(result, 0.0) + ROUNDING * total, dtype=np.float64)


def _replaced(by_count: _Counts, axis: int, position: int, size: int) -> _Counts:
    """The same factor, but one where the part before has taken this very detection."""
    replaced = {}
    for count, value in by_count.items():
        shape = (size, value.shape[1]) if axis == 0 else (value.shape[0], size)
        wide = np.broadcast_to(value, (*shape, value.shape[2])).copy()
        taken = (position, slice(None)) if axis == 0 else (slice(None), position)
        wide[taken] = 1.0 if count == (0, 0) else 0.0
        replaced[count] = wide
    return replaced


def _within(rest: _Counts, missed: int, n_false: int) -> FloatArray:
    """Sum of what stays within the numbers left."""
    terms = [w for count, w in rest.items() if count[0] <= missed and count[1] <= n_false]
    return np.sum(terms, axis=0) if terms else np.zeros((1, 1, 1))


def _at(tails: FloatArray, some: BoolArray) -> FloatArray:
    """Entries of (a, b, Q) tails where the (a, b) mask is True, (c, Q)."""
    return np.broadcast_to(tails, (*some.shape, tails.shape[2]))[some]
