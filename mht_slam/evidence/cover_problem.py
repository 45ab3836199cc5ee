"""Three scans as a cover problem: all clusters tabulated, one grid of ratios, weights, answers."""

from __future__ import annotations

import itertools
import math
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.association import MISSED, Association, allowed_pairs
from mht_slam.evidence.candidates import false_alarm_weight, landmark_weight
from mht_slam.evidence.cluster_table import tabulate
from mht_slam.evidence.cover_search import (
    FALSE_ALARM,
    Cover,
    CoverList,
    CoverWeights,
    heaviest_covers,
)
from mht_slam.evidence.ratio_grid import (
    RatioGrid,
    association_log_evidence,
    log_step_prior,
    panel_grid,
)
from mht_slam.hypotheses import Hypothesis
from mht_slam.measurements import BearingScan
from mht_slam.models import ObservationModel
from mht_slam.progress import Progress

FIRST_LOOKS = 6
"""Ratios at which a first association is looked for, to know what is negligible."""
LOOK_NODES = 400
LOOK_LIMITS = (100, 5_000)
"""Branches opened at each of them, and where that finds nothing."""
LOOK_DROP = 30.0
LOOK_TEMPERATURES = (1.0, 30.0, 1000.0, 30_000.0)
"""Divisors of log weights that bring contradictory scans into the range of floating point.

At a single ratio they leave the order of associations as it is.
"""
BALANCINGS = 3
"""How often the weights are divided by the best option of every detection."""
LOOK_COOLING = np.repeat(np.geomspace(1000.0, 0.5, 24), 2)
"""Temperatures, nats, of the soft maxima by which they are then divided at a single ratio."""
GRID_COOLING = np.array([20.0, 7.0, 2.0, 2.0])
"""The same for all ratios."""
CONTRADICTORY = 200.0
"""Nats by which the detections' best options may together exceed the best association."""
SHARPNESS = 8.0
"""How many times smaller than that excess the temperature is where it is larger."""
MOST_BALANCINGS = 200
IRRELEVANT = 100.0
"""Nats below the best association at which a ratio is left out once its bound says so."""


@dataclass(frozen=True)
class Found:
    """Associations with their log evidences, and what is known of all others.

    Attributes
    ----------
    listed : log evidence and association, best first; ties with the last one included.
    log_outside : log of a bound on the evidence of all other associations together.
    complete : whether none of those has more evidence than the last one listed.
    """

    listed: list[tuple[float, Association]]
    log_outside: float
    complete: bool

    def outside_of(self, chosen: list[Hypothesis]) -> float:
        """Bound on the probability outside some of the listed ones."""
        inside = {h.association for h in chosen}
        within = [e for e, association in self.listed if association in inside]
        beyond = [e for e, association in self.listed if association not in inside]
        if not within:
            return 0.0 if self.complete else 1.0
        top = max(within)
        weight_in = math.fsum(math.exp(e - top) for e in within)
        weight_out = math.fsum(math.exp(e - top) for e in beyond) + math.exp(
            min(self.log_outside - top, 700.0)
        )
        return weight_out / (weight_in + weight_out)


