"""What weighing associations has in common: candidates, model, sizes, probabilities."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.association import MISSED, Association
from mht_slam.errors import AssociationError, OptionError
from mht_slam.evidence.visibility import detection_chances, log_visibility
from mht_slam.hypotheses import Hypothesis, Posterior, RankedAssociation, Ranking
from mht_slam.measurements import RunPair, StraightRun
from mht_slam.models import ObservationModel

Candidates: TypeAlias = Ranking | Posterior | Iterable[Association | RankedAssociation | Hypothesis]


class Candidate(NamedTuple):
    """An association to weigh, its polygon score, and an estimate to start from, where known."""

    association: Association
    score: float | None
    start: tuple[FloatArray, FloatArray] | None = None


def distinct_candidates(
    run: StraightRun | RunPair, candidates: Candidates, scans: Sequence[int] | None = None
) -> tuple[tuple[int, ...], list[Candidate]]:
    """Return scan indices, and every different candidate.

    The scans are those of a `Ranking` or `Posterior`, else `scans`, else all of the run. Raises
    `AssociationError` for candidates of other scans, or something else than candidates.
    """
    chosen = tuple(range(len(run))) if scans is None else tuple(scans)
    if isinstance(candidates, Ranking | Posterior):
        if max(candidates.scans, default=-1) >= len(run):
            raise AssociationError(
                f"candidates are over scans {candidates.scans}, the run has scans 0 to "
                f"{len(run) - 1}: give candidates of this run"
            )
        chosen = candidates.scans
    elif not isinstance(candidates, Iterable) or (
        isinstance(candidates, np.ndarray) and candidates.ndim == 0
    ):
        raise AssociationError(
            f"candidates is {type(candidates).__name__}: give a Ranking, or a list of associations"
        )
    expected = tuple(run.n_detections[i] for i in chosen)
    different: dict[Association, Candidate] = {}
    for i, candidate in enumerate(candidates):
        if isinstance(candidate, Association):
            known = Candidate(candidate, None)
        elif isinstance(candidate, RankedAssociation):
            known = Candidate(candidate.association, candidate.score)
        elif isinstance(candidate, Hypothesis):
            known = Candidate(candidate.association, candidate.score, _estimate_of(candidate))
        else:
            raise AssociationError(
                f"candidates[{i}] is {type(candidate).__name__}: give a Ranking or associations"
            )
        counts = known.association.n_detections
        if counts != expected:
            raise AssociationError(
                f"candidates[{i}] is over scans with {counts} detections, the run has {expected}: "
                "give associations over the run's scans"
            )
        different.setdefault(known.association, known)
    return chosen, list(different.values())


def _estimate_of(hypothesis: Hypothesis) -> tuple[FloatArray, FloatArray] | None:
    if hypothesis.poses is None or hypothesis.landmarks is None:
        return None
    return hypothesis.poses, hypothesis.landmarks


def stated_model(
    run: StraightRun | RunPair,
    scans: tuple[int, ...],
    sigma: float | None,
    heading_sigma: float,
    lateral_sigma: float,
    model: ObservationModel | None,
) -> ObservationModel:
    """Return the model with the sigmas that replace its fields, or one with its defaults.

    Raises `OptionError` where no sigma is known, or for a model that is none.
    """
    if model is None:
        if sigma is None:
            with_detections = [run.scans[i] for i in scans if len(run.scans[i])]
            stated = [scan.sigma for scan in with_detections if scan.sigma is not None]
            if not stated or len(stated) < len(with_detections):
                raise OptionError(
                    "sigma is not known: give sigma= in radians, a model, or a sigma to every scan"
                )
            sigma = float(np.median(np.concatenate(stated)))
        return ObservationModel(
            sigma=sigma, heading_sigma=heading_sigma, lateral_sigma=lateral_sigma
        )
    if not isinstance(model, ObservationModel):
        raise OptionError(f"model is {type(model).__name__}: give an ObservationModel")
    changes: dict[str, Any] = {}
    if sigma is not None:
        changes["sigma"] = sigma
    if heading_sigma:
        changes["heading_sigma"] = heading_sigma
    if lateral_sigma:
        changes["lateral_sigma"] = lateral_sigma
    return replace(model, **changes)


def check_sizes(associations: Iterable[Association], model: ObservationModel) -> None:
    """Raise `OptionError` for associations whose sizes differ, unless the model compares them."""
    if model.compares_sizes:
        return
    # Over the same scans these two numbers leave one number of false alarms.
    sizes = {(a.n_landmarks, a.n_missed) for a in associations}
    if len(sizes) > 1:
        raise OptionError(
            "the candidates differ in their numbers of landmarks, misses or false alarms: give a "
            "model with detection_probability, false_alarm_rate and expected_landmarks"
        )


def size_weight(
    association: Association, model: ObservationModel, bearings: FloatArray | None = None
) -> float:
    """Log weight of landmarks, detections, misses and false alarms; 0 where not modelled.

    `bearings` (n, m), under which the scans would see the landmarks, tell which of them are outside
    a limited field of view; without them all count as inside.
    """
    if not model.compares_sizes:
        return 0.0
    assert model.expected_landmarks is not None  # noqa: S101 - narrows the type
    seen = np.asarray(association.table != MISSED)
    chances = detection_chances(model, seen, np.zeros(seen.shape) if bearings is None else bearings)
    landmarks = float(log_visibility(seen, chances, model.stay_probability).sum())
    landmarks += len(seen) * math.log(model.expected_landmarks)
    return landmarks + false_alarm_term(association, model)


def landmark_weight(model: ObservationModel, n_seen: int, n_missed: int) -> float:
    """Log weight of a landmark that some scans see and others miss; 0 where not modelled."""
    if not model.compares_sizes:
        return 0.0
    assert model.detection_probability is not None  # noqa: S101 - narrows the type
    assert model.expected_landmarks is not None  # noqa: S101 - narrows the type
    return (
        math.log(model.expected_landmarks)
        + n_seen * math.log(model.detection_probability)
        + _times_log(n_missed, 1.0 - model.detection_probability)
    )


def false_alarm_term(association: Association, model: ObservationModel) -> float:
    """Log weight of the false alarms alone; 0 where not modelled."""
    return false_alarm_weight(model, len(association.false_alarms))


def false_alarm_weight(model: ObservationModel, count: int) -> float:
    """Log weight of so many false alarms; 0 where not modelled, -inf where ruled out."""
    return 0.0 if model.false_alarm_rate is None else _times_log(count, model.false_alarm_rate)


def with_probabilities(hypotheses: list[Hypothesis]) -> tuple[Hypothesis, ...]:
    """Normalise and sort; equal evidences go by the table, failures last."""
    evidence = np.array([h.log_evidence for h in hypotheses])
    if np.isfinite(evidence).any():
        shares = np.exp(evidence - evidence.max())
        probabilities = (shares / shares.sum()).tolist()
    else:
        probabilities = [0.0] * len(hypotheses)
    weighed = [replace(h, probability=p) for h, p in zip(hypotheses, probabilities, strict=True)]
    return tuple(sorted(weighed, key=lambda h: (-h.log_evidence, h.association.sort_key())))


def _times_log(count: int, value: float) -> float:
    if count == 0:
        return 0.0
    return count * math.log(value) if value > 0.0 else -math.inf
