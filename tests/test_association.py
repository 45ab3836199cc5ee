"""An association is a partition of the detections; its figures count pairs of detections."""

from __future__ import annotations

import itertools
import pickle
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.association import MISSED, Association, allowed_pairs, respects_labels
from mht_slam.errors import AssociationError
from mht_slam.measurements import BearingScan

Detection = tuple[int, int]


@st.composite
def associations(draw: st.DrawFn, counts: tuple[int, ...] = (3, 2, 4)) -> Association:
    """Give every detection a landmark out of six, or none, at most once a scan."""
    names = st.permutations([*range(6), None, None, None])
    return Association.from_labels([draw(names)[:count] for count in counts])


def pairs_by_enumeration(association: Association) -> set[frozenset[Detection]]:
    """Every pair of detections that one row lists, read off the table."""
    pairs = set()
    for row in association.table.tolist():
        seen = [(scan, index) for scan, index in enumerate(row) if index != -1]
        pairs |= {frozenset(pair) for pair in itertools.combinations(seen, 2)}
    return pairs


def share(common: int, whole: int, other: int) -> float:
    return common / whole if whole else float(other == 0)


@given(associations(), associations())
def test_precision_recall_and_exact_count_pairs_of_detections(
    mine: Association, truth: Association
) -> None:
    a, b = pairs_by_enumeration(mine), pairs_by_enumeration(truth)
    assert mine.precision(truth) == share(len(a & b), len(a), len(b))
    assert mine.recall(truth) == share(len(a & b), len(b), len(a))
    assert mine.exact(truth) == (a == b)
    precision, recall = mine.precision(truth), mine.recall(truth)
    mean = 2 * precision * recall / (precision + recall) if precision + recall else 0.0
    assert mine.f1(truth) == pytest.approx(mean)


@given(associations())
def test_every_association_is_exact_against_itself(association: Association) -> None:
    assert association.exact(association)
    assert association.f1(association) == 1.0


def test_without_any_pair_a_share_is_one_only_if_the_other_side_has_none() -> None:
    none = Association([], (2, 2))
    singles = Association([[0, -1], [-1, 0]], (2, 2))
    one_pair = Association([[0, 0]], (2, 2))
    assert none.precision(singles) == none.recall(singles) == none.f1(singles) == 1.0
    assert none.precision(one_pair) == none.recall(one_pair) == none.f1(one_pair) == 0.0
    assert one_pair.precision(none) == one_pair.recall(none) == 0.0


def test_a_landmark_seen_once_is_no_false_alarm_but_makes_no_pair() -> None:
    once = Association([[0, 0], [1, -1]], (2, 1))
    alarm = Association([[0, 0]], (2, 1))
    assert once != alarm
    assert once.exact(alarm)
    assert once.false_alarms == ()
    assert alarm.false_alarms == ((0, 1),)
    assert (once.n_missed, alarm.n_missed) == (1, 0)


@given(associations(), st.randoms(use_true_random=False))
def test_the_order_of_rows_means_nothing(association: Association, random: Any) -> None:
    rows = association.table.tolist()
    random.shuffle(rows)
    shuffled = Association(rows, association.n_detections)
    assert shuffled == association
    assert hash(shuffled) == hash(association)


@given(associations())
def test_rows_are_sorted_with_a_miss_after_every_detection(association: Association) -> None:
    keys = [[np.inf if i == -1 else i for i in row] for row in association.table.tolist()]
    assert keys == sorted(keys)


@given(associations())
def test_pickling_and_printing_keep_the_association(association: Association) -> None:
    again = pickle.loads(pickle.dumps(association))  # noqa: S301 - our own bytes
    assert again == association
    assert not again.table.flags.writeable
    assert eval(repr(association), {"Association": Association}) == association  # noqa: S307


def test_equality_asks_for_the_same_detections_and_the_same_type() -> None:
    assert Association([[0, 0]], (1, 1)) != Association([[0, 0]], (1, 2))
    assert Association([[0, 0]], (1, 1)) != "an association"


def test_the_table_is_a_read_only_copy() -> None:
    table = np.array([[1, 0], [0, 1]])
    association = Association(table, (2, 2))
    table[0, 0] = 0
    assert association.table.tolist() == [[0, 1], [1, 0]]
    with pytest.raises(ValueError, match="read-only"):
        association.table[0, 0] = 5


