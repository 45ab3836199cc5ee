"""Fit the model of the estimator to drives that nobody has labelled, by their own evidence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import gtsam
import numpy as np

from mht_slam.arrays import FloatArray, whole_number
from mht_slam.errors import OptionError
from mht_slam.fitting import BOUNDS, bounded_value, free_value
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.estimator import MultiHypothesisSlam
from mht_slam.incremental.run_evidence import log_run_evidence
from mht_slam.incremental.whole_run import WholeRun
from mht_slam.measurements import BearingScan
from mht_slam.models import ObservationModel
from mht_slam.parallel import ordered_map
from mht_slam.progress import Progress

PARAMETERS = (
    "landmark_sigma",
    "expected_landmarks",
    "stay_probability",
    "false_alarm_rate",
    "detection_probability",
)
"""What is fitted, in this order."""
STARTS = (0.0, 1.0, 2.0)
"""How much nearer and how much more restless landmarks are at each start than stated, in logs."""
STEPS = (0.7, 0.35, 0.18)
"""Steps of the search, in log or log odds, from coarse to fine."""
SWEEPS = 2
"""Times that each parameter is moved at each step."""
LEAST = 1.0
"""Nats that a round has to gain, or it was the last."""


@dataclass(frozen=True)
class Trial:
    """The drives under one model: -inf where one of them has no smoothed run."""

    model: ObservationModel
    log_evidence: float


@dataclass(frozen=True)
class FittedSlamConfig:
    """What `fit_slam_config` found.

    Attributes
    ----------
    config : with the model of most evidence.
    log_evidence : of all drives under it.
    trials : every model that the drives were run under, in order.
    """

    config: SlamConfig
    log_evidence: float
    trials: tuple[Trial, ...]


def fit_slam_config(
    drives: Sequence[Sequence[BearingScan]],
    start: SlamConfig,
    *,
    rounds: int = 4,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> FittedSlamConfig:
    """Fit what is stated of landmarks and detections to drives without known identities.

    The estimator stands or falls with the density of landmarks, with how far they are seen and how
    soon they leave the view, and few who state them have counted. The objective is the evidence of
    the whole runs (`log_run_evidence`), which needs no truth. All drives are run under the model as
    stated and under two with landmarks nearer and more restless by e and by e^2; from the best, in
    turn, the model climbs with the associations held, and the drives are run anew, until the
    evidence no longer rises: a hard expectation-maximisation from three starts.

    Parameters
    ----------
    drives : scans of each; one is enough, the drive in question itself.
    start : configuration and model to start from. Motion, the noise of bearings, the field of view
        and parameters at the edge of their range (`mht_slam.fitting.BOUNDS`) stay as they are.
    rounds : at most; each costs one run of all drives, the starts three.
    executor : runs drives in parallel; the result does not depend on it.
    progress : called as ``progress(done, total)``, in runs of a drive.

    Raises `OptionError` without drives, for drives without scans or that are none, and where no
    model has a solution; `MeasurementError` for scans that the estimator refuses.

    Source: docs/incremental.md; for the maximisation with associations held, M. Kearns, Y. Mansour,
    A. Ng, "An Information-Theoretic Analysis of Hard and Soft Assignment Methods for Clustering",
    1997.
    """
    whole_number(rounds, "rounds", at_least=0)
    if not drives:
        raise OptionError("there are no drives: give at least one to fit to")
    for i, scans in enumerate(drives):
        if isinstance(scans, BearingScan) or not isinstance(scans, Sequence):
            raise OptionError(
                f"drives[{i}] is {type(scans).__name__}: give a sequence of drives, each a "
                "sequence of scans, [scans] for one drive"
            )
        if not scans:
            raise OptionError(f"drives[{i}] has no scans: leave it out")
    if not isinstance(start, SlamConfig):
        raise OptionError(f"start is {start!r}: give a SlamConfig")
    model = start.observation_model
    total = (len(STARTS) + rounds) * len(drives)
    trials: list[Trial] = []
    best: tuple[Trial, list[_Read]] | None = None

    def run(tried: ObservationModel) -> bool:
        """Run all drives; whether that is the best so far by enough."""
        nonlocal best
        reads: list[_Read] = []
        for read in ordered_map(executor, partial(_read, replace(start, model=tried)), drives):
            if read is not None:
                reads.append(read)
            if progress is not None:
                progress(min(len(trials) * len(drives) + len(reads), total), total)
        solved = len(reads) == len(drives)
        evidence = _log_evidence(reads, start, tried) if solved else -math.inf
        trials.append(Trial(tried, evidence))
        if evidence == -math.inf or (best is not None and evidence < best[0].log_evidence):
            return False
        enough = best is None or evidence >= best[0].log_evidence + LEAST
        best = trials[-1], reads
        return enough

    for nearer in STARTS:
        run(_moved(model, {"landmark_sigma": -nearer, "stay_probability": -nearer}))
    if best is None:
        raise OptionError("no model tried has a solution for all drives: start from another one")
    for _ in range(rounds):
        if not run(_climbed(best[1], start, best[0].model)):
            break
    if progress is not None:
        progress(total, total)
    return FittedSlamConfig(
        replace(start, motion=None, model=best[0].model), best[0].log_evidence, tuple(trials)
    )


@dataclass(frozen=True, eq=False)
class _Read:
    """A drive as the estimator reads it under some model."""

    whole: WholeRun
    bearings: list[FloatArray]
    sigmas: list[FloatArray]


def _read(config: SlamConfig, scans: Sequence[BearingScan]) -> _Read | None:
    slam = MultiHypothesisSlam(config)
    for scan in scans:
        slam.update(scan)
    try:
        whole = slam.whole_run
    except RuntimeError:  # of GTSAM: no solution
        return None
    whole = replace(whole, graph=gtsam.NonlinearFactorGraph(), values=gtsam.Values())  # light
    sigma = config.observation_model.sigma
    sigmas = [np.full(len(s), sigma) if s.sigma is None else s.sigma for s in scans]
    return _Read(whole, [scan.bearings for scan in scans], sigmas)


def _log_evidence(reads: Sequence[_Read], config: SlamConfig, model: ObservationModel) -> float:
    config = replace(config, model=model)
    return sum(log_run_evidence(read.whole, read.bearings, read.sigmas, config) for read in reads)


def _climbed(
    reads: Sequence[_Read], config: SlamConfig, model: ObservationModel
) -> ObservationModel:
    """Improve one parameter after another, as the drives are read."""
    best = _log_evidence(reads, config, model)
    for step in STEPS:
        for name in SWEEPS * PARAMETERS:
            for stride in (step, -step):
                tried = _moved(model, {name: stride})
                evidence = _log_evidence(reads, config, tried)
                if evidence > best:
                    model, best = tried, evidence
                    break
    return model


def _moved(model: ObservationModel, strides: dict[str, float]) -> ObservationModel:
    """Return the model with parameters moved, in log or log odds, inside their bounds."""
    changes: dict[str, Any] = {}
    for name, stride in strides.items():
        value, (low, high) = getattr(model, name), BOUNDS[name]
        if stride and low < value < high:  # as stated, to the last bit, where it is not moved
            changes[name] = bounded_value(name, free_value(name, value) + stride)
    return replace(model, **changes)
