"""The recordings are looked for where the documentation says."""

import pytest

from mht_slam.datasets import location
from mht_slam.datasets.location import data_folder, recording_file
from mht_slam.errors import RecordingNotFoundError


@pytest.fixture(autouse=True)
def no_variable(monkeypatch):
    monkeypatch.delenv(location.ENVIRONMENT_VARIABLE, raising=False)


def test_the_environment_variable_goes_first(monkeypatch, tmp_path):
    monkeypatch.setenv(location.ENVIRONMENT_VARIABLE, str(tmp_path))
    assert data_folder() == tmp_path


def test_a_variable_that_names_no_folder_is_an_error_and_no_fallback(monkeypatch, tmp_path):
    monkeypatch.setenv(location.ENVIRONMENT_VARIABLE, str(tmp_path / "absent"))
    with pytest.raises(RecordingNotFoundError, match=location.ENVIRONMENT_VARIABLE):
        data_folder()


@pytest.mark.parametrize("start", ["repository", "current folder"])
def test_the_folder_beside_the_repository_or_the_current_one_is_the_fallback(
    monkeypatch, tmp_path, start
):
    home, elsewhere = tmp_path / "home" / "project", tmp_path / "elsewhere" / "project"
    home.mkdir(parents=True)
    elsewhere.mkdir(parents=True)
    (tmp_path / "home" / "shared" / "data").mkdir(parents=True)
    monkeypatch.setattr(location, "_REPOSITORY", home if start == "repository" else elsewhere)
    monkeypatch.chdir(elsewhere if start == "repository" else home)
    assert data_folder() == (tmp_path / "home" / "shared" / "data").resolve()


def test_without_any_folder_the_error_says_what_to_set(monkeypatch, tmp_path):
    monkeypatch.setattr(location, "_REPOSITORY", tmp_path / "a" / "b")
    (tmp_path / "c").mkdir()
    monkeypatch.chdir(tmp_path / "c")
    with pytest.raises(RecordingNotFoundError, match=f"set {location.ENVIRONMENT_VARIABLE}"):
        data_folder()


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"map\.circles"):
        recording_file(tmp_path, "map.circles")
