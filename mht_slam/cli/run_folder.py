"""The stamped folder that every run leaves: never overwritten, with its configuration."""

from __future__ import annotations

import contextlib
import json
import math
import os
import platform
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mht_slam import __version__

LATEST = "latest"
CONFIGURATION_FILE = "configuration.json"

_ENGINES = ("numpy", "scipy", "shapely", "gtsam")


@contextlib.contextmanager
def run_folder(parent: Path, command: str, configuration: Mapping[str, Any]) -> Iterator[Path]:
    """Make ``parent/<UTC timestamp>-<command>/``, and after success point ``latest`` at it.

    An existing folder is left alone, the new one gets a suffix. It is made before the work, so
    that a place that cannot be written fails at once; a run that fails leaves none behind unless
    it had results. Raises `OSError`.
    """
    started = datetime.now(UTC)
    folder = _fresh_folder(parent, f"{started:%Y%m%dT%H%M%SZ}-{command}")
    try:
        yield folder
        write_json(
            folder / CONFIGURATION_FILE,
            {
                "command": command,
                "started": started.isoformat(timespec="seconds"),
                "versions": versions(),
                **configuration,
            },
        )
    except BaseException:
        # Not empty: something was already worth keeping.
        with contextlib.suppress(OSError):
            folder.rmdir()
        raise
    _point_latest(parent, folder)


def versions() -> dict[str, str]:
    """Return the versions of everything that results depend on."""
    engines = {name: version(name) for name in _ENGINES}
    return {"mht-slam": __version__, **engines, "python": platform.python_version()}


def write_json(path: Path, value: object) -> None:
    """Write JSON at full precision; numbers that are not finite become null."""
    text = json.dumps(to_json(value), indent=2, allow_nan=False, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")


def to_json(value: Any) -> Any:
    """Turn dataclasses, arrays and paths into what JSON holds."""
    if is_dataclass(value) and not isinstance(value, type):
        return {entry.name: to_json(getattr(value, entry.name)) for entry in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): to_json(entry) for key, entry in value.items()}
    if hasattr(value, "tolist"):
        return to_json(value.tolist())
    if isinstance(value, (list, tuple)):
        return [to_json(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


def _fresh_folder(parent: Path, name: str) -> Path:
    parent.mkdir(parents=True, exist_ok=True)
    suffix = 1
    while True:
        folder = parent / (name if suffix == 1 else f"{name}-{suffix}")
        try:
            folder.mkdir()
        except FileExistsError:
            suffix += 1
        else:
            return folder


def _point_latest(parent: Path, folder: Path) -> None:
    """Replace the link at once; a convenience, so where links cannot be made there is none."""
    temporary = parent / f".{LATEST}.{os.getpid()}"
    with contextlib.suppress(OSError):
        temporary.symlink_to(folder.name, target_is_directory=True)
        temporary.replace(parent / LATEST)
    with contextlib.suppress(OSError):
        temporary.unlink(missing_ok=True)
