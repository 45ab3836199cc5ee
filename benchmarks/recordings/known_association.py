"""Ceilings: the graph of the true association, and assignment to the true map from true poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from drive_scores import Answer, NotApplicableError, answer_of

from mht_slam.association import Association
from mht_slam.datasets import Drive
from mht_slam.evaluation.ceilings import assignment_given_truth, seen_span
from mht_slam.evaluation.known_association import known_association
from mht_slam.models import ObservationModel

OPTIONS = ("",)
GATES = ("gate 2", "gate 3", "gate 6", "gate 10")
"""Standard deviations of a bearing within which a detection is assigned."""
WEAK_PRIOR = 30.0
"""Metres: landmarks of a known association need a prior only against running away."""
IN_VIEW_GAP = 20
"""A landmark is in view between detections at most this many scans apart."""


def answer(drive: Drive, model: ObservationModel, option: str) -> Answer:
    """Solve the graph of the true association: the ceiling for trajectory and map."""
    del option
    if drive.stretches != ((0, len(drive) - 1),):
        raise NotApplicableError(f"{drive.name} has identities in stretches only")
    truth = drive.truth()
    if model.motion == "odometry":
        model = replace(model, landmark_sigma=WEAK_PRIOR)
    return answer_of(truth, known_association(drive.scans, truth, model))


def given_truth(drive: Drive, model: ObservationModel, option: str) -> Answer:
    """Assign detections to all true landmarks: the ceiling for the association."""
    return _assigned(drive, model, option, in_view=False)


def given_truth_and_view(drive: Drive, model: ObservationModel, option: str) -> Answer:
    """Assign them to the true landmarks that are in view, which the truth tells."""
    return _assigned(drive, model, option, in_view=True)


def _assigned(drive: Drive, model: ObservationModel, option: str, *, in_view: bool) -> Answer:
    if not drive.reference_landmarks or not np.isfinite(drive.reference_poses).all():
        raise NotApplicableError(f"{drive.name} has no reference poses and map")
    truth = drive.truth()
    association = assignment_given_truth(
        drive,
        drive.reference_poses,
        _landmarks(drive, truth),
        model.sigma,
        float(option.removeprefix("gate ")),
        in_view=seen_span(truth, IN_VIEW_GAP) if in_view else None,
    )
    return Answer(association)


def _landmarks(drive: Drive, truth: Association) -> np.ndarray:
    """Reference position of each row of the truth, (n, 2)."""
    identities = np.concatenate(drive.identities)
    rows = truth.flat_labels()
    seen = rows >= 0
    of_row = dict(zip(rows[seen].tolist(), identities[seen].tolist(), strict=True))
    places = [drive.reference_landmarks[of_row[row]] for row in range(truth.n_landmarks)]
    return np.array(places).reshape(-1, 2)
