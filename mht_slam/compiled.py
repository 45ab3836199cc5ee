"""Compile the few loops that no array operation expresses.

Only searches whose next step hangs on the last one are compiled: supporting lines of regions,
clipping of convex polygons, depth-first search. The machine code is cached beside the source, or
in the user's cache folder where that cannot be written, so a machine compiles each function once.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile a function of numbers and arrays on its first call; it must not raise."""
    try:
        machine_code = numba.njit(function, cache=True, error_model="numpy", nogil=True)
    except RuntimeError:  # no folder can hold the cache: compile in every process
        machine_code = numba.njit(function, error_model="numpy", nogil=True)
    return cast(Function, machine_code)


def _forget_stale_code(package: Path) -> None:
    """Remove machine code older than any source of the package.

    The cache of a function notices changes of its own file, but not of the files of the functions
    it calls.
    """
    newest = 0.0
    for source in package.rglob("*.py"):
        with contextlib.suppress(OSError):
            newest = max(newest, source.stat().st_mtime)
    for index in package.rglob("*.nbi"):
        with contextlib.suppress(OSError):  # another process may be quicker
            if index.stat().st_mtime < newest:
                index.unlink()


_forget_stale_code(Path(__file__).parent)