class CoverProblem:
    """The clusters of three scans that labels and limits allow, with their tables."""

    def __init__(
        self,
        scans: tuple[BearingScan, ...],
        sigmas: tuple[FloatArray, ...],
        model: ObservationModel,
        max_missed: int,
        max_false: int,
        executor: Executor | None = None,
    ) -> None:
        self.scans = scans
        self.model = model
        self.max_missed = max_missed
        self.max_false = max_false
        self.counts = tuple(len(scan) for scan in scans)
        entries = _allowed_clusters(scans, max_missed)
        self.table = tabulate(scans, sigmas, model, entries, executor)
        missed = (entries == MISSED).sum(axis=1)
        weights = np.array([landmark_weight(model, 3 - n, n) for n in range(3)])
        self.log_weights = weights[missed]
        self.false_alarms = _false_alarm_weights(scans, model, max_false)

    def search(self, top_k: int, work_limit: int, progress: Progress | None) -> Found:
        """Return the associations of largest evidence, as far as the limit allows."""
        if sum(self.counts) == 0:
            return Found([(0.0, Association([], self.counts))], -math.inf, complete=True)
        if self.table.n_clusters == 0:
            grid = RatioGrid(np.zeros(1), np.zeros(1))  # false alarms alone: any ratio will do
            best = math.inf
        else:
            best, cover = self._first_look()
            if best == -math.inf:
                return self._nothing_found()
            grid = panel_grid(self.table, self.log_weights, *self._rows(), self.model, best)
            if len(grid) == 0:  # a bump too narrow for any panel: sigmas of next to nothing
                return Found([(best, self._association(cover))], math.inf, complete=False)
        alone = tuple(np.repeat(w[:, None], len(grid), axis=1) for w in self.false_alarms)
        weights, log_unit = self._balanced(
            self._values(grid), alone, grid.log_weights, GRID_COOLING, best
        )
        found = heaviest_covers(
            weights,
            top_k=top_k,
            max_missed=self.max_missed,
            max_false=self.max_false,
            work_limit=work_limit,
            progress=progress,
        )
        listed = [(math.log(weight) + log_unit, cover) for weight, cover in found.covers]
        if not listed:
            return self._nothing_found()
        return Found(
            listed=[(evidence, self._association(cover)) for evidence, cover in listed],
            log_outside=math.log(found.outside) + log_unit if found.outside > 0.0 else -math.inf,
            complete=found.complete,
        )

    def _first_look(self) -> tuple[float, Cover]:
        """Log evidence of some good association, -inf where none is found, and its cover.

        The ratios looked at are the tops of single clusters, where together the best of every
        row weigh most.
        """
        table = self.table
        weighed = table.values + log_step_prior(table.knots, self.model)
        top = np.maximum.reduceat(weighed, table.first_knot[:-1])
        at_top = np.flatnonzero(weighed == top[table.owner])
        owners, log_ratios = table.owner[at_top], table.knots[at_top]
        row_top = np.full(int(self._rows()[0].max()) + 1, -np.inf)
        np.maximum.at(row_top, self._rows()[0], top)
        likely = top[owners] >= row_top[self._rows()[0][owners]] - LOOK_DROP
        order = np.argsort(-(top[owners] - row_top[self._rows()[0][owners]]), kind="stable")
        looks = np.unique(log_ratios[order[likely[order]]][:LOOK_NODES])
        grid = RatioGrid(looks, log_step_prior(looks, self.model))
        rows, required, alternative = self._rows()
        values = self._values(grid)
        best_of_row = np.repeat(alternative[:, None], len(looks), axis=1)
        np.maximum.at(best_of_row, rows, values)
        chosen = np.where(required[:, None], best_of_row, np.maximum(best_of_row, 0.0))
        bound = chosen.sum(axis=0) + grid.log_weights
        looks_found: list[tuple[float, Cover]] = [(-math.inf, ())]
        for look in np.argsort(-bound)[:FIRST_LOOKS]:
            for temperature in LOOK_TEMPERATURES:
                found = self._best_cover(values[:, look], temperature)
                if found.covers:
                    cover = found.covers[0][1]
                    looks_found.append((self._evidence(cover), cover))
                    break
        return max(looks_found, key=lambda look: look[0])

    def _best_cover(self, values: FloatArray, temperature: float = 1.0) -> CoverList:
        """Search for the heaviest cover at a single ratio, of clusters weighing (C,) logs."""
        alone = tuple(weights[:, None] / temperature for weights in self.false_alarms)
        weights, _ = self._balanced(
            values[:, None] / temperature, alone, np.zeros(1), LOOK_COOLING / temperature
        )
        for limit in LOOK_LIMITS:
            found = heaviest_covers(
                weights,
                top_k=1,
                max_missed=self.max_missed,
                max_false=self.max_false,
                work_limit=limit,
            )
            if found.covers or found.complete:
                break
        return found

    def _nothing_found(self) -> Found:
        """Say whether labels and limits leave nothing, or nothing was found."""
        found = self._best_cover(np.where(np.isfinite(self.log_weights), 0.0, -np.inf))
        nothing = found.complete and not found.covers
        return Found([], -math.inf if nothing else math.inf, complete=nothing)

    def _evidence(self, cover: Cover) -> float:
        """Log evidence of one cover, from the tables, on a grid of its own."""
        index = {tuple(row): i for i, row in enumerate(self.table.entries.tolist())}
        clusters = np.array(
            [index[part] for part in cover if FALSE_ALARM not in part], dtype=np.int64
        )
        n_false = sum(FALSE_ALARM in part for part in cover)
        weight = float(self.log_weights[clusters].sum())
        weight += false_alarm_weight(self.model, n_false)
        return weight + association_log_evidence(self.table, clusters, self.model)

    def _association(self, cover: Cover) -> Association:
        rows = [part for part in cover if FALSE_ALARM not in part]
        return Association(np.array(rows, dtype=np.int64).reshape(-1, 3), self.counts)

    def _rows(self) -> tuple[IntArray, BoolArray, FloatArray]:
        """Row of every cluster, which rows must be taken, and the weight of their alternative.

        A row is a detection: of the middle scan, else of the first, else of the last.
        """
        first, middle, last = self.table.entries.T
        n1, n2, n3 = self.counts
        rows = np.where(
            middle != MISSED, middle, np.where(first != MISSED, n2 + first, n2 + n1 + last)
        )
        required = np.arange(n1 + n2 + n3) < n2
        false_first, false_middle, false_last = self.false_alarms
        return rows, required, np.concatenate([false_middle, false_first, false_last])

    def _values(self, grid: RatioGrid) -> FloatArray:
        """(C, Q) log weights of the clusters."""
        everything = np.arange(self.table.n_clusters)
        logs = self.table.at(everything, grid.log_ratios) + self.log_weights[:, None]
        return np.asarray(logs, dtype=np.float64)

    def _balanced(
        self,
        logs: FloatArray,
        alone: tuple[FloatArray, ...],
        log_base: FloatArray,
        cooling: FloatArray,
        best: float = math.inf,
    ) -> tuple[CoverWeights, float]:
        """Linear weights of (C, Q) clusters and (n, Q) false alarms, and the log of their unit.

        Every option of a detection is divided by the best one of that detection, at each ratio,
        and the product of all those goes into the ratio's own weight, so that it bounds what an
        association weighs there. Where detections want the same partner, soft maxima divide the
        want between them, which tightens the bound. Without all that, weights of contradictory
        scans would leave the range of floating point.
        """
        balance = _Balance(self.table.entries, logs, alone, log_base)
        for temperature in (*[0.0] * BALANCINGS, *cooling):
            balance.divide(float(temperature))
        for _ in range(MOST_BALANCINGS):
            excess = float(balance.base.max()) - best
            if excess <= CONTRADICTORY:
                break
            balance.keep(balance.base > best - IRRELEVANT)
            balance.divide(excess / SHARPNESS)
        base, left, logs = balance.base, balance.alone, balance.logs
        n1, n2, n3 = self.counts
        first, middle, last = self.table.entries.T
        log_unit = float(base.max())
        weights = CoverWeights(
            base=np.exp(base - log_unit),
            middle=np.zeros((n2, n1 + 1, n3 + 1, len(base))),
            first=np.zeros((n1, n3 + 1, len(base))),
            last=np.zeros((n3, len(base))),
            false_alarm=(np.exp(left[0]), np.exp(left[1]), np.exp(left[2])),
        )
        linear = np.exp(np.minimum(logs, 700.0))
        with_middle = middle != MISSED
        weights.middle[middle[with_middle], first[with_middle], last[with_middle]] = linear[
            with_middle
        ]
        with_first = ~with_middle & (first != MISSED)
        weights.first[first[with_first], last[with_first]] = linear[with_first]
        only_last = ~with_middle & (first == MISSED)
        weights.last[last[only_last]] = linear[only_last]
        return weights, log_unit


