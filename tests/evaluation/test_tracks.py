"""IDF1 is the best one-to-one naming of landmarks by tracks, and switches are counted in time."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.association import MISSED, Association
from mht_slam.errors import AssociationError, OptionError
from mht_slam.evaluation.tracks import TrackCounts, pooled_tracks, track_counts

N = 3
LABELS = st.lists(
    st.permutations([0, 1, 2, None]).map(lambda order: order[:N]), min_size=1, max_size=6
)


def best_naming(answer: Association, truth: Association) -> int:
    """Detections shared when every landmark is named by another track, or none: all namings."""
    mine, theirs = answer.flat_labels(), truth.flat_labels()
    names = [*range(answer.n_landmarks), *([MISSED - 1] * truth.n_landmarks)]
    return max(
        sum(int(((mine == name) & (theirs == row)).sum()) for row, name in enumerate(naming))
        for naming in permutations(names, truth.n_landmarks)
    )


def switches(answer: Association, truth: Association) -> int:
    """Walk through the scans and remember who had each landmark last."""
    last: dict[int, int] = {}
    count = 0
    pairs = zip(answer.landmark_of_detection(), truth.landmark_of_detection(), strict=True)
    for mine, theirs in pairs:
        for track, landmark in zip(mine.tolist(), theirs.tolist(), strict=True):
            if MISSED in (track, landmark):
                continue
            count += last.get(landmark, track) != track
            last[landmark] = track
    return count


@given(LABELS, st.data())
def test_counts_are_those_of_all_namings_and_of_a_walk_through_the_scans(
    labels: list[list[object]], data: st.DataObject
) -> None:
    answer = Association.from_labels(labels)
    orders = [data.draw(st.permutations(scan)) for scan in labels]
    truth = Association.from_labels(orders)
    counts = track_counts(answer, truth)
    assert counts.shared == best_naming(answer, truth)
    assert counts.switches == switches(answer, truth)
    assert counts.tracked == sum(label is not None for scan in labels for label in scan)
    assert counts.true == sum(label is not None for scan in orders for label in scan)
    assert 0.0 <= counts.idf1 <= 1.0


@given(LABELS)
def test_the_truth_itself_is_perfect(labels: list[list[object]]) -> None:
    truth = Association.from_labels(labels)
    counts = track_counts(truth, truth)
    assert counts.idf1 == 1.0
    assert counts.switches == 0


def test_short_tracks_are_left_out_of_the_answer_alone() -> None:
    truth = Association([[0, 0, 0], [1, 1, -1]], (2, 2, 1))
    answer = Association([[0, 0, 0], [1, -1, -1], [-1, 1, -1]], (2, 2, 1))
    assert track_counts(answer, truth) == TrackCounts(shared=4, tracked=5, true=5, switches=1)
    assert track_counts(answer, truth, shortest=2) == TrackCounts(3, 3, 5, 0)
    assert track_counts(answer, truth, shortest=9).idf1 == 0.0
    assert track_counts(Association([], (1,)), Association([], (1,))).idf1 == 1.0


def test_pooled_counts_are_sums() -> None:
    assert pooled_tracks([TrackCounts(3, 4, 5, 1), TrackCounts(1, 1, 1, 0)]) == (4, 5, 6, 1)
    assert pooled_tracks([]) == (0, 0, 0, 0)
    assert np.isclose(TrackCounts(4, 5, 6, 1).idf1, 8 / 11)


def test_associations_of_other_detections_are_refused() -> None:
    one, other = Association([[0]], (1,)), Association([[0]], (2,))
    with pytest.raises(AssociationError, match="same scans"):
        track_counts(one, other)
    with pytest.raises(OptionError, match="shortest"):
        track_counts(one, one, shortest=0)
    with pytest.raises(AssociationError, match="truth is list"):
        track_counts(one, [[0]])  # type: ignore[arg-type]