@given(associations())
def test_every_detection_is_in_one_row_or_a_false_alarm(association: Association) -> None:
    listed = [
        (scan, index)
        for row in association.table.tolist()
        for scan, index in enumerate(row)
        if index != -1
    ]
    everything = [(s, i) for s, count in enumerate(association.n_detections) for i in range(count)]
    assert sorted(listed + list(association.false_alarms)) == everything
    flat = association.flat_labels()
    assert len(flat) == len(everything)
    for (scan, index), row in zip(everything, flat.tolist(), strict=True):
        expected = -1 if (scan, index) in association.false_alarms else index
        assert (association.table[row, scan] if row != -1 else -1) == expected


def test_counts_describe_the_table() -> None:
    association = Association([[0, 1, -1], [1, 0, 0]], (2, 2, 1))
    assert (association.n_scans, association.n_landmarks, association.n_missed) == (3, 2, 1)
    assert not association.is_full
    assert Association([[0, 0], [1, 1]], (2, 2)).is_full
    assert not Association([[0, 0]], (1, 2)).is_full


@given(associations(), st.permutations(range(3)), st.integers(0, 3))
def test_restricting_keeps_exactly_the_pairs_inside_the_chosen_scans(
    association: Association, order: list[int], n_kept: int
) -> None:
    kept = order[:n_kept]
    restricted = association.restrict(kept)
    expected = {
        frozenset((kept.index(scan), index) for scan, index in pair)
        for pair in pairs_by_enumeration(association)
        if all(scan in kept for scan, _ in pair)
    }
    assert restricted.n_detections == tuple(association.n_detections[scan] for scan in kept)
    assert pairs_by_enumeration(restricted) == expected
    alarms = {(kept.index(s), i) for s, i in association.false_alarms if s in kept}
    assert set(restricted.false_alarms) == alarms


@pytest.mark.parametrize("scan", [-1, 2])
def test_restricting_to_a_scan_that_does_not_exist_is_refused(scan: int) -> None:
    with pytest.raises(AssociationError, match=f"names scan {scan}"):
        Association([[0, 0]], (1, 1)).restrict([0, scan])


@pytest.mark.parametrize(
    ("table", "counts", "message"),
    [
        ([[0, 0], [0, 1]], (1, 2), "detection 0 of scan 0 more than once"),
        ([[0, 2]], (1, 2), r"table\[0, 1\] is 2: scan 1 has 2 detections; use 0 to 1"),
        ([[0, -2]], (1, 2), r"table\[0, 1\] is -2"),
        ([[0, 0], [-1, -1]], (1, 2), r"table\[1\] lists no detection: leave such rows out"),
        ([[0.0, 1.0]], (1, 2), "float64 values: give whole numbers"),
        ([[True, False]], (1, 2), "bool values"),
        ([["0", "1"]], (1, 2), "whole numbers"),
        ([[0]], (1, 2), r"shape \(1, 1\): give \(landmarks, 2\)"),
        ([0, 1], (1, 2), "shape"),
        ([[0, 1], [1]], (2, 2), "different length"),
        (np.array([[2**64 - 1]], dtype=np.uint64), (1,), "18446744073709551615"),
        ([[0]], 3, "n_detections is 3: give one number per scan"),
        ([[0]], (1.5,), r"n_detections\[0\] is 1.5: give a whole number"),
        ([[0]], (-1,), r"n_detections\[0\] is -1"),
        ([[0]], (True,), r"n_detections\[0\] is True"),
    ],
)
def test_a_table_that_is_no_partition_is_refused(table: Any, counts: Any, message: str) -> None:
    with pytest.raises(AssociationError, match=message):
        Association(table, counts)


def test_associations_of_different_scans_are_not_compared() -> None:
    with pytest.raises(AssociationError, match="same scans"):
        Association([], (1, 2)).f1(Association([], (2, 1)))
    with pytest.raises(AssociationError, match="truth is list"):
        Association([], (1, 2)).exact([[0, 0]])  # type: ignore[arg-type]


def test_from_labels_makes_equal_labels_one_landmark_and_none_a_false_alarm() -> None:
    association = Association.from_labels([["a", None, 7], [7], ["b", "a"]])
    assert association == Association([[0, -1, 1], [2, 0, -1], [-1, -1, 0]], (3, 1, 2))
    assert association.false_alarms == ((0, 1),)
    with pytest.raises(AssociationError, match=r"labels\[1\]\[1\] repeats 'a'"):
        Association.from_labels([["b"], ["a", "a"]])


def test_from_labels_of_nothing_is_the_empty_association() -> None:
    assert Association.from_labels([[], []]) == Association([], (0, 0))


