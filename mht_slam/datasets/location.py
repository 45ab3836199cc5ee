"""Where the public recordings lie on this machine."""

from __future__ import annotations

import os
from pathlib import Path

from mht_slam.errors import RecordingNotFoundError

ENVIRONMENT_VARIABLE = "MHT_SLAM_DATA"
"""Names the folder that holds the recordings, one sub-folder each ("dlr", ...)."""

FALLBACK = Path("..", "shared", "data")
"""Where recordings are looked for otherwise: beside the repository, or the current folder."""

_REPOSITORY = Path(__file__).resolve().parents[2]


def data_folder() -> Path:
    """Return the folder of the recordings.

    That is the folder named by the environment variable `MHT_SLAM_DATA`, else `../shared/data`
    seen from the repository, else the same seen from the current folder. Raises
    `RecordingNotFoundError`, with the remedy, where there is none.
    """
    named = os.environ.get(ENVIRONMENT_VARIABLE)
    if named:
        folder = Path(named)
        if folder.is_dir():
            return folder
        raise RecordingNotFoundError(
            f"{ENVIRONMENT_VARIABLE} names {named}, which is no folder: point it at the recordings"
        )
    for start in (_REPOSITORY, Path.cwd()):
        folder = (start / FALLBACK).resolve()
        if folder.is_dir():
            return folder
    raise RecordingNotFoundError(
        f"no recordings in {FALLBACK}: set {ENVIRONMENT_VARIABLE} to the folder that holds them"
    )


def recording_file(folder: Path, name: str) -> Path:
    """Return `folder / name`; raises `RecordingNotFoundError` where no such file exists."""
    path = folder / name
    if not path.is_file():
        raise RecordingNotFoundError(
            f"{path} does not exist: set {ENVIRONMENT_VARIABLE} to the folder that holds the "
            "recordings, or give the folder"
        )
    return path
