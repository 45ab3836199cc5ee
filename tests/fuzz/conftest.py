"""What every hostile input must end in: a sound result, or an error of the library's own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest
import shapely

import mht_slam as ms
from mht_slam.errors import MhtSlamError

Survives = Callable[..., Any]

MAY_BE_INFINITE = {
    "log_evidence",
    "log_likelihood",
    "epsilon",
    "smallest_epsilon",
    "ratio_intervals",
}
"""Documented: evidence of a failure is -inf, an epsilon that explains nothing inf, ratios open."""
ROUNDING = 1e-9


@pytest.fixture(scope="session")
def survives() -> Survives:
    """Call a public function; return what it returns, or None where it refuses its input.

    Everything returned is looked through: no nan, infinities only where documented, probabilities
    that are probabilities. Anything but an error of the library's own fails the test.
    """

    def call(function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        try:
            result = function(*args, **kwargs)
        except MhtSlamError as refusal:
            assert str(refusal), "an error without a message"
            return None
        check_sound(result, function.__name__)
        return result

    return call


def check_sound(value: Any, name: str) -> None:
    """Fail for anything that must not leave the library."""
    match value:
        case float() | np.floating():
            assert not np.isnan(value), f"{name} is nan"
            assert name in MAY_BE_INFINITE or np.isfinite(value), f"{name} is {value}"
        case np.ndarray():
            assert not value.flags.writeable, f"{name} can be written to"
            if value.dtype.kind == "f":
                assert not np.isnan(value).any(), f"{name} holds nan"
                assert name in MAY_BE_INFINITE or np.isfinite(value).all(), f"{name} holds inf"
        case ms.Posterior():
            check_members(value)
            check_posterior(value)
        case ms.Ranking():
            check_members(value)
            check_ranking(value)
        case ms.Association():
            check_sound(value.table, "table")
        case tuple() | list():
            for item in value:
                check_sound(item, name)
        case shapely.geometry.base.BaseGeometry():
            assert np.isfinite(shapely.get_coordinates(value)).all(), f"{name} is not finite"
        case _ if is_dataclass(value):
            check_members(value)


def check_members(value: Any) -> None:
    for field in fields(value):
        if not field.name.startswith("_"):
            check_sound(getattr(value, field.name), field.name)


def check_posterior(posterior: ms.Posterior) -> None:
    probabilities = np.array([h.probability for h in posterior])
    total = float(probabilities.sum())
    assert (probabilities >= 0.0).all()
    some = any(np.isfinite(h.log_evidence) for h in posterior)
    assert abs(total - (1.0 if some else 0.0)) < ROUNDING, f"probabilities sum to {total}"
    assert (np.diff(probabilities) <= 0.0).all(), "the posterior is not in order"
    assert posterior.covered is None or 0.0 <= posterior.covered <= 1.0
    for hypothesis in posterior:
        assert hypothesis.log_evidence < np.inf
        failed = hypothesis.failure is not None
        assert failed == (hypothesis.log_evidence == -np.inf), "a failure, or an evidence"
        for covariances in (hypothesis.landmark_covariances, hypothesis.pose_covariances):
            if covariances is not None:
                variances = np.diagonal(covariances, axis1=1, axis2=2)
                assert (variances >= 0.0).all(), "a negative variance"
    marginal = posterior.marginal_same_landmark()
    assert ((marginal >= 0.0) & (marginal <= 1.0)).all()
    check_sound(posterior.entropy(), "entropy")
    posterior.credible_set(0.9)
    for hypothesis in posterior[:1]:
        if hypothesis.poses is not None:
            graph, values, _ = hypothesis.to_gtsam()
            assert np.isfinite(graph.error(values))


def check_ranking(ranking: ms.Ranking) -> None:
    assert all(0.0 <= h.score <= 1.0 for h in ranking)
    assert all((h.score == 0.0) == (h.zero_reason is not None) for h in ranking)
    for hypothesis in ranking[:1]:
        drawn = hypothesis.map_in_landmark_frame
        if drawn is not None:
            check_sound(drawn, "map")
