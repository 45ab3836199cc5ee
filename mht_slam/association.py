"""Which detections are one landmark: `Association`, its comparisons, and known identities.

An association is a partition of all detections of some scans into landmarks and false alarms.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence

import numpy as np
import numpy.typing as npt

from mht_slam.arrays import BoolArray, IntArray, freeze
from mht_slam.errors import AssociationError, UnequalScansError
from mht_slam.measurements import BearingScan

MISSED = -1
"""Table entry of a landmark that a scan does not see."""

MOST_DETECTIONS = 1_000_000
"""The most detections of a scan: more is a mistake, and would fill the memory with labels."""
REPR_SIZE = 1000
"""Entries of a table beyond which it is not written out."""


class Association:
    """A partition of the detections of m scans into landmarks and false alarms.

    Parameters
    ----------
    table : (n_landmarks, m) int array-like. Row l holds the detection index of landmark l in each
        scan, or -1 where the scan misses it. Detections that no row lists are false alarms. A row
        with a single detection is a landmark seen once, which is not the same as a false alarm.
    n_detections : m ints, the number of detections of each scan.

    The rows are kept sorted lexicographically with -1 as plus infinity, so that two tables that
    differ only in the order of their rows are equal, and hash alike.

    Raises `AssociationError` for a wrong shape, entries that are not whole numbers, an index that
    does not exist, a detection used twice, or a row that lists none.

    >>> truth = Association([[1, 0, 0], [0, 1, 1]], (2, 2, 2))
    >>> truth.table.tolist()
    [[0, 1, 1], [1, 0, 0]]
    >>> Association([[0, 1, 0], [1, 0, 1]], (2, 2, 2)).f1(truth)
    0.3333333333333333
    """

    __slots__ = ("_n_detections", "_table")

    def __init__(self, table: npt.ArrayLike, n_detections: Iterable[int]) -> None:
        self._n_detections = _detection_counts(n_detections)
        self._table = _sorted_rows(_validated_table(table, self._n_detections))

    @classmethod
    def from_labels(cls, labels: Sequence[Sequence[object]]) -> Association:
        """Build the association in which detections with equal labels are one landmark.

        `labels` holds one sequence per scan with one entry per detection: any hashable value, or
        None for a false alarm. Raises `AssociationError` for anything else, or a label that one
        scan has twice.
        """
        rows: dict[object, list[int]] = {}
        for scan, scan_labels in enumerate(_label_lists(labels)):
            for detection, label in enumerate(scan_labels):
                if label is None:
                    continue
                if not isinstance(label, Hashable):
                    raise AssociationError(
                        f"labels[{scan}][{detection}] is {label!r}: give a hashable label or None"
                    )
                row = rows.setdefault(label, [MISSED] * len(labels))
                if row[scan] != MISSED:
                    raise AssociationError(
                        f"labels[{scan}][{detection}] repeats {label!r}: "
                        "one scan sees a landmark at most once"
                    )
                row[scan] = detection
        table = np.array(list(rows.values()), dtype=np.int64).reshape(len(rows), len(labels))
        return cls(table, [len(scan_labels) for scan_labels in labels])

    @property
    def table(self) -> IntArray:
        """(n_landmarks, m) detection indices, -1 where missed; rows sorted, read-only."""
        return self._table

    @property
    def n_detections(self) -> tuple[int, ...]:
        """Number of detections of each scan."""
        return self._n_detections

    @property
    def n_scans(self) -> int:
        """Number of scans m."""
        return len(self._n_detections)

    @property
    def n_landmarks(self) -> int:
        """Number of rows."""
        return len(self._table)

    @property
    def n_missed(self) -> int:
        """Number of (landmark, scan) entries that are -1."""
        return int((self._table == MISSED).sum())

    @property
    def is_full(self) -> bool:
        """Whether every landmark is seen in every scan and nothing is a false alarm."""
        return self.n_missed == 0 and not self.false_alarms

    @property
    def false_alarms(self) -> tuple[tuple[int, int], ...]:
        """The (scan, detection) pairs that belong to no landmark, in order."""
        return tuple(
            (scan, detection)
            for scan, labels in enumerate(self.landmark_of_detection())
            for detection in np.flatnonzero(labels == MISSED).tolist()
        )

    def landmark_of_detection(self) -> tuple[IntArray, ...]:
        """For each scan the (n_detections,) row of every detection, -1 for a false alarm."""
        rows = []
        for scan, count in enumerate(self._n_detections):
            labels = np.full(count, MISSED, dtype=np.int64)
            seen = np.flatnonzero(self._table[:, scan] != MISSED)
            labels[self._table[seen, scan]] = seen
            rows.append(labels)
        return tuple(rows)

    def flat_labels(self) -> IntArray:
        """(N,) row of every detection, -1 for a false alarm; scan-major."""
        return np.concatenate([np.empty(0, np.int64), *self.landmark_of_detection()])

    def restrict(self, scans: Sequence[int]) -> Association:
        """Return what the association says of the scans with these indices, in this order.

        Raises `AssociationError` for an index that does not exist.
        """
        if not _is_row(scans):
            raise AssociationError(f"scans is {scans!r}: give a sequence of scan indices")
        for scan in scans:
            if not isinstance(scan, int | np.integer):
                raise AssociationError(f"scans names {scan!r}: give scan indices")
            if not 0 <= scan < self.n_scans:
                raise AssociationError(
                    f"scans names scan {scan}: the association has scans 0 to {self.n_scans - 1}"
                )
        columns = self._table[:, list(scans)]
        seen = columns[(columns != MISSED).any(axis=1)]
        return Association(seen, [self._n_detections[scan] for scan in scans])

    def sort_key(self) -> list[int]:
        """Entries row by row with -1 as plus infinity: how ties between associations are broken."""
        return _missed_last(self._table).ravel().tolist()

    def precision(self, truth: Association) -> float:
        """Share of this association's same-landmark pairs of detections that `truth` has too.

        Without any pair it is 1.0 if `truth` has none either, else 0.0.
        """
        common, mine, theirs = self._pair_counts(truth)
        return _share(common, mine, theirs)

    def recall(self, truth: Association) -> float:
        """Share of the same-landmark pairs of `truth` that this association has too.

        Where `truth` has none it is 1.0 if this association has none either, else 0.0.
        """
        common, mine, theirs = self._pair_counts(truth)
        return _share(common, theirs, mine)

    def f1(self, truth: Association) -> float:
        """Harmonic mean of `precision` and `recall` over same-landmark pairs of detections."""
        precision, recall = self.precision(truth), self.recall(truth)
        total = precision + recall
        return 2.0 * precision * recall / total if total else 0.0

    def exact(self, truth: Association) -> bool:
        """Whether both have the same same-landmark pairs; single detections do not count."""
        common, mine, theirs = self._pair_counts(truth)
        return common == mine == theirs

    def _pair_counts(self, truth: Association) -> tuple[int, int, int]:
        """Count the same-landmark pairs in both, in this one and in `truth`."""
        if not isinstance(truth, Association):
            raise AssociationError(f"truth is {type(truth).__name__}: give an Association")
        if self._n_detections != truth._n_detections:
            raise AssociationError(
                f"the associations are over {self._n_detections} and {truth._n_detections} "
                "detections: compare associations of the same scans"
            )
        mine, theirs = self.flat_labels(), truth.flat_labels()
        both = (mine != MISSED) & (theirs != MISSED)
        joint = mine[both] * max(1, truth.n_landmarks) + theirs[both]
        return (
            _pairs_in_groups(joint),
            _pairs_in_groups(mine[mine != MISSED]),
            _pairs_in_groups(theirs[theirs != MISSED]),
        )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Association):
            return NotImplemented
        return self._n_detections == other._n_detections and np.array_equal(
            self._table, other._table
        )

    def __hash__(self) -> int:
        return hash((self._n_detections, self._table.tobytes()))

    def __repr__(self) -> str:
        if self._table.size > REPR_SIZE:
            return f"<Association of {self.n_landmarks} landmarks in {self.n_scans} scans>"
        return f"Association({self._table.tolist()}, {self._n_detections})"

    def __reduce__(self) -> tuple[type[Association], tuple[IntArray, tuple[int, ...]]]:
        return (Association, (self._table, self._n_detections))


def allowed_pairs(first: BearingScan, second: BearingScan) -> BoolArray:
    """Which detections of two scans may be one landmark, as far as labels tell.

    Returns an (n_first, n_second) mask. Two detections with different labels may not; neither may
    a labelled one and an unlabelled one when the other scan holds that label elsewhere.
    """
    mine = first.labels or (None,) * len(first)
    theirs = second.labels or (None,) * len(second)
    allowed = np.ones((len(first), len(second)), dtype=np.bool_)
    for i, a in enumerate(mine):
        for j, b in enumerate(theirs):
            if a == b:
                continue
            both_known = a is not None and b is not None
            elsewhere = (a is not None and a in theirs) or (b is not None and b in mine)
            allowed[i, j] = not (both_known or elsewhere)
    return allowed


def refuse_unequal(n_detections: Sequence[int], max_missed: int, max_false: int) -> None:
    """Raise `UnequalScansError` where no table has as few misses and false alarms as allowed.

    With n landmarks a scan of d detections misses n - d of them, or has d - n false alarms.
    """
    for n_landmarks in range(max(n_detections, default=0) + 1):
        missed = sum(max(n_landmarks - count, 0) for count in n_detections)
        false = sum(max(count - n_landmarks, 0) for count in n_detections)
        if missed <= max_missed and false <= max_false:
            return
    raise UnequalScansError(
        f"the scans have {list(n_detections)} detections: every landmark must be seen in every "
        f"scan unless max_missed (now {max_missed}) and max_false (now {max_false}) allow otherwise"
    )


def respects_labels(association: Association, scans: Sequence[BearingScan]) -> bool:
    """Whether equal labels are always one landmark and different labels never are.

    A labelled detection that the association takes for a false alarm contradicts its label.
    """
    rows_of_label: dict[str, set[int]] = {}
    labels_of_row: dict[int, set[str]] = {}
    for scan, rows in zip(scans, association.landmark_of_detection(), strict=True):
        for label, row in zip(scan.labels or (), rows.tolist(), strict=False):
            if label is None:
                continue
            if row == MISSED:
                return False
            rows_of_label.setdefault(label, set()).add(row)
            labels_of_row.setdefault(row, set()).add(label)
    one_row_each = all(len(rows_of) == 1 for rows_of in rows_of_label.values())
    return one_row_each and all(len(labels) == 1 for labels in labels_of_row.values())


def _label_lists(labels: Sequence[Sequence[object]]) -> Sequence[Sequence[object]]:
    if not isinstance(labels, Sequence):
        raise AssociationError(f"labels is {type(labels).__name__}: give one sequence per scan")
    for scan, scan_labels in enumerate(labels):
        if not _is_row(scan_labels):
            raise AssociationError(f"labels[{scan}] is {scan_labels!r}: give a label per detection")
    return labels


def _is_row(value: object) -> bool:
    return isinstance(value, Sequence) or (isinstance(value, np.ndarray) and value.ndim == 1)


def _detection_counts(n_detections: Iterable[int]) -> tuple[int, ...]:
    try:
        counts = tuple(n_detections)
    except TypeError:
        raise AssociationError(
            f"n_detections is {n_detections!r}: give one number per scan"
        ) from None
    for scan, count in enumerate(counts):
        whole = isinstance(count, (int, np.integer)) and not isinstance(count, bool)
        if not whole or not 0 <= count <= MOST_DETECTIONS:
            raise AssociationError(
                f"n_detections[{scan}] is {count!r}: give a whole number from 0 to "
                f"{MOST_DETECTIONS}"
            )
    return tuple(int(count) for count in counts)


def _validated_table(table: npt.ArrayLike, n_detections: tuple[int, ...]) -> IntArray:
    n_scans = len(n_detections)
    try:
        raw = np.asarray(table)
    except ValueError:
        raise AssociationError("table has rows of different length") from None
    if raw.size == 0:
        raw = np.empty((0, n_scans), dtype=np.int64)
    if raw.ndim != 2 or raw.shape[1] != n_scans:
        raise AssociationError(
            f"table has shape {raw.shape}: give (landmarks, {n_scans}), one column per scan"
        )
    if raw.dtype.kind not in "iu":
        raise AssociationError(f"table holds {raw.dtype} values: give whole numbers, -1 for missed")
    for scan, count in enumerate(n_detections):
        column = raw[:, scan]
        outside = np.flatnonzero((column < MISSED) | (column >= count))
        if len(outside):
            raise AssociationError(
                f"table[{outside[0]}, {scan}] is {column[outside[0]]}: "
                f"scan {scan} has {count} detections; use 0 to {count - 1}, or -1 for missed"
            )
        used, times = np.unique(column[column != MISSED], return_counts=True)
        if (times > 1).any():
            raise AssociationError(
                f"table uses detection {used[times > 1][0]} of scan {scan} "
                "more than once: a detection belongs to one landmark"
            )
    entries = raw.astype(np.int64)
    empty = np.flatnonzero((entries == MISSED).all(axis=1))
    if len(empty):
        raise AssociationError(f"table[{empty[0]}] lists no detection: leave such rows out")
    return entries


def _missed_last(entries: IntArray) -> IntArray:
    return np.where(entries == MISSED, np.iinfo(np.int64).max, entries)


def _sorted_rows(entries: IntArray) -> IntArray:
    keys = _missed_last(entries)
    order = np.lexsort(keys.T[::-1]) if entries.shape[1] else np.arange(len(entries))
    return freeze(np.ascontiguousarray(entries[order]))


def _pairs_in_groups(labels: IntArray) -> int:
    counts = np.unique(labels, return_counts=True)[1]
    return int((counts * (counts - 1) // 2).sum())


def _share(common: int, whole: int, other_whole: int) -> float:
    if whole == 0:
        return 1.0 if other_whole == 0 else 0.0
    return common / whole