LABELS = st.lists(st.sampled_from(["a", "b", "c", None]), min_size=3, max_size=3).filter(
    lambda labels: all(labels.count(label) <= 1 for label in "abc")
)


def full_tables(n: int) -> Iterator[Association]:
    for matched in itertools.permutations(range(n)):
        yield Association([[i, j] for i, j in enumerate(matched)], (n, n))


@given(LABELS, LABELS)
def test_a_full_table_of_two_scans_respects_labels_exactly_when_all_its_pairs_are_allowed(
    first_labels: list[str | None], second_labels: list[str | None]
) -> None:
    first = BearingScan([0.1, 0.2, 0.3], labels=first_labels)
    second = BearingScan([0.1, 0.2, 0.3], labels=second_labels)
    allowed = allowed_pairs(first, second)
    for table in full_tables(3):
        by_pairs = all(allowed[i, j] for i, j in table.table.tolist())
        assert by_pairs == respects_labels(table, [first, second])


def tables_of_two_scans(n: int) -> Iterator[Association]:
    """Every way to pair some detections of two scans and leave the others landmarks seen once."""
    for matched in itertools.product(range(-1, n), repeat=n):
        chosen = [j for j in matched if j != -1]
        if len(set(chosen)) == len(chosen):
            rows = [[i, j] for i, j in enumerate(matched)]
            yield Association([*rows, *([-1, j] for j in range(n) if j not in chosen)], (n, n))


@given(LABELS, LABELS)
def test_a_pair_is_allowed_exactly_when_some_association_of_the_two_scans_has_it(
    first_labels: list[str | None], second_labels: list[str | None]
) -> None:
    scans = [BearingScan([0.1, 0.2, 0.3], labels=names) for names in (first_labels, second_labels)]
    possible = np.zeros((3, 3), dtype=bool)
    for association in tables_of_two_scans(3):
        if respects_labels(association, scans):
            for i, j in association.table.tolist():
                if i != -1 and j != -1:
                    possible[i, j] = True
    assert np.array_equal(allowed_pairs(*scans), possible)


def test_without_labels_everything_is_allowed() -> None:
    first, second = BearingScan([0.1, 0.2]), BearingScan([0.3, 0.4, 0.5])
    assert allowed_pairs(first, second).shape == (2, 3)
    assert allowed_pairs(first, second).all()
    assert respects_labels(Association([], (2, 3)), [first, second])


def test_labels_two_scans_apart_still_bind() -> None:
    labelled, plain = BearingScan([0.1, 0.2], labels=["a", "b"]), BearingScan([0.1, 0.2])
    scans = [labelled, plain, labelled]
    assert respects_labels(Association([[0, 1, 0], [1, 0, 1]], (2, 2, 2)), scans)
    assert not respects_labels(Association([[0, 1, 1], [1, 0, 0]], (2, 2, 2)), scans)
    split = Association([[0, 1, -1], [-1, -1, 0], [1, 0, 1]], (2, 2, 2))
    assert not respects_labels(split, scans)


def test_a_known_landmark_is_no_false_alarm() -> None:
    scans = [BearingScan([0.1], labels=["a"]), BearingScan([0.1])]
    assert not respects_labels(Association([[-1, 0]], (1, 1)), scans)
    assert respects_labels(Association([[0, MISSED]], (1, 1)), scans)


@pytest.mark.parametrize("labels", [None, [1, 2], [[["a"]]]])
def test_labels_that_are_no_lists_of_names_are_refused(labels):
    with pytest.raises(AssociationError, match="labels"):
        Association.from_labels(labels)


def test_no_scans_have_an_empty_association():
    assert Association.from_labels([]) == Association([], ())


@pytest.mark.parametrize("scans", [None, "0", ["a"]])
def test_a_restriction_to_something_else_than_scan_indices_is_refused(scans):
    with pytest.raises(AssociationError, match="scans"):
        Association([[0, 0]], (1, 1)).restrict(scans)


def test_an_array_of_no_dimension_is_no_row() -> None:
    association = Association([[0, 0]], (1, 1))
    with pytest.raises(AssociationError, match="give a sequence of scan indices"):
        association.restrict(np.array(0))  # type: ignore[arg-type]
    with pytest.raises(AssociationError, match=r"labels\[1\]"):
        Association.from_labels([["a"], np.array("a")])  # type: ignore[list-item]


def test_more_detections_than_memory_holds_are_refused() -> None:
    with pytest.raises(AssociationError, match="from 0 to 1000000"):
        Association([], (2**40,))
