"""The head of the exhaustive list by search, with a proof that nothing better was left out."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.errors import OptionError
from mht_slam.polygon.base_regions import BaseRegions, base_regions, with_room
from mht_slam.polygon.best import Best, Listing
from mht_slam.polygon.enumeration import Completion
from mht_slam.polygon.exhaustive import exhaustive_search
from mht_slam.polygon.matching import (
    FULL,
    PAUSE,
    Matching,
    find_matchings,
    new_matching,
    start_anew,
)
from mht_slam.polygon.picks import (
    FOUND,
    ROOM,
    SLACK,
    SPENT,
    Choices,
    Picks,
    base_pair_bounds,
    next_picks,
    no_picks,
)
from mht_slam.polygon.problem import (
    MIN_LANDMARKS,
    Problem,
    completed_rows,
    full_tables,
    row_keys,
)
from mht_slam.polygon.tables import PairOfScans
from mht_slam.progress import Progress

MAX_BASE_PAIRS = 10_000_000
"""The most combinations of base cells in both pairs of scans."""

_FOUND_AT_ONCE = 256
_FIRST_PATIENCE = 10_000
_MORE_PATIENCE = 10
_ROUNDING = 1e-12


def exact_search(problem: Problem, work_limit: int, progress: Progress | None = None) -> Listing:
    """List what `exhaustive_search` would list, without going through all hypotheses.

    For each choice of base cells in both pairs, the regions' support lines bound every
    intersection ratio. The choices are searched in the order of the bounds these give on the
    score, each depth first, until none can enter the list. Ends early after `work_limit` steps.
    Where zero scores are wanted and there is room for them, the exhaustive search lists them.
    `progress` hears the choices of base cells decided, and their number in the levels reached.
    Raises `OptionError` beyond `MAX_BASE_PAIRS`. Source: docs/method.md, section 3.
    """
    whole = _Search(problem, work_limit, progress)
    listed: list[tuple[float, IntArray]] = []
    for n_full in range(min(problem.n_detections), MIN_LANDMARKS - 1, -1):
        room = None if problem.top_k is None else problem.top_k - len(listed)
        rest = problem.completions(n_full)
        if room == 0 or not whole.complete or not rest:
            continue
        best = Best(room)
        whole.search_level(n_full, rest, best)
        zeros_fit = len(best.scores) != room or best.threshold <= 0.0
        if problem.include_zero and whole.complete and zeros_fit:
            return replace(exhaustive_search(problem, progress), n_steps=whole.n_steps)
        listed += [
            (float(score), problem.decode(keys))
            for score, keys in zip(best.scores, best.keys, strict=True)
        ]
    return Listing(listed, whole.n_scored, whole.complete, whole.bound, whole.n_steps)


class _Search:
    """One search over all levels, with what it has done so far."""

    def __init__(self, problem: Problem, work_limit: int, progress: Progress | None) -> None:
        self._problem = problem
        self._work_limit = work_limit
        self._progress = progress
        self._decided = self._total = 0
        self.n_scored = self.n_steps = 0
        self.complete = True
        self.bound = 0.0

    def search_level(self, n_full: int, rest: list[Completion], best: Best) -> None:
        """Add all hypotheses with `n_full` landmarks seen in every scan that `best` may keep."""
        problem = self._problem
        middle = range(problem.n_detections[problem.middle])
        by_base: dict[tuple[int, int], list[tuple[int, ...]]] = {}
        for seen in combinations(middle, n_full):
            base = problem.base_among(seen)
            if base is not None:
                by_base.setdefault(base, []).append(seen)
        for base, sets in by_base.items():
            thirds = tuple(m for m in middle if m not in base)
            regions: list[BaseRegions] = []
            for seen in sets:
                if not self.complete:
                    self.bound = 1.0  # nothing is known of sets that were not begun
                    return
                regions = regions or [
                    base_regions(pair, base, thirds, problem.region) for pair in problem.pairs
                ]
                regions = self._search_set(seen, base, thirds, regions, rest, best)

    def _search_set(
        self,
        seen: tuple[int, ...],
        base: tuple[int, int],
        thirds: tuple[int, ...],
        regions: list[BaseRegions],
        rest: list[Completion],
        best: Best,
    ) -> list[BaseRegions]:
        """Search the hypotheses of one set of fully seen landmarks; return the regions as used."""
        choices = _choices(self._problem, seen, base, thirds, regions)
        n_pairs = len(regions[0].options) * len(regions[1].options)
        if n_pairs > MAX_BASE_PAIRS:
            raise OptionError(
                f"ranking would take {n_pairs:,} choices of base cells, and stops at "
                f"{MAX_BASE_PAIRS:,}: rank fewer detections, or take a smaller epsilon"
            )
        bounds = self._bounds(choices)
        order = np.flatnonzero(bounds > -np.inf)
        bounds = bounds[order]
        self._total = self._decided + len(order)
        found = _Found(self._problem, seen, base, rest, best)
        patience = _FIRST_PATIENCE
        while len(order) and self.complete:
            by_bound = np.argsort(-bounds, kind="stable")
            order, bounds = order[by_bound], bounds[by_bound]
            choices, waiting = self._search_base_pairs(choices, order, bounds, patience, found)
            order, bounds = order[waiting], bounds[waiting]
            patience *= _MORE_PATIENCE
        self._decided = self._total
        if self._progress is not None and self.complete:
            self._progress(self._decided, self._total)
        return [choices.first, choices.second]

    def _bounds(self, choices: Choices) -> FloatArray:
        """Bounds of all base pairs, flat; 0.0, a score of one, where the work limit came first."""
        n_first, n_second = len(choices.first.options), len(choices.second.options)
        bounds = np.zeros((n_first, n_second))
        for b1 in range(n_first):
            if self.n_steps >= self._work_limit:
                break
            bounds[b1] = base_pair_bounds(choices, b1)
            self.n_steps += n_second
            if self._progress is not None:
                self._progress(self._decided, self._decided + n_first * n_second)
        return bounds.ravel()

    def _search_base_pairs(
        self,
        choices: Choices,
        order: IntArray,
        bounds: FloatArray,
        patience: int,
        found: _Found,
    ) -> tuple[Choices, list[int]]:
        """Search base pairs in order, each for `patience` steps at most.

        Returns the choices with the regions as used, and the places of base pairs that need more.
        Tightens `bounds` where a base pair's own search gives less.
        """
        n_thirds = len(choices.thirds)
        picks = no_picks(choices)
        matching = new_matching(n_thirds, len(choices.is_outer), _FOUND_AT_ONCE)
        waiting: list[int] = []
        place = 0
        while True:
            needed = found.needed(n_thirds)
            steps_left = self._work_limit - self.n_steps
            state, place = next_picks(choices, order, bounds, place, needed, steps_left, picks)
            self._count_steps(picks, matching)
            if state == ROOM:
                choices = choices._replace(
                    first=with_room(choices.first, choices.allowed_1),
                    second=with_room(choices.second, choices.allowed_2),
                )
                continue
            if state == SPENT:
                self._give_up(bounds[[*waiting, *range(place, len(order))]], found, n_thirds)
            if state != FOUND:
                return choices, waiting
            bounds[place] = min(bounds[place], picks.bound[0])
            start_anew(matching)
            done = FULL
            while done == FULL:
                prices = picks.price.sum()
                done = find_matchings(
                    picks.begin,
                    picks.end,
                    picks.value,
                    picks.detections,
                    matching,
                    found.needed(n_thirds) - prices - SLACK,
                    min(patience, self._work_limit - self.n_steps),
                )
                n_listed = found.take(choices, order[place], picks, matching)
                self.n_scored += n_listed
                self.n_steps += n_listed
            self._count_steps(picks, matching)
            if done == PAUSE:
                waiting.append(place)
            place += 1
            if self._progress is not None:
                self._progress(self._total - len(order) + place - len(waiting), self._total)

    def _count_steps(self, picks: Picks, matching: Matching) -> None:
        self.n_steps += int(picks.n_ratios[0] + matching.place[2])
        picks.n_ratios[0] = matching.place[2] = 0

    def _give_up(self, bounds: FloatArray, found: _Found, n_thirds: int) -> None:
        """Note what base pairs that were not searched to their end could still hold."""
        best = bounds.max(initial=-math.inf)
        if best >= found.needed(n_thirds) - SLACK:
            self.complete = False
            self.bound = math.exp(best / n_thirds)


def _choices(
    problem: Problem,
    seen: tuple[int, ...],
    base: tuple[int, int],
    thirds: tuple[int, ...],
    regions: list[BaseRegions],
) -> Choices:
    mine = [m for m in seen if m not in base]
    first, second = problem.pairs
    allowed = [_allowed(problem, pair) for pair in problem.pairs]
    linked = np.ones((len(first.detections), len(second.detections)), dtype=np.bool_)
    for a, one in zip(first.others, first.detections.T, strict=True):
        for b, other in zip(second.others, second.detections.T, strict=True):
            linked &= problem.allowed[a, b][one[:, None], other]
    return Choices(
        first=regions[0],
        second=regions[1],
        thirds=np.array([thirds.index(m) for m in mine], dtype=np.int64),
        allowed_1=allowed[0][mine],
        allowed_2=allowed[1][mine],
        base_allowed_1=np.all(allowed[0][list(base), regions[0].options], axis=1),
        base_allowed_2=np.all(allowed[1][list(base), regions[1].options], axis=1),
        linked=linked,
        detections_1=_numbered(problem, first),
        detections_2=_numbered(problem, second),
        is_outer=np.repeat(np.arange(len(problem.scans)) != problem.middle, problem.n_detections),
        all_taken=set(problem.n_detections) == {len(seen)},
        of_union=problem.ratio == "iou",
    )


def _numbered(problem: Problem, pair: PairOfScans) -> IntArray:
    """(options, columns) the detections behind options, numbered through all scans."""
    before = np.concatenate([[0], np.cumsum(problem.n_detections)])
    return np.asarray(pair.detections + before[list(pair.others)], dtype=np.int64)


def _allowed(problem: Problem, pair: PairOfScans) -> BoolArray:
    """(middle detections, options) which options labels allow a landmark."""
    allowed = np.logical_and.reduce(
        [
            problem.allowed[problem.middle, column][:, detections]
            for column, detections in zip(pair.others, pair.detections.T, strict=True)
        ]
    )
    if len(pair.others) == 2:
        allowed = allowed & problem.allowed[pair.others][tuple(pair.detections.T)]
    return np.asarray(allowed, dtype=np.bool_)


class _Found:
    """Turns the picks a search found into entries of the list."""

    def __init__(
        self,
        problem: Problem,
        seen: tuple[int, ...],
        base: tuple[int, int],
        rest: list[Completion],
        best: Best,
    ) -> None:
        self._problem = problem
        self._seen = seen
        self._base_places = [seen.index(landmark) for landmark in base]
        self._third_places = [i for i, m in enumerate(seen) if m not in base]
        self._rest = rest
        self._best = best
        self._completed: dict[tuple[tuple[int, ...], ...], list[tuple[IntArray, bool]]] = {}

    def needed(self, n_thirds: int) -> float:
        """The least sum of log ratios that the list may keep."""
        least = self._best.threshold - _ROUNDING
        return n_thirds * math.log(least) if least > 0.0 else -math.inf

    def take(self, choices: Choices, base_pair: int, picks: Picks, matching: Matching) -> int:
        """List what was found and make room for more; return how many hypotheses that was."""
        count = int(matching.place[1])
        matching.place[1] = 0
        if count == 0:
            return 0
        chosen = matching.found[:count]
        score = np.ones(count)
        for pick in chosen.T:
            score *= picks.ratio[pick]
        if chosen.shape[1] > 1:
            score **= 1.0 / chosen.shape[1]
        bases = divmod(int(base_pair), len(choices.second.options))
        columns = []
        for which, (pair, regions) in enumerate(
            zip(self._problem.pairs, (choices.first, choices.second), strict=True)
        ):
            options = np.empty((count, len(self._seen)), dtype=np.int64)
            options[:, self._base_places] = regions.options[bases[which]]
            options[:, self._third_places] = picks.options[chosen, which]
            columns.append(np.moveaxis(pair.detections[options], 2, 1))
        full = full_tables(self._problem, self._seen, *columns)
        positive = score > 0.0  # a product of many small ratios may not be
        return self._list(score[positive], full[positive])

    def _list(self, score: FloatArray, full: IntArray) -> int:
        """Complete hypotheses with what is not fully seen; those without a completion drop out."""
        if self._rest == [()]:
            self._best.add(
                score, row_keys(self._problem, full, np.empty((0, full.shape[2]), dtype=np.int64))
            )
            return len(score)
        n_scored = 0
        for own_score, table in zip(score, full, strict=True):
            chosen = tuple(tuple(sorted(column)) for column in table.T.tolist())
            if chosen not in self._completed:
                self._completed[chosen] = completed_rows(self._problem, chosen, self._rest)
            for rows_left, feasible in self._completed[chosen]:
                if feasible:
                    keys = row_keys(self._problem, table[None], rows_left)
                    self._best.add(np.array([own_score]), keys)
                    n_scored += 1
        return n_scored
