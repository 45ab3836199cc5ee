"""The observation model states every assumption and refuses values that make no sense."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, fields
from typing import Any

import numpy as np
import pytest

from mht_slam.errors import OptionError
from mht_slam.models import ObservationModel


def test_the_documented_priors_are_the_defaults() -> None:
    model = ObservationModel(sigma=0.01)
    assert model.landmark_sigma == 30.0
    assert model.landmark_centre == (0.5, 0.0)
    assert (model.log_step_mean, model.log_step_sigma) == (0.0, 1.0)
    assert (model.heading_sigma, model.lateral_sigma) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("sigma", 0.0),
        ("sigma", -0.1),
        ("sigma", np.nan),
        ("sigma", "wide"),
        ("sigma", 4.0),
        ("heading_sigma", -0.1),
        ("lateral_sigma", np.inf),
        ("landmark_sigma", 0.0),
        ("landmark_centre", [0.5, 0.0]),
        ("landmark_centre", (0.5,)),
        ("landmark_centre", (0.5, np.nan)),
        ("log_step_mean", np.inf),
        ("log_step_sigma", 0.0),
        ("detection_probability", 0.0),
        ("detection_probability", 1.1),
        ("false_alarm_rate", -1.0),
        ("expected_landmarks", 0.0),
        ("expected_landmarks", True),
    ],
)
def test_a_value_out_of_range_is_refused_by_name(field: str, value: Any) -> None:
    arguments: dict[str, Any] = {"sigma": 0.01, field: value}
    with pytest.raises(OptionError, match=field):
        ObservationModel(**arguments)


@pytest.mark.parametrize(
    "unstated", ["detection_probability", "false_alarm_rate", "expected_landmarks", None]
)
def test_sizes_compare_only_when_the_whole_detection_model_is_stated(unstated: str | None) -> None:
    detection: dict[str, Any] = {
        "detection_probability": 0.9,
        "false_alarm_rate": 0.0,
        "expected_landmarks": 5.0,
    }
    if unstated is not None:
        del detection[unstated]
    assert ObservationModel(sigma=0.01, **detection).compares_sizes == (unstated is None)


def test_the_description_names_every_assumption_in_degrees() -> None:
    model = ObservationModel(sigma=np.deg2rad(2.0), heading_sigma=np.deg2rad(3.0))
    text = model.describe()
    assert "\n" not in text
    for field in fields(model):
        assert f"{field.name}=" in text
    assert "sigma=2 deg" in text
    assert "heading_sigma=3 deg" in text
    assert "landmark_centre=(0.5, 0)" in text


def test_the_dictionary_rebuilds_the_model() -> None:
    model = ObservationModel(sigma=0.02, detection_probability=0.9)
    arguments: dict[str, Any] = model.to_dict()
    assert ObservationModel(**arguments) == model


def test_a_model_is_frozen() -> None:
    with pytest.raises(FrozenInstanceError):
        ObservationModel(sigma=0.02).sigma = 0.03  # type: ignore[misc]


def test_a_whole_number_beyond_every_float_is_refused():
    with pytest.raises(OptionError, match="landmark_sigma is inf"):
        ObservationModel(sigma=0.1, landmark_sigma=10**400)


def test_a_name_is_a_string_and_nothing_that_compares_like_one() -> None:
    with pytest.raises(OptionError, match="motion is array"):
        ObservationModel(sigma=0.1, motion=np.array(["straight", "free"]))  # type: ignore[arg-type]


def test_stops_or_not_is_no_number() -> None:
    with pytest.raises(OptionError, match="stops is nan"):
        ObservationModel(sigma=0.1, stops=np.nan)  # type: ignore[arg-type]
