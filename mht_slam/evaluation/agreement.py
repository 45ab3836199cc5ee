"""How an answer agrees with the truth: pairs to pool over runs, and exactness up to exchanges."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import permutations, product
from typing import NamedTuple, TypeAlias

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray, finite_number
from mht_slam.association import MISSED, Association
from mht_slam.errors import AssociationError, OptionError
from mht_slam.evaluation.significance import LEVEL, N_RESAMPLES, Interval
from mht_slam.measurements import StraightRun, wrap_angle


class PairCounts(NamedTuple):
    """Same-landmark pairs of detections: in both, in the answer, in the truth.

    Counts of several runs add up; precision, recall and F1 of the sum are the pooled ones, which
    weigh every pair alike, while a mean over runs weighs every run alike.
    """

    common: int
    answered: int
    true: int

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall; 1.0 where neither has a pair."""
        total = self.answered + self.true
        return 2.0 * self.common / total if total else 1.0


def pair_counts(answer: Association, truth: Association, *, count_false: bool = True) -> PairCounts:
    """Count the same-landmark pairs of detections of an answer and of the truth.

    Without `count_false`, pairs of two detections that the truth calls false alarms are left out:
    an unlabelled feature that stands still is seen again like a landmark, and pairing its
    detections is no mistake of the answer. A false alarm paired with a landmark always counts.

    Raises `AssociationError` for associations of other detections.
    """
    answered, true = _pairs(answer.table), _pairs(truth.table)
    common = round(answer.precision(truth) * answered)
    if not count_false:
        false = [rows == MISSED for rows in truth.landmark_of_detection()]
        padded = np.zeros((len(false), 1 + max(map(len, false), default=0)), dtype=bool)
        for scan, flags in enumerate(false):
            padded[scan, : len(flags)] = flags
        among = padded[np.arange(len(false)), answer.table] & (answer.table != MISSED)
        answered -= _pairs(np.where(among, 0, MISSED))
    return PairCounts(common, answered, true)


def pooled(counts: Iterable[PairCounts]) -> PairCounts:
    """Return the sums of the counts of several runs."""
    common, answered, true = np.array([(0, 0, 0), *counts]).sum(axis=0).tolist()
    return PairCounts(common, answered, true)


def pooled_f1_interval(
    counts: Sequence[PairCounts],
    *,
    rng: np.random.Generator,
    level: float = LEVEL,
    n_resamples: int = N_RESAMPLES,
) -> Interval:
    """Pooled F1 of several runs with its percentile interval under resampling of the runs.

    Raises `OptionError` without runs.
    """
    samples = _resampled_f1([counts], rng, n_resamples)[0]
    return _interval(pooled(counts).f1, samples, level)


def pooled_f1_difference(
    first: Sequence[PairCounts],
    second: Sequence[PairCounts],
    *,
    rng: np.random.Generator,
    level: float = LEVEL,
    n_resamples: int = N_RESAMPLES,
) -> Interval:
    """Pooled F1 of `first` minus that of `second`, with its paired bootstrap interval.

    Entry i of both is of run i; runs are resampled, the same for both. Raises `OptionError` unless
    both have the same number of runs, one or more.
    """
    ours, theirs = _resampled_f1([first, second], rng, n_resamples)
    return _interval(pooled(first).f1 - pooled(second).f1, ours - theirs, level)


def exact_up_to_exchanges(
    answer: Association, truth: Association, run: StraightRun, within: float
) -> bool:
    """Whether the answer has the truth's pairs, were close landmarks allowed to be exchanged.

    In a scan that sees two landmarks of the truth less than `within` radians apart, they may be
    exchanged from that scan on, or from the next one on: what follows of one continues the other.
    Several may, and do so independently in every scan; a chain of close landmarks may be exchanged
    in any way. Exchanges with false alarms are not allowed, and single detections do not count, as
    in `Association.exact`.

    Raises `AssociationError` unless the three speak of the same detections.
    """
    finite_number(within, "within", at_least=0.0)
    if not answer.n_detections == truth.n_detections == run.n_detections:
        raise AssociationError(
            f"answer, truth and run have {answer.n_detections}, {truth.n_detections} and "
            f"{run.n_detections} detections: give associations of this run"
        )
    row_of_answer = _rows_with_pairs(answer)
    states = {_State(tuple(range(truth.n_landmarks)), (UNSEEN,) * truth.n_landmarks)}
    for scan in range(len(run)):
        column = truth.table[:, scan]
        rows = row_of_answer[scan]
        seen = np.flatnonzero(column != MISSED)
        if (np.delete(rows, column[seen]) != MISSED).any():
            return False  # the answer pairs what the truth calls a false alarm
        bearings = run.scans[scan].bearings[column[seen]]
        exchanges = list(_exchanges(seen, bearings, within, truth.n_landmarks))
        said = dict(zip(seen.tolist(), rows[column[seen]].tolist(), strict=True))
        begun = {state.exchanged(g) for state in states for g in exchanges}
        kept = {after for state in begun if (after := state.told(said)) is not None}
        states = {state.exchanged(g) for state in kept for g in exchanges}
    return bool(states)


