"""The multi-hypothesis estimator, as the study of drives calls it."""

from __future__ import annotations

from drive_scores import Answer

import mht_slam as ms
from mht_slam.datasets import Drive
from mht_slam.models import ObservationModel

OPTIONS = ("",)
"""What tuning may choose from; each is handed to `answer` as it stands here."""


def answer(drive: Drive, model: ObservationModel, option: str) -> Answer:
    """Feed the scans one by one, and return the best hypothesis with its estimate."""
    del option
    slam = ms.MultiHypothesisSlam(ms.SlamConfig(model=model))
    for scan in drive.scans:
        slam.update(scan)
    return Answer(slam.association, slam.trajectory)
