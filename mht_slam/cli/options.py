"""Options that several commands share, as frozen dataclasses; angles in degrees."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import tyro

from mht_slam.arrays import finite_number, whole_number
from mht_slam.cli.model_options import ModelOptions
from mht_slam.errors import OptionError
from mht_slam.models import ObservationModel

FigureFormat: TypeAlias = Literal["png", "pdf", "svg"]

MOST_WORKERS = 1024
DASK_TIMEOUT = 10.0
"""Seconds that a dask scheduler has to answer."""


@dataclass(frozen=True)
class MethodOptions:
    """How hypotheses are ranked and weighed."""

    epsilon_deg: float = 3.0
    """Vision error: the bound on a bearing's error, degrees, above 0 and below 90."""
    max_range: float = 100.0
    """Where cells of the polygon method are cut, baselines of each pair."""
    top_k: int = 50
    """How many of the ranked associations the factor graph refines."""
    assumed: ModelOptions = field(default_factory=ModelOptions)

    @property
    def epsilon(self) -> float:
        """Vision error, radians; an `OptionError` outside its range."""
        return math.radians(finite_number(self.epsilon_deg, "epsilon_deg", above=0.0, below=90.0))

    def model(self) -> ObservationModel:
        """Return the model behind the probabilities; raises `OptionError`."""
        return self.assumed.model(self.epsilon)


@dataclass(frozen=True)
class WorkOptions:
    """Who does the work. The results do not depend on it."""

    workers: int = 1
    """Processes that refine hypotheses; 1 works without others."""
    dask: str | None = None
    """Address of a dask scheduler, such as tcp://127.0.0.1:8786, whose workers refine instead. They
    need mht-slam too."""

    def check(self) -> None:
        """Raise `OptionError` for a number of workers that is none, or for both options."""
        if whole_number(self.workers, "workers", at_least=1) > MOST_WORKERS:
            raise OptionError(f"workers is {self.workers}: give at most {MOST_WORKERS}")
        if self.dask is not None and self.workers != 1:
            raise OptionError("dask: its workers are those of the scheduler: leave --workers")

    @contextmanager
    def executor(self) -> Iterator[Executor | None]:
        """Hold the executor while the work is done; raises `OptionError` where there is none."""
        self.check()
        if self.dask is not None:
            with _dask_executor(self.dask) as executor:
                yield executor
        elif self.workers == 1:
            yield None
        else:
            # Threads of workers side by side would fight for the cores.
            os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
            with ProcessPoolExecutor(self.workers, mp_context=get_context("spawn")) as pool:
                yield pool


@dataclass(frozen=True)
class OutputOptions:
    """Where results go."""

    output: Path = Path("runs")
    """Folder in which every run gets its own stamped folder; `latest` there leads to the last."""
    figure_format: FigureFormat = "png"
    """Format of the figures."""


Method = Annotated[MethodOptions, tyro.conf.OmitArgPrefixes]
Work = Annotated[WorkOptions, tyro.conf.OmitArgPrefixes]
Output = Annotated[OutputOptions, tyro.conf.OmitArgPrefixes]
"""Nested, but with options that carry no prefix."""


@contextmanager
def _dask_executor(address: str) -> Iterator[Executor]:
    try:
        from distributed import Client
    except ImportError as cause:
        raise OptionError("dask: not installed: pip install 'mht-slam[distributed]'") from cause
    try:
        client = Client(address, timeout=DASK_TIMEOUT)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as cause:  # an address that is none is a ValueError
        raise OptionError(f"dask: no scheduler answers at {address!r}: {cause}") from cause
    with client:
        yield client.get_executor()  # type: ignore[no-untyped-call]
