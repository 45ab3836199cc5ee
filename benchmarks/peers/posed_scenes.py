"""Scenes whose assumptions also hold the true poses, for peers that cannot do without them."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

from mht_slam.arrays import FloatArray
from mht_slam.errors import OptionError
from mht_slam.evaluation.bench.case import Assumptions, Case
from mht_slam.evaluation.bench.sweep import Cell


@dataclass(frozen=True, eq=False)
class PosesGiven(Assumptions):
    """Assumptions with the (m, 3) true poses in the run's frame; only their own tier reads them."""

    poses: FloatArray = field(kw_only=True)


@dataclass(frozen=True)
class PosedScenes:
    """A cell of a sweep, its very scenes, with the poses told besides."""

    cell: Cell

    @property
    def key(self) -> str:
        """The cell's own."""
        return self.cell.key

    @property
    def name(self) -> str:
        """The cell's own."""
        return self.cell.name

    @property
    def columns(self) -> dict[str, Any]:
        """The cell's own."""
        return self.cell.columns

    def case(self, scene: int) -> Case:
        """Return the cell's case of this number, with its poses among the assumptions."""
        case = self.cell.case(scene)
        told = {entry.name: getattr(case.assumptions, entry.name) for entry in fields(Assumptions)}
        assumptions = PosesGiven(**told, poses=case.poses)
        return Case(case.run, case.truth, assumptions, case.poses, case.landmarks)


def given_poses(assumptions: Assumptions) -> FloatArray:
    """Return the true poses (m, 3); raises `OptionError` where they are not told."""
    if not isinstance(assumptions, PosesGiven):
        raise OptionError("this peer needs the true poses: compare it with benchmarks/peers")
    return assumptions.poses
