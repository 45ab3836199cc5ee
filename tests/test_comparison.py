"""`compare` sets polygon scores beside graph evidence, row by row."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.association import Association
from mht_slam.comparison import compare
from mht_slam.errors import AssociationError, OptionError
from mht_slam.hypotheses import Hypothesis, Posterior, RankedAssociation, Ranking
from mht_slam.models import ObservationModel

TABLES = [
    Association(np.column_stack([range(3), second, third]), (3, 3, 3))
    for second, third in itertools.product(itertools.permutations(range(3)), repeat=2)
]


def ranking_of(scores: dict[int, float], scans: tuple[int, ...] = (0, 1, 2)) -> Ranking:
    ordered = sorted(scores, key=lambda k: (-scores[k], k))
    ranked = tuple(RankedAssociation(TABLES[k], scores[k], base=(0, 1)) for k in ordered)
    return Ranking(ranked, scans=scans, base=(0, 1), complete=True, gap=0.0, epsilon=0.05)


def posterior_of(evidences: dict[int, float], scans: tuple[int, ...] = (0, 1, 2)) -> Posterior:
    ordered = sorted(evidences, key=lambda k: (-evidences[k], k))
    hypotheses = tuple(
        Hypothesis(
            association=TABLES[k],
            score=None,
            log_likelihood=evidences[k],
            log_evidence=evidences[k],
            probability=0.0,
            failure=None if math.isfinite(evidences[k]) else "made to fail",
        )
        for k in ordered
    )
    return Posterior(hypotheses, scans=scans, model=ObservationModel(sigma=0.01))


def naive_tau_b(x: list[float], y: list[float]) -> float | None:
    """Kendall's tau-b by counting every pair."""
    balance = x_pairs = y_pairs = 0
    for i, j in itertools.combinations(range(len(x)), 2):
        a, b = np.sign(x[i] - x[j]), np.sign(y[i] - y[j])
        balance += int(a * b)
        x_pairs += int(a != 0)
        y_pairs += int(b != 0)
    return balance / math.sqrt(x_pairs * y_pairs) if x_pairs and y_pairs else None


SCORES = st.dictionaries(st.integers(0, 11), st.sampled_from([0.1, 0.2, 0.5, 0.9]), max_size=8)
EVIDENCES = st.dictionaries(
    st.integers(0, 11), st.sampled_from([-9.0, -4.0, -1.0, -math.inf]), max_size=8
)


@given(SCORES, EVIDENCES)
def test_rows_follow_the_posterior_and_tau_counts_the_rows_with_both_scores(
    scores: dict[int, float], evidences: dict[int, float]
) -> None:
    ranking, posterior = ranking_of(scores), posterior_of(evidences)
    comparison = compare(ranking, posterior)
    assert [row.association for row in comparison.rows] == [h.association for h in posterior]
    assert [row.evidence_rank for row in comparison.rows] == list(range(1, len(posterior) + 1))
    for row in comparison.rows:
        listed = [h.association for h in ranking]
        if row.association in listed:
            assert row.polygon_rank == listed.index(row.association) + 1
            assert row.polygon_score == ranking[row.polygon_rank - 1].score
        else:
            assert row.polygon_rank is None
            assert row.polygon_score is None
    both = [k for k in scores if math.isfinite(evidences.get(k, -math.inf))]
    expected = naive_tau_b([scores[k] for k in both], [evidences[k] for k in both])
    assert comparison.kendall_tau == (None if expected is None else pytest.approx(expected))


@given(SCORES, EVIDENCES, st.integers(0, 11))
def test_the_truths_ranks_are_its_places_and_none_where_it_is_missing(
    scores: dict[int, float], evidences: dict[int, float], truth: int
) -> None:
    ranking, posterior = ranking_of(scores), posterior_of(evidences)
    comparison = compare(ranking, posterior, TABLES[truth])
    polygon = [h.association for h in ranking]
    evidence = [h.association for h in posterior]
    if truth in scores:
        assert comparison.truth_polygon_rank == polygon.index(TABLES[truth]) + 1
    else:
        assert comparison.truth_polygon_rank is None
    if truth in evidences:
        assert comparison.truth_evidence_rank == evidence.index(TABLES[truth]) + 1
    else:
        assert comparison.truth_evidence_rank is None


def test_without_a_truth_there_are_no_ranks_of_it() -> None:
    comparison = compare(ranking_of({0: 0.5}), posterior_of({0: -1.0}))
    assert comparison.truth_polygon_rank is None
    assert comparison.truth_evidence_rank is None


@pytest.mark.parametrize(
    ("scores", "evidences", "agree"),
    [
        ({0: 0.9, 1: 0.1}, {0: -1.0, 1: -2.0}, True),
        ({0: 0.9, 1: 0.1}, {0: -2.0, 1: -1.0}, False),
        ({}, {0: -1.0}, False),
        ({0: 0.9}, {}, False),
        ({0: 0.9}, {0: -math.inf}, False),
    ],
)
def test_both_agree_when_they_put_the_same_association_first(
    scores: dict[int, float], evidences: dict[int, float], agree: bool
) -> None:
    assert compare(ranking_of(scores), posterior_of(evidences)).top1_agree is agree


@pytest.mark.parametrize("n", [0, 1])
def test_tau_is_undefined_for_fewer_than_two_rows(n: int) -> None:
    scores, evidences = dict.fromkeys(range(n), 0.1), dict.fromkeys(range(n), -1.0)
    assert compare(ranking_of(scores), posterior_of(evidences)).kendall_tau is None


def test_results_of_different_scans_are_not_compared() -> None:
    with pytest.raises(AssociationError, match="same scans"):
        compare(ranking_of({0: 0.5}), posterior_of({0: -1.0}, scans=(0, 1, 3)))
    with pytest.raises(AssociationError, match="same scans"):
        compare(ranking_of({0: 0.5}), posterior_of({0: -1.0}), Association([], (3, 3)))


def test_only_a_ranking_and_a_posterior_are_compared() -> None:
    with pytest.raises(OptionError, match="posterior is float"):
        compare(ranking_of({0: 0.5}), 0.0)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="ranking is list"):
        compare([], posterior_of({0: -1.0}))  # type: ignore[arg-type]
