"""Checkpoints of the estimator: arrays and JSON in one file, no pickle, written atomically."""

from __future__ import annotations

import io
import json
import os
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
from mht_slam.incremental.motion_terms import N_PARAMETERS
from mht_slam.incremental.past import Committed
from mht_slam.incremental.steps import Step
from mht_slam.models import ObservationModel

FORMAT = "mht-slam checkpoint"
VERSION = 3
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
        "tears": history.tears,
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
    arrays["history.motion"] = np.array(parameters).reshape(-1, N_PARAMETERS)
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
    content = io.BytesIO(path.read_bytes())
    try:
        with np.load(content, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        told = json.loads(arrays[TOLD].tobytes())
        if told["format"] != FORMAT:
            raise ValueError("another format")
        version = told["version"]
    except Exception as cause:  # readers of archives raise whatever they stumble over
        raise CheckpointError(
            f"{path}: no checkpoint of mht-slam: give a file that save wrote"
        ) from cause
    if version != VERSION:
        raise CheckpointError(
            f"{path}: version {version} of the checkpoint, this is {VERSION}: start anew, "
            "or go on with the release that wrote it"
        )
    try:
        parts = _parts(arrays, told)
        _refuse_misfits(parts)
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, MhtSlamError) as cause:
        reason = " ".join(str(cause).split())
        raise CheckpointError(f"{path}: the checkpoint is damaged: {reason}") from cause
    return parts


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
        tears=[int(scan) for scan in told["tears"]],
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


def _refuse_misfits(parts: Parts) -> None:
    """Raise `ValueError` for arrays that do not fit each other: machine code does not ask."""
    past, window, history = parts.past, parts.window, parts.history
    n, s, w = len(past.ids), len(window.settled), len(window.bearings)
    m = len(history.bearings)
    lengths = [len(bearings) for bearings in window.bearings]
    expected: list[tuple[str, Any, tuple[int, ...]]] = [
        ("past", past.mean, (6 + 2 * n,)),
        ("past", past.covariance, (6 + 2 * n, 6 + 2 * n)),
        ("past", past.centres, (n, 2)),
        *(("past", a, (n,)) for a in (past.visible, past.first_seen, past.last_seen)),
        ("past", past.sightings, (n,)),
        ("window", window.kinds, (w,)),
        ("window", window.motion, (w, N_PARAMETERS)),
        ("window", window.prior_mean, (6 + 2 * s,)),
        ("window", window.prior_information, (6 + 2 * s, 6 + 2 * s)),
        ("window", window.centres, (s, 2)),
        ("window", np.array([len(sigmas) for sigmas in window.sigmas]), (w,)),
        ("history", np.array(history.poses), (m - w, 3) if m > w else (0,)),
        *(("history", np.empty(len(a)), (m,)) for a in (history.sigmas, history.times)),
        ("history", np.empty(len(history.owners)), (m - w,)),
    ]
    sane = len(parts.branches) > 0 and isinstance(parts.moved, float | None)
    sane &= [len(sigmas) for sigmas in window.sigmas] == lengths
    for branch in parts.branches:
        b, o = len(branch.ids), len(branch.sightings)
        size = 3 * (w + 2) + 2 * b if w else 3
        expected += [
            ("branch", branch.centres, (b, 2)),
            ("branch", branch.places, (b, 2)),
            ("branch", branch.visible, (b,)),
            ("branch", branch.sightings, (o, 2)),
            ("branch", branch.bearings, (o,)),
            ("branch", branch.sigmas, (o,)),
            ("branch", branch.poses, (w + 2, 3)),
            ("branch", branch.root, (size, size)),
        ]
        sane &= [len(owner) for owner in branch.owners] == lengths
        sane &= not o or (branch.sightings.min() >= 0 and branch.sightings[:, 1].max() < b)
        sane &= not o or branch.sightings[:, 0].max() < w + 2
        sane &= b >= s and bool((branch.ids[:s] == window.settled).all())
    sane &= bool(np.isin(window.settled, parts.past.ids).all())
    sane &= type(parts.monitor.is_lost) is bool and type(parts.monitor.whole_for) is int
    sane &= all(_ends(history.renamed, number) for number in history.renamed)
    for name, array, shape in expected:
        if array.shape != shape:
            raise ValueError(f"an array of the {name} has shape {array.shape}, not {shape}")
    if not sane:
        raise ValueError("its entries contradict each other")


def _ends(renamed: dict[int, int], number: int) -> bool:
    """Whether a landmark's names end somewhere."""
    for _ in renamed:
        if number not in renamed:
            return True
        number = renamed[number]
    return number not in renamed


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
