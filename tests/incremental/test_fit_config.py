"""The model of the estimator fitted to drives without labels: evidence rises, a yard is counted."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import mht_slam as ms
from mht_slam.errors import OptionError
from mht_slam.fitting import BOUNDS
from mht_slam.incremental import fit_config
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.fit_config import FittedSlamConfig, fit_slam_config
from mht_slam.measurements import BearingScan
from mht_slam.simulation import OdometryNoise, simulate_drive

from .drives import fed
from .rows import SIGMA

WIDE = SlamConfig(
    hypotheses=4,
    start_hypotheses=20,
    model=ms.ObservationModel(
        sigma=SIGMA,
        motion="odometry",
        landmark_sigma=15.0,
        detection_probability=0.9,
        false_alarm_rate=0.06,
        expected_landmarks=8.0,
        stay_probability=0.97,
    ),
)
"""For a small yard far too wide and too calm."""


def yard(seed: int, n_landmarks: int = 20, n_scans: int = 30) -> list[BearingScan]:
    rng = np.random.default_rng([seed, n_landmarks, n_scans])
    drive = simulate_drive("loop", n_landmarks, n_scans, rng, sigma=SIGMA, odometry=OdometryNoise())
    return list(drive.scans)


@pytest.fixture(scope="module")
def fitted() -> FittedSlamConfig:
    """To one dense yard."""
    return fit_slam_config([yard(2)], WIDE, rounds=2)


def test_a_dense_restless_yard_is_seen_to_be_one(fitted: FittedSlamConfig) -> None:
    """Twenty landmarks within metres of the path: nearer and more restless than stated."""
    model = fitted.config.observation_model
    assert model.landmark_sigma < 8.0
    assert model.stay_probability < 0.93
    assert model.motion == "odometry"
    assert model.sigma == SIGMA


def test_the_association_gains_by_it(fitted: FittedSlamConfig) -> None:
    rng = np.random.default_rng([2, 20, 30])
    truth = simulate_drive("loop", 20, 30, rng, sigma=SIGMA, odometry=OdometryNoise()).truth()
    before, after = (fed(config, yard(2)).association for config in (WIDE, fitted.config))
    assert after.f1(truth) > before.f1(truth) + 0.2


def test_the_best_trial_is_returned_with_its_evidence(fitted: FittedSlamConfig) -> None:
    best = max(fitted.trials, key=lambda trial: trial.log_evidence)
    assert fitted.log_evidence == best.log_evidence
    assert fitted.config.model == best.model
    assert fitted.trials[0].model == WIDE.model
    assert 3 <= len(fitted.trials) <= 5
    assert fed(fitted.config, yard(2)).log_evidence == pytest.approx(best.log_evidence)


def test_without_rounds_the_starts_are_compared() -> None:
    found = fit_slam_config([yard(1, 10)], WIDE, rounds=0)
    assert len(found.trials) == 3
    stated = WIDE.observation_model
    for i, trial in enumerate(found.trials):
        assert trial.model.landmark_sigma == pytest.approx(stated.landmark_sigma * np.exp(-i))


def test_the_same_on_any_executor() -> None:
    drives = [yard(1, 10), yard(2, 10)]
    ticks: list[tuple[int, int]] = []

    def tick(done: int, total: int) -> None:
        ticks.append((done, total))

    alone = fit_slam_config(drives, WIDE, rounds=1, progress=tick)
    with ThreadPoolExecutor(2) as pool:
        assert fit_slam_config(drives, WIDE, rounds=1, executor=pool) == alone
    assert ticks[-1] == (8, 8)
    assert ticks == sorted(ticks)


def test_what_lies_at_the_edge_of_its_range_stays() -> None:
    """A world in which nothing comes or goes is stated, not guessed."""
    model = replace(WIDE.observation_model, stay_probability=1.0)
    found = fit_slam_config([yard(1, 10)], replace(WIDE, model=model), rounds=1)
    assert {trial.model.stay_probability for trial in found.trials} == {1.0}


@pytest.mark.parametrize(("name", "stride"), [("landmark_sigma", -50.0), ("stay_probability", 50)])
def test_a_step_ends_at_the_bounds(name: str, stride: float) -> None:
    moved = fit_config._moved(WIDE.observation_model, {name: stride})
    assert getattr(moved, name) == BOUNDS[name][int(stride > 0)]


def test_climbing_with_the_associations_held_raises_the_evidence() -> None:
    read = fit_config._read(WIDE, yard(1, 10))
    assert read is not None
    climbed = fit_config._climbed([read], WIDE, WIDE.observation_model)
    before, after = (
        fit_config._log_evidence([read], WIDE, model) for model in (WIDE.observation_model, climbed)
    )
    assert after > before


def test_a_drive_without_a_solution_counts_against_the_model(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    read = fit_config._read

    def fails_when_wide(config: SlamConfig, scans: list[BearingScan]) -> object:
        return None if config.observation_model.landmark_sigma > 10.0 else read(config, scans)

    monkeypatch.setattr(fit_config, "_read", fails_when_wide)
    found = fit_slam_config([yard(1, 10)], WIDE, rounds=0)
    assert found.trials[0].log_evidence == -np.inf
    assert found.config.observation_model.landmark_sigma < 10.0
    monkeypatch.setattr(fit_config, "_read", lambda *_: None)
    with pytest.raises(OptionError, match="no model tried has a solution"):
        fit_slam_config([yard(1, 10)], WIDE, rounds=0)


def test_nothing_to_fit_to_is_refused() -> None:
    with pytest.raises(OptionError, match="there are no drives"):
        fit_slam_config([], WIDE)
    with pytest.raises(OptionError, match=r"drives\[1\] has no scans"):
        fit_slam_config([yard(1, 10), []], WIDE)
    with pytest.raises(OptionError, match="rounds"):
        fit_slam_config([yard(1, 10)], WIDE, rounds=-1)


def test_what_is_no_drive_and_no_configuration_is_refused() -> None:
    with pytest.raises(OptionError, match=r"drives\[0\] is BearingScan: .* \[scans\] for one"):
        fit_slam_config(yard(1, 10), WIDE)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match=r"drives\[1\] is int"):
        fit_slam_config([yard(1, 10), 3], WIDE)  # type: ignore[list-item]
    with pytest.raises(OptionError, match="start is 3: give a SlamConfig"):
        fit_slam_config([yard(1, 10)], 3)  # type: ignore[arg-type]
