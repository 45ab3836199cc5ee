"""The multi-hypothesis estimator, as the study of drives calls it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from drive_scores import Answer

import mht_slam as ms
from mht_slam.datasets import Drive
from mht_slam.models import ObservationModel

OPTIONS = ("10 hypotheses",)
FITTED = ("10 hypotheses, fitted",)
ANEW = ("10 hypotheses, drawn anew",)
FITTED_ANEW = ("10 hypotheses, fitted, drawn anew",)
ONE = ("1 hypothesis",)
"""What tuning may choose from; each is handed to `answer` as it stands here."""
REMAPS = 6
"""Maps drawn anew, where an option says so."""


def answer(drive: Drive, model: ObservationModel, option: str) -> Answer:
    """Feed the scans one by one, and return the best hypothesis with its estimate.

    "fitted": under the model that is fitted to this very drive, without its labels.
    "drawn anew": with `REMAPS` maps drawn anew in hindsight, after the model is fitted.
    """
    config = ms.SlamConfig(model=model, hypotheses=int(option.split()[0]))
    if "fitted" in option:
        config = ms.fit_slam_config([drive.scans], config).config
    if "drawn anew" in option:
        config = replace(config, remaps=REMAPS)
    slam = ms.MultiHypothesisSlam(config)
    for scan in drive.scans:
        slam.update(scan)
    points = slam.map.points
    return Answer(slam.association, slam.trajectory, points, np.arange(len(points)))
