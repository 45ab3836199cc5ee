"""The covers of all detections by clusters that weigh most, by best-first branch and bound.

An association covers every detection once: by a cluster (what one landmark is seen by) or as a
false alarm. Its weight is a sum over step ratios of products of its clusters' weights. The tree
gives the middle scan's detections their clusters one after the other, then what is left of the
first scan, then of the last.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.progress import Progress

LISTED = math.exp(-40.0)
"""Share of the heaviest cover's weight below which covers are not listed."""
DUST = 1e-20
"""Share of the weight found below which a branch is only added to what lies outside."""
REST = 0.01
"""Share of the weight that may lie in unopened branches at the end."""
PATIENCE = 500
"""Branches opened for that, after the list is proven."""
OPENED_TOGETHER = 16
"""Of these branches, how many are opened before the rest is added up again."""
TIE = 1e-9
"""Relative difference of weights that counts as none."""
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
    covers : heaviest first, with their weights, down to a share `LISTED` of the first. Equal
        weights are not ordered.
    outside : bound on the weight of everything else.
    complete : whether nothing else belongs into the list.
    n_nodes : how many branches were opened.
    """

    covers: list[tuple[float, Cover]]
    outside: float
    complete: bool
    n_nodes: int


@dataclass(order=True)
class _Branch:
    """A partial cover, the heaviest one first.

    `most` is minus a bound on the heaviest of its completions, `together` one on the weight of all.
    """

    most: float
    order: int
    together: float = field(compare=False)
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

    A branch is bounded, at every ratio, by the product over the rows left of the best cluster
    whose detections are free; with the sum of those clusters in place of the best one, the same
    product bounds the weight of all completions together. The branch with the largest bound is
    opened next, and followed down to a whole cover. The list is proven once no bound exceeds the
    weight of its last cover. Then at most `PATIENCE` more branches are opened, until those left
    hold no more than `REST` of the weight. Ties with the last cover are listed too, beyond
    `top_k`.
    """
    search = _Search(_Tree(weights, max_missed, max_false), top_k)
    while search.heap and search.n_nodes < work_limit and not search.is_proven:
        search.open_heaviest(work_limit, progress)
    is_proven = search.is_proven
    last = search.last
    if is_proven:
        search.order_by_weight()
        stop = min(work_limit, search.n_nodes + PATIENCE)
        while search.heap and search.n_nodes < stop and search.waiting > REST * search.total:
            for _ in range(min(len(search.heap), OPENED_TOGETHER)):
                search.open_heaviest(stop, progress)
    search.found.sort(key=lambda entry: -entry[0])
    listed = [entry for entry in search.found if entry[0] >= last * (1.0 - TIE)]
    return CoverList(
        covers=listed,
        outside=search.waiting + sum(weight for weight, _ in search.found[len(listed) :]),
        complete=is_proven,
        n_nodes=search.n_nodes,
    )


class _Search:
    """Branches still to be opened, and the whole covers found so far."""

    def __init__(self, tree: _Tree, top_k: int) -> None:
        self.tree = tree
        self.top_k = top_k
        self.heap = [_Branch(-np.inf, 0, np.inf, ())]
        self.found: list[tuple[float, Cover]] = []
        self.best: list[float] = []
        self.total = 0.0
        self.dust = 0.0
        self.n_nodes = 0
        self._counter = itertools.count(1)
        self._by_weight = False

    @property
    def last(self) -> float:
        """Weight that a cover must have to be listed."""
        enough = self.best[0] if len(self.best) == self.top_k else 0.0
        return max(enough, LISTED * max(self.best, default=0.0))

    @property
    def is_proven(self) -> bool:
        """Whether no branch can hold a cover that belongs into the list."""
        return not self.heap or -self.heap[0].most < self.last * (1.0 - TIE)

    @property
    def waiting(self) -> float:
        """Bound on the weight in unopened branches."""
        return sum(branch.together for branch in self.heap) + self.dust

    def order_by_weight(self) -> None:
        """From now on open the branch whose completions together may weigh most."""
        self._by_weight = True
        for branch in self.heap:
            branch.most = -branch.together
        heapq.heapify(self.heap)

    def open_heaviest(self, stop: int, progress: Progress | None) -> None:
        """Open the first branch, and then the most promising child, down to a whole cover."""
        parts: Cover | None = heapq.heappop(self.heap).parts
        while parts is not None:
            self.n_nodes += 1
            if progress is not None and self.n_nodes % REPORT_EVERY == 0:
                progress(self.n_nodes, stop)
            opened: list[_Branch] = []
            for most, together, child, is_whole in self.tree.children(parts):
                if is_whole:
                    self._keep(most, child)
                elif together <= DUST * self.total:
                    self.dust += together
                else:
                    rank = together if self._by_weight else most
                    opened.append(_Branch(-rank, next(self._counter), together, child))
            parts = None
            if opened:
                first = min(opened)
                if -first.most >= self.last * (1.0 - TIE) and self.n_nodes < stop:
                    opened.remove(first)
                    parts = first.parts
            for branch in opened:
                heapq.heappush(self.heap, branch)

    def _keep(self, weight: float, cover: Cover) -> None:
        self.found.append((weight, cover))
        self.total += weight
        if len(self.best) < self.top_k:
            heapq.heappush(self.best, weight)
        else:
            heapq.heappushpop(self.best, weight)


