"""Methods of the tests, importable in worker processes too, and a sweep that costs little."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

from mht_slam.evaluation.bench.sweep import Sweep

HERE = Path(__file__).parent


@pytest.fixture(scope="session")
def own() -> Iterator[ModuleType]:
    """The module of methods; worker processes inherit the path to it."""
    sys.path.insert(0, str(HERE))
    yield import_module("bench_methods_of_tests")
    sys.path.remove(str(HERE))


@pytest.fixture(scope="session")
def small_sweep() -> Sweep:
    """Two cells of three scenes."""
    return Sweep(
        kinds=("annulus",), landmarks=(3,), epsilons=(math.radians(2), math.radians(4)),
        noises=("uniform",), scenes=3,
    )  # fmt: skip


CHEAP = ["smallest epsilon", "order-keeping", "nearest bearing"]
"""Methods of ours that need no engine."""


@pytest.fixture
def cheap() -> list[str]:
    return list(CHEAP)
