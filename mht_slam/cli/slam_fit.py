"""`mht-slam slam FILE --fit`: what is assumed of landmarks and detections, fitted to the file."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from mht_slam.cli.study import progress_bar
from mht_slam.datasets import stream_scans
from mht_slam.errors import MeasurementError, ScanFileError
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.estimator import MultiHypothesisSlam
from mht_slam.incremental.fit_config import PARAMETERS, fit_slam_config
from mht_slam.measurements import BearingScan


def fitted_to(path: Path, config: SlamConfig) -> SlamConfig:
    """Return the configuration with the model of most evidence, and tell its numbers on stderr.

    Lines that are rejected take no part. Raises `ScanFileError` for a file without usable scans.
    """
    scans = _usable(path, config)
    if not scans:
        raise ScanFileError(f"{path}: no scan could be used: give at least one")
    with progress_bar("fitting the model") as progress:
        fitted = fit_slam_config([scans], config, progress=progress)
    model = fitted.config.observation_model
    numbers = ", ".join(f"{name} {getattr(model, name):.3g}" for name in PARAMETERS)
    sys.stderr.write(f"Fitted in {len(fitted.trials)} runs: {numbers}.\n")
    return fitted.config


def _usable(path: Path, config: SlamConfig) -> list[BearingScan]:
    """Return the scans that the estimator takes."""
    # One hypothesis is enough to know that.
    slam = MultiHypothesisSlam(replace(config, hypotheses=1, start_hypotheses=1))
    scans: list[BearingScan] = []
    with stream_scans(path) as stream:
        for _, entry in stream:
            if isinstance(entry, ScanFileError):
                continue
            try:
                slam.update(entry.scan)
            except MeasurementError:
                continue
            scans.append(entry.scan)
    return scans