_Counts = dict[tuple[int, int], FloatArray]
"""Weight (Q,) by numbers of misses and of false alarms."""
_Gather = Callable[[FloatArray, FloatArray], FloatArray]
"""Addition, or the larger one: how alternatives are put together."""


class _Tree:
    """How partial covers grow, and what their completions can weigh.

    The middle scan's detections come first, those with the clearest choice before others.
    """

    def __init__(self, weights: CoverWeights, max_missed: int, max_false: int) -> None:
        self.weights = weights
        self.max_missed = max_missed
        self.max_false = max_false
        self.counts = (len(weights.first), len(weights.middle), len(weights.last))
        options = np.einsum("mikq,q->mik", weights.middle, weights.base)
        best, together = options.max(axis=(1, 2), initial=0.0), options.sum(axis=(1, 2))
        clarity = best / np.maximum(together, 1e-300)
        self.order = np.argsort(-clarity, kind="stable").tolist()

    def children(self, parts: Cover) -> Iterator[tuple[float, float, Cover, bool]]:
        """Every next part of a partial cover.

        Yields bounds on the heaviest completion and on all together, the longer cover, and whether
        it is whole; both bounds are then its weight.
        """
        used = [{part[scan] for part in parts} for scan in range(3)]
        first = [i for i in range(self.counts[0]) if i not in used[0]]
        middle = [m for m in self.order if m not in used[1]]
        last = [k for k in range(self.counts[2]) if k not in used[2]]
        if not (first or middle or last):
            weight = float(self._prefix(parts).sum())
            if weight > 0.0:
                yield weight, weight, parts, True
            return
        missed_left = self.max_missed - sum(part.count(-1) for part in parts)
        false_left = self.max_false - sum(FALSE_ALARM in part for part in parts)
        prefix = self._prefix(parts)
        names, own = self._options(first, middle, last)
        costs = np.array([name.count(-1) for name in names])
        is_false = np.array([FALSE_ALARM in name for name in names])
        heads = prefix * own
        size = (len(first), len(middle), len(last))
        rests = [
            self._rest(first, middle, last, missed_left, false_left, gather)
            for gather in (np.maximum, np.add)
        ]
        whole = [sum(entry >= 0 for entry in name) == sum(size) for name in names]
        bounds = np.zeros((2, len(names)))
        for cost, with_false in {*zip(costs.tolist(), is_false.tolist(), strict=True)}:
            left = (missed_left - cost, false_left - with_false)
            if min(left) < 0:
                continue
            some = (costs == cost) & (is_false == with_false)
            for bound, rest, gather in zip(bounds, rests, (np.maximum, np.add), strict=True):
                tail = _within(rest, left, gather)
                bound[some] = (heads[some] * tail).sum(axis=1)
            exact = some & np.array(whole)
            bounds[:, exact] = heads[exact].sum(axis=1)
        for at in np.flatnonzero(bounds[0] > 0.0):
            yield float(bounds[0, at]), float(bounds[1, at]), (*parts, names[at]), whole[at]

    def _prefix(self, parts: Cover) -> FloatArray:
        """(Q,) weight of a partial cover."""
        weights = self.weights
        total = weights.base.copy()
        for i, m, k in parts:
            if FALSE_ALARM in (i, m, k):
                scan, entry = max(enumerate((i, m, k)), key=lambda pair: pair[1])
                total *= weights.false_alarm[scan][entry]
            elif m >= 0:
                total *= weights.middle[m, i, k]
            else:
                total *= weights.first[i, k] if i >= 0 else weights.last[k]
        return total

    def _options(
        self, first: list[int], middle: list[int], last: list[int]
    ) -> tuple[Cover, FloatArray]:
        """Parts that the next row may take, and their (c, Q) weights."""
        weights = self.weights
        if middle:
            m = middle[0]
            names = [(i, m, k) for i in [*first, -1] for k in [*last, -1]]
            own = weights.middle[m][np.ix_([*first, -1], [*last, -1])]
            own, alone = own.reshape(len(names), -1), weights.false_alarm[1][m]
            false_name = (FALSE_ALARM, m, FALSE_ALARM)
        elif first:
            i = first[0]
            names = [(i, -1, k) for k in [*last, -1]]
            own, alone = weights.first[i][[*last, -1]], weights.false_alarm[0][i]
            false_name = (i, FALSE_ALARM, FALSE_ALARM)
        else:
            k = last[0]
            names = [(-1, -1, k)]
            own, alone = weights.last[k][None], weights.false_alarm[2][k]
            false_name = (FALSE_ALARM, FALSE_ALARM, k)
        return (*names, false_name), np.concatenate([own, alone[None]])

    def _rest(
        self,
        first: list[int],
        middle: list[int],
        last: list[int],
        missed_left: int,
        false_left: int,
        gather: _Gather,
    ) -> _Counts:
        """Bound on what the rows after the next one weigh, by what they cost.

        The next row's own choice is not known yet, so all of `first` and `last` count as free. A
        row of the outer scans may be left to the rows before it.
        """
        weights = self.weights
        limits = (missed_left, false_left)
        total: _Counts = {(0, 0): np.ones(len(weights.base))}
        reduce = np.max if gather is np.maximum else np.sum

        def multiply(options: _Counts) -> None:
            nonlocal total
            total = _product(total, options, limits, gather)

        for m in middle[1:]:
            own = weights.middle[m]
            options = {(0, 0): reduce(own[np.ix_(first, last)], axis=(0, 1), initial=0.0)}
            if missed_left >= 1:
                partly = np.concatenate([own[first, -1], own[-1, last]])
                options[1, 0] = reduce(partly, axis=0, initial=0.0)
            if missed_left >= 2:
                options[2, 0] = own[-1, -1]
            if false_left >= 1:
                options[0, 1] = weights.false_alarm[1][m]
            multiply(options)
        ones = np.ones(len(weights.base))
        for i in first if middle else first[1:]:
            options = {(0, 0): ones} if middle else {}
            if missed_left >= 1:
                options[1, 0] = reduce(weights.first[i][last], axis=0, initial=0.0)
            if missed_left >= 2:
                options[2, 0] = weights.first[i, -1]
            if false_left >= 1:
                options[0, 1] = weights.false_alarm[0][i]
            multiply(options)
        for k in last if middle or first else last[1:]:
            options = {(0, 0): ones} if middle or first else {}
            if missed_left >= 2:
                options[2, 0] = weights.last[k]
            if false_left >= 1:
                options[0, 1] = weights.false_alarm[2][k]
            multiply(options)
        return total


def _product(a: _Counts, b: _Counts, limits: tuple[int, int], gather: _Gather) -> _Counts:
    product: _Counts = {}
    for (missed_a, false_a), weight_a in a.items():
        for (missed_b, false_b), weight_b in b.items():
            count = (missed_a + missed_b, false_a + false_b)
            if count[0] > limits[0] or count[1] > limits[1]:
                continue
            term = weight_a * weight_b
            product[count] = gather(product[count], term) if count in product else term
    return product


def _within(rest: _Counts, left: tuple[int, int], gather: _Gather) -> FloatArray:
    """Put together what stays within the numbers left, (Q,)."""
    result = np.zeros(1)
    for count, weight in rest.items():
        if count[0] <= left[0] and count[1] <= left[1]:
            result = gather(result, weight)
    return result
