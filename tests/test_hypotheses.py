"""Rankings and posteriors are sequences; a posterior's summaries follow from its probabilities."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.association import Association
from mht_slam.errors import OptionError
from mht_slam.hypotheses import Hypothesis, Posterior, RankedAssociation, Ranking
from mht_slam.models import ObservationModel

TABLES = [
    Association([[0, a], [1, b], [2, c]], (3, 3)) for a, b, c in itertools.permutations(range(3))
]
MODEL = ObservationModel(sigma=0.01)


def posterior_of(
    probabilities: list[float], tables: list[Association] = TABLES, scans: tuple[int, ...] = (0, 2)
) -> Posterior:
    hypotheses = [
        Hypothesis(
            association=table,
            score=None,
            log_likelihood=-1.0,
            log_evidence=float(np.log(p)) if p else -np.inf,
            probability=p,
            failure=None if p else "made to fail",
        )
        for table, p in zip(tables, probabilities, strict=False)
    ]
    ordered = sorted(hypotheses, key=lambda h: -h.probability)
    return Posterior(hypotheses=tuple(ordered), scans=scans, model=MODEL)


PROBABILITIES = st.lists(st.floats(0.01, 1.0), min_size=1, max_size=6).map(
    lambda weights: [w / sum(weights) for w in weights]
)


@given(PROBABILITIES)
def test_a_marginal_is_the_sum_over_hypotheses_that_make_the_pair_one_landmark(
    probabilities: list[float],
) -> None:
    posterior = posterior_of(probabilities)
    marginal = posterior.marginal_same_landmark()
    detections = [(0, 0), (0, 1), (0, 2), (2, 0), (2, 1), (2, 2)]
    assert posterior.detections.tolist() == [list(d) for d in detections]
    column = {0: 0, 2: 1}
    for (i, a), (j, b) in itertools.product(enumerate(detections), repeat=2):
        expected = sum(
            h.probability
            for h in posterior
            if any(
                row[column[a[0]]] == a[1] and row[column[b[0]]] == b[1]
                for row in h.association.table.tolist()
            )
        )
        assert marginal[i, j] == pytest.approx(expected if a[0] != b[0] or i == j else 0.0)
    assert (np.diag(marginal) == 1.0).all()
    assert not marginal.flags.writeable


def test_false_alarms_share_no_landmark() -> None:
    posterior = posterior_of([1.0], [Association([], (2, 1))])
    assert np.array_equal(posterior.marginal_same_landmark(), np.eye(3))


def test_where_every_candidate_failed_only_the_diagonal_is_left() -> None:
    posterior = posterior_of([0.0, 0.0])
    assert np.array_equal(posterior.marginal_same_landmark(), np.eye(6))
    assert posterior.credible_set() == ()
    assert posterior.entropy() == 0.0


def test_an_empty_posterior_is_legal() -> None:
    posterior = posterior_of([])
    assert len(posterior) == 0
    assert posterior.detections.shape == (0, 2)
    assert posterior.marginal_same_landmark().shape == (0, 0)
    assert posterior.credible_set() == ()


@given(PROBABILITIES, st.floats(0.01, 0.999))
def test_the_credible_set_is_the_smallest_that_holds_the_level(
    probabilities: list[float], level: float
) -> None:
    posterior = posterior_of(probabilities)
    chosen = posterior.credible_set(level)
    total = sum(h.probability for h in chosen)
    assert total >= level or len(chosen) == len(posterior)
    assert total - chosen[-1].probability < level
    assert chosen == posterior[: len(chosen)]


@pytest.mark.parametrize("level", [0.0, -0.5, 1.5, float("nan")])
def test_a_level_that_is_no_probability_is_refused(level: float) -> None:
    with pytest.raises(OptionError, match="level"):
        posterior_of([1.0]).credible_set(level)


@pytest.mark.parametrize("n", [1, 2, 6])
def test_the_entropy_of_equal_probabilities_counts_them(n: int) -> None:
    assert np.exp(posterior_of([1 / n] * n).entropy()) == pytest.approx(n)


def test_a_failed_hypothesis_has_no_graph() -> None:
    with pytest.raises(ValueError, match="made to fail"):
        posterior_of([0.0])[0].to_gtsam()


def test_rankings_and_posteriors_are_sequences() -> None:
    ranked = tuple(RankedAssociation(t, 0.5, base=(0, 1)) for t in TABLES[:3])
    ranking = Ranking(ranked, scans=(0, 1), base=(0, 1), complete=True, gap=0.0, epsilon=0.05)
    for sequence, items in ((ranking, ranked), (p := posterior_of([0.6, 0.4]), p.hypotheses)):
        assert len(sequence) == len(items)
        assert list(sequence) == list(items)
        assert sequence[0] is items[0]
        assert sequence[-1] is items[-1]
        assert sequence[1:] == items[1:]


def test_a_ranked_association_without_base_cells_has_no_map() -> None:
    assert RankedAssociation(TABLES[0], 0.0, base=(0, 1)).map_in_landmark_frame is None
