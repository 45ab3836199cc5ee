"""Which peers there are: each file of this folder that holds one registers it here."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from mht_slam.evaluation.bench.methods import Method, MethodFunction

FILES = (
    "exhaustive_lm",
    "cone_program",
    "gtsam_hybrid",
    "gtsam_dcsam",
    "ekf_slam",
    "delayed_decisions",
    "map_graphs",
    "stone_soup",
)
"""The files with peers, in the order of the table."""

BEARINGS_ONLY = "bearings only"
POSES_GIVEN = "true poses given"


@dataclass(frozen=True)
class Peer:
    """A method by others, or in the manner of others, that takes part in a comparison.

    Attributes
    ----------
    name : in tables.
    function : from a run and what may be assumed to scored associations.
    tier : what it is told; peers are compared within a tier.
    needs : packages beyond mht-slam's own that it imports when it is asked.
    """

    name: str
    function: MethodFunction
    tier: str
    needs: tuple[str, ...]

    @property
    def method(self) -> Method:
        """The peer as a comparison takes it: three scans of a straight run, no candidates."""
        return Method(
            self.function, three_scans_only=True, straight_only=True, weighs_candidates=False
        )

    @property
    def missing(self) -> tuple[str, ...]:
        """The packages that it needs and that are not installed."""
        return tuple(name for name in self.needs if importlib.util.find_spec(name) is None)


_PEERS: dict[str, Peer] = {}


def peer(
    name: str, *, tier: str = BEARINGS_ONLY, needs: tuple[str, ...] = ()
) -> Callable[[MethodFunction], MethodFunction]:
    """Register the function below as a peer; it stays what it is."""

    def register(function: MethodFunction) -> MethodFunction:
        _PEERS[name] = Peer(name, function, tier, needs)
        return function

    return register


def registered() -> Mapping[str, Peer]:
    """Return every peer by name, installed or not, in the order of `FILES`."""
    for name in FILES:
        importlib.import_module(name)
    return dict(_PEERS)
