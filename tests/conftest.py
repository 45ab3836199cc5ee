"""What tests of several packages share: workers of a dask cluster."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import pytest

StartDask = Callable[[int], Any]


@pytest.fixture
def start_dask() -> StartDask:
    """Start a cluster of so many worker processes, which inherit the environment as it is then."""
    distributed = pytest.importorskip("distributed")

    def start(n_workers: int) -> Any:
        return distributed.LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            protocol="tcp",
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
        )

    return start