def _resampled_f1(
    methods: Sequence[Sequence[PairCounts]], rng: np.random.Generator, n_resamples: int
) -> list[FloatArray]:
    """For each method the (n_resamples,) pooled F1 of runs drawn with replacement."""
    n = len(methods[0])
    if not n or any(len(counts) != n for counts in methods):
        lengths = [len(counts) for counts in methods]
        raise OptionError(f"counts of {lengths} runs: give the same runs to both, one at least")
    times = rng.multinomial(n, np.full(n, 1.0 / n), size=n_resamples)
    samples: list[FloatArray] = []
    for counts in methods:
        common, answered, true = (times @ np.array(counts)).T
        total = answered + true
        samples.append(np.where(total > 0, 2.0 * common / np.maximum(total, 1), 1.0))
    return samples


def _interval(estimate: float, samples: FloatArray, level: float) -> Interval:
    tail = (1.0 - finite_number(level, "level", above=0.0, below=1.0)) / 2.0
    low, high = np.quantile(samples, [tail, 1.0 - tail])
    return Interval(estimate, float(low), float(high))


UNSEEN = -2
"""A track that has no detection yet; one detection without a pair makes it MISSED."""

Permutation: TypeAlias = tuple[int, ...]


class _State(NamedTuple):
    """A truth with exchanges so far that the answer may have.

    `track_of` has the track that each landmark continues, `row_of` the answer's row of each track.
    """

    track_of: Permutation
    row_of: tuple[int, ...]

    def exchanged(self, exchange: Permutation) -> _State:
        return _State(tuple(self.track_of[i] for i in exchange), self.row_of)

    def told(self, said: dict[int, int]) -> _State | None:
        """Return the state after the answer's rows of the landmarks seen; None if they differ."""
        row_of = list(self.row_of)
        for landmark, row in said.items():
            track = self.track_of[landmark]
            if row_of[track] == UNSEEN and (row == MISSED or row not in row_of):
                row_of[track] = row
            elif row == MISSED or row_of[track] != row:
                return None
        return _State(self.track_of, tuple(row_of))


def _exchanges(
    seen: IntArray, bearings: FloatArray, within: float, n: int
) -> Iterator[Permutation]:
    """Yield all permutations of n landmarks that exchange chains of close ones among themselves."""
    chains: list[list[int]] = [[i] for i in range(len(seen))]
    near: BoolArray = np.abs(wrap_angle(bearings[:, None] - bearings)) < within
    for i, j in zip(*np.nonzero(np.triu(near, 1)), strict=True):
        one, other = (next(c for c in chains if k in c) for k in (i, j))
        if one is not other:
            chains.remove(other)
            one += other
    groups = [seen[chain].tolist() for chain in chains if len(chain) > 1]
    for orders in product(*(permutations(group) for group in groups)):
        permutation = list(range(n))
        for group, order in zip(groups, orders, strict=True):
            for landmark, image in zip(group, order, strict=True):
                permutation[landmark] = image
        yield tuple(permutation)


def _rows_with_pairs(answer: Association) -> list[IntArray]:
    """For each scan the answer's row of each detection, MISSED for one without a partner."""
    lonely = np.flatnonzero((answer.table != MISSED).sum(axis=1) < 2)
    return [
        np.where(np.isin(rows, lonely), MISSED, rows) for rows in answer.landmark_of_detection()
    ]


def _pairs(table: IntArray) -> int:
    sizes = (table != MISSED).sum(axis=1)
    return int((sizes * (sizes - 1) // 2).sum())
