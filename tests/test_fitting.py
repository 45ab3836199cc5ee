"""A model fitted by evidence is the one the runs were drawn from, and no truth is looked at."""

import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

import mht_slam as ms
from mht_slam.errors import OptionError
from mht_slam.evidence.visibility import expected_detected
from mht_slam.fitting import BOUNDS, expected_landmarks_detected
from mht_slam.simulation import simulate_scene
from mht_slam.tree.grow import Effort

SMALL = Effort(keep=2, solve=4)
TRUE = ms.ObservationModel(
    sigma=np.deg2rad(0.3),
    motion="smooth",
    turn_sigma=np.deg2rad(3.0),
    drift_sigma=np.deg2rad(3.0),
    step_change_sigma=0.2,
    landmark_sigma=6.0,
    detection_probability=0.85,
    false_alarm_rate=0.03,
    expected_landmarks=6.0,
    stay_probability=0.95,
)
SURE = replace(TRUE, sigma=np.deg2rad(0.05), stay_probability=1.0, false_alarm_rate=1e-5)
"""A model whose associations leave no doubt and whose landmarks never leave."""


def scenes_of(model, count, n_scans, seed=0):
    rng = np.random.default_rng(seed)
    return [simulate_scene("model", None, rng, model=model, n_scans=n_scans) for _ in range(count)]


@pytest.fixture(scope="module")
def recovered():
    start = replace(
        TRUE,
        sigma=0.6 * TRUE.sigma,
        turn_sigma=0.6 * TRUE.turn_sigma,
        step_change_sigma=0.4,
        landmark_sigma=12.0,
        detection_probability=0.7,
        false_alarm_rate=0.1,
        expected_landmarks=10.0,
        stay_probability=0.85,
    )
    names = [name for name in BOUNDS if name != "drift_sigma"]
    runs = [scene.run for scene in scenes_of(TRUE, 8, 6)]
    return start, ms.fit_observation_model(runs, start, parameters=names, rounds=3)


def test_a_fit_recovers_the_model_the_runs_were_drawn_from(recovered):
    start, fitted = recovered
    for name, error in fitted.standard_errors.items():
        true, found, begun = (getattr(m, name) for m in (TRUE, fitted.model, start))
        assert error > 0.0
        assert abs(found - true) < 4.0 * error, name
        assert abs(math.log(found / true)) < 0.5 * abs(math.log(begun / true)), name


def test_the_evidence_never_falls_while_the_associations_stand(recovered):
    _, fitted = recovered
    assert [entry.n_runs for entry in fitted.rounds] == [8, 8, 8]
    for entry in fitted.rounds:
        assert entry.log_evidence >= entry.log_evidence_before
    assert fitted.log_evidence[1] > fitted.log_evidence[0]
    assert fitted.rounds[-1].model == fitted.model


def test_what_is_not_fitted_stays_as_it_was(recovered):
    start, fitted = recovered
    kept = replace(start, **{name: getattr(fitted.model, name) for name in fitted.standard_errors})
    assert kept == fitted.model
    assert fitted.model.drift_sigma == start.drift_sigma


def test_with_sure_associations_counts_have_the_maximum_of_their_own_likelihood():
    scenes = scenes_of(SURE, 5, 5, seed=5)
    start = replace(SURE, detection_probability=0.7, expected_landmarks=4.0)
    fitted = ms.fit_observation_model(
        [scene.run for scene in scenes],
        start,
        parameters=["detection_probability", "expected_landmarks"],
        effort=Effort(),
        rounds=2,
    )
    landmarks = sum(scene.truth.n_landmarks for scene in scenes)
    detected = sum(int((scene.truth.table >= 0).sum()) for scene in scenes)

    def minus_log_likelihood(free):
        p, rate = 1.0 / (1.0 + math.exp(-free[0])), math.exp(free[1])
        seen_at_all = 1.0 - (1.0 - p) ** 5
        log = landmarks * math.log(rate) + detected * math.log(p)
        log += (5 * landmarks - detected) * math.log(1.0 - p)
        return len(scenes) * rate * seen_at_all - log

    logit, log_rate = minimize(minus_log_likelihood, [0.0, 1.0], tol=1e-10).x
    expected = (1.0 / (1.0 + math.exp(-logit)), math.exp(log_rate))
    found = (fitted.model.detection_probability, fitted.model.expected_landmarks)
    assert found == pytest.approx(expected, rel=0.01)


def test_a_fit_does_not_depend_on_who_does_the_work():
    runs = [scene.run for scene in scenes_of(SURE, 3, 4)]
    options = {"parameters": ["sigma", "stay_probability"], "rounds": 1, "effort": SMALL}
    start = replace(SURE, stay_probability=0.9)
    calls = []
    alone = ms.fit_observation_model(
        runs, start, progress=lambda done, total: calls.append((done, total)), **options
    )
    with ProcessPoolExecutor(2) as pool:
        shared = ms.fit_observation_model(runs, start, executor=pool, **options)
    assert alone == shared
    assert [done for done, _ in calls] == list(range(1, calls[-1][1] + 1))


def test_the_landmarks_a_limited_view_detects_are_as_many_as_simulated_ones():
    model = replace(TRUE, field_of_view=2.0, stay_probability=0.8)
    scenes = scenes_of(model, 600, 6)
    simulated = [scene.truth.n_landmarks for scene in scenes]
    expected = [expected_landmarks_detected(model, scene.poses) for scene in scenes]
    error = np.std(simulated) / math.sqrt(len(scenes))
    assert np.mean(expected) == pytest.approx(np.mean(simulated), abs=3.0 * error)
    whole = replace(model, field_of_view=2.0 * math.pi - 1e-9)
    assert expected_landmarks_detected(whole, scenes[0].poses) == pytest.approx(
        expected_detected(model, 6), rel=1e-6
    )


RUN = scenes_of(SURE, 1, 3)[0].run
LABELLED = ms.StraightRun([ms.BearingScan([0.1], labels=["a"]) for _ in range(3)])


@pytest.mark.parametrize(
    ("runs", "start", "parameters", "named"),
    [
        ([], TRUE, ["sigma"], "no runs"),
        ([RUN, LABELLED], TRUE, ["sigma"], r"runs\[1\] has labels"),
        ([RUN], replace(TRUE, false_alarm_rate=None), ["sigma"], "false_alarm_rate"),
        ([RUN], TRUE, [], "parameters"),
        ([RUN], TRUE, ["field_of_view"], "field_of_view"),
        ([RUN], TRUE, ["bearing_dof"], "bearing_dof"),
        ([RUN], SURE, ["stay_probability"], "stay_probability is 1"),
        ([RUN], replace(TRUE, motion="straight"), ["turn_sigma"], "turn_sigma"),
    ],
)
def test_what_cannot_be_fitted_is_named(runs, start, parameters, named):
    with pytest.raises(OptionError, match=named):
        ms.fit_observation_model(runs, start, parameters=parameters)
