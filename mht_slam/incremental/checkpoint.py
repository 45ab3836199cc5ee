"""Checkpoints of the estimator: arrays and JSON in one file, no pickle, written atomically."""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.errors import CheckpointError, MhtSlamError
from mht_slam.incremental.branch import Branch, Window
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.history import History
from mht_slam.incremental.monitor import Monitor
from mht_slam.incremental.past import Committed
from mht_slam.incremental.steps import Step
from mht_slam.models import ObservationModel

FORMAT = "mht-slam checkpoint"
VERSION = 1
TOLD = "told"
"""Name of the entry that holds everything but arrays, as JSON."""


@dataclass(frozen=True, eq=False)
class Parts:
    """Everything that makes an estimator."""

    config: SlamConfig
    past: Committed
    window: Window
    branches: tuple[Branch, ...]
    history: History
    monitor: Monitor
    moved: float | None


def write(
    path: Path,
    config: SlamConfig,
    past: Committed,
    window: Window,
    branches: Sequence[Branch],
    history: History,
    monitor: Monitor,
    moved: float | None,
) -> None:
    """Write a checkpoint beside `path` and move it there; raises `OSError`."""
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    told = {
        "format": FORMAT,
        "version": VERSION,
        "config": asdict(config),
        "monitor": asdict(monitor),
        "moved": moved,
        "n_branches": len(branches),
        "renamed": sorted(history.renamed.items()),
        "loops": history.loops,
    }
    _put(arrays, "past", past)
    _put(arrays, "window", window)
    for i, branch in enumerate(branches):
        _put(arrays, f"branch{i}", branch)
    for name in ("bearings", "sigmas", "owners"):
        _put_list(arrays, f"history.{name}", getattr(history, name))
    arrays["history.times"] = np.array(history.times)
    arrays["history.poses"] = np.array(history.poses).reshape(-1, 3)
    arrays["history.kinds"] = np.array([step.kind for step in history.steps], np.int64)
    parameters = [step.parameters for step in history.steps]
    arrays["history.motion"] = np.array(parameters).reshape(len(parameters), -1)
    arrays[TOLD] = np.frombuffer(json.dumps(told).encode(), np.uint8)
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **arrays)
    beside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with beside.open("wb") as file:
            file.write(content.getbuffer())
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def read(path: Path) -> Parts:
    """Read a checkpoint; raises `CheckpointError` for what is none, `OSError` for no file."""
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        told = json.loads(arrays[TOLD].tobytes())
        if told["format"] != FORMAT:
            raise ValueError("another format")
    except (ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile) as cause:
        raise CheckpointError(
            f"{path}: no checkpoint of mht-slam: give a file that save wrote"
        ) from cause
    if told["version"] != VERSION:
        raise CheckpointError(
            f"{path}: version {told['version']} of the checkpoint, this is {VERSION}: start anew, "
            "or go on with the release that wrote it"
        )
    try:
        return _parts(arrays, told)
    except (ValueError, KeyError, IndexError, TypeError, MhtSlamError) as cause:
        raise CheckpointError(f"{path}: the checkpoint is damaged: {cause}") from cause


def _parts(arrays: dict[str, Any], told: dict[str, Any]) -> Parts:
    settings = dict(told["config"])
    model = dict(settings.pop("model"))
    model["landmark_centre"] = tuple(model["landmark_centre"])
    config = SlamConfig(model=ObservationModel(**model), **settings)
    kinds, motion = arrays["history.kinds"], arrays["history.motion"]
    history = History(
        bearings=_list(arrays, "history.bearings"),
        sigmas=_list(arrays, "history.sigmas"),
        times=arrays["history.times"].tolist(),
        steps=[Step(int(k), row) for k, row in zip(kinds, motion, strict=True)],
        owners=_list(arrays, "history.owners"),
        poses=list(arrays["history.poses"]),
        renamed=dict(told["renamed"]),
        loops=[(int(scan), int(count), float(odds)) for scan, count, odds in told["loops"]],
    )
    return Parts(
        config=config,
        past=_value(arrays, "past", Committed),
        window=_value(arrays, "window", Window),
        branches=tuple(_value(arrays, f"branch{i}", Branch) for i in range(told["n_branches"])),
        history=history,
        monitor=Monitor(**told["monitor"]),
        moved=told["moved"],
    )


def _put(arrays: dict[str, Any], prefix: str, value: object) -> None:
    """Put the fields of a dataclass of arrays, numbers and tuples of arrays under a prefix."""
    for entry in fields(value):  # type: ignore[arg-type]
        content = getattr(value, entry.name)
        if isinstance(content, tuple):
            _put_list(arrays, f"{prefix}.{entry.name}", content)
        else:
            arrays[f"{prefix}.{entry.name}"] = np.asarray(content)


def _value(arrays: dict[str, Any], prefix: str, kind: type[Any]) -> Any:
    found: dict[str, Any] = {}
    for entry in fields(kind):
        name = f"{prefix}.{entry.name}"
        if f"{name}.lengths" in arrays:
            found[entry.name] = tuple(_list(arrays, name))
        else:
            array = arrays[name]
            found[entry.name] = array.item() if array.ndim == 0 else array
    return kind(**found)


def _put_list(
    arrays: dict[str, Any], name: str, parts: Sequence[FloatArray] | Sequence[IntArray]
) -> None:
    """Put arrays of different length end to end."""
    whole = np.concatenate(parts) if len(parts) else np.empty(0)
    arrays[f"{name}.lengths"] = np.array([len(part) for part in parts], np.int64)
    arrays[f"{name}.entries"] = whole


def _list(arrays: dict[str, Any], name: str) -> list[Any]:
    ends = np.cumsum(arrays[f"{name}.lengths"])[:-1]
    if not len(arrays[f"{name}.lengths"]):
        return []
    return [part.copy() for part in np.split(arrays[f"{name}.entries"], ends)]