class _Balance:
    """Log weights of options while they are divided by soft maxima over each detection's own."""

    def __init__(
        self,
        entries: IntArray,
        logs: FloatArray,
        alone: tuple[FloatArray, ...],
        base: FloatArray,
    ) -> None:
        self.logs = logs.copy()
        self.alone = [array.copy() for array in alone]
        self.base = base.copy()
        self.groups = []
        for column in entries.T:
            members = np.argsort(column, kind="stable")[(column == MISSED).sum() :]
            owners, starts = np.unique(column[members], return_index=True)
            self.groups.append((members, column[members], owners, starts))

    def keep(self, ratios: BoolArray) -> None:
        """Leave the other ratios out."""
        self.base, self.logs = self.base[ratios], self.logs[:, ratios]
        self.alone = [array[:, ratios] for array in self.alone]

    def divide(self, temperature: float) -> None:
        """Divide the options of all detections, one scan after the other."""
        for scan in (1, 0, 2):
            members, owner, owners, starts = self.groups[scan]
            options, alone = self.logs[members], self.alone[scan]
            top = alone.copy()
            if len(owners):
                top[owners] = np.maximum(top[owners], np.maximum.reduceat(options, starts))
            top = np.where(np.isfinite(top), top, 0.0)
            if temperature > 0.0 and len(owners):
                total = np.exp((alone - top) / temperature)
                shares = np.exp((options - top[owner]) / temperature)
                total[owners] += np.add.reduceat(shares, starts)
                top = top + temperature * np.log(np.maximum(total, 1.0))
            self.alone[scan] = alone - top
            self.logs[members] = options - top[owner]
            self.base = self.base + top.sum(axis=0)


def _allowed_clusters(scans: tuple[BearingScan, ...], max_missed: int) -> IntArray:
    """(C, 3) clusters that the labels allow, with at most so many misses."""
    options = [[*range(len(scan)), MISSED] for scan in scans]
    allowed = {(a, b): allowed_pairs(scans[a], scans[b]) for a, b in ((0, 1), (0, 2), (1, 2))}
    labels = [scan.labels or (None,) * len(scan) for scan in scans]

    def fits(cluster: tuple[int, ...]) -> bool:
        if cluster.count(MISSED) > min(max_missed, 2):
            return False
        for (a, b), mask in allowed.items():
            if MISSED not in (cluster[a], cluster[b]) and not mask[cluster[a], cluster[b]]:
                return False
        names = {labels[k][i] for k, i in enumerate(cluster) if i != MISSED} - {None}
        return not any(i == MISSED and names.intersection(labels[k]) for k, i in enumerate(cluster))

    clusters = [cluster for cluster in itertools.product(*options) if fits(cluster)]
    return np.array(clusters, dtype=np.int64).reshape(-1, 3)


def _false_alarm_weights(
    scans: tuple[BearingScan, ...], model: ObservationModel, max_false: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Log weight of each scan's detections as false alarms; a labelled one is none."""
    weight = false_alarm_weight(model, 1) if max_false else -math.inf
    first, middle, last = (
        np.array([weight if name is None else -math.inf for name in labels], dtype=np.float64)
        for labels in (scan.labels or (None,) * len(scan) for scan in scans)
    )
    return first, middle, last
