"""Recorded runs as scenes of a comparison: the same methods, judged by the recording's truth."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from typing import Any

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.evaluation.bench.case import Case


@dataclass(frozen=True, eq=False)
class RecordedRuns:
    """A set of runs cut from a recording, all judged under one model.

    Attributes
    ----------
    name : recording, kind of run, number of landmarks.
    cases : the runs; the number of a scene is the place of its run.
    """

    name: str
    cases: tuple[Case, ...]

    @property
    def key(self) -> str:
        """Name and a digest of everything the methods are given, as one line of JSON."""
        digest = hashlib.sha256()
        for case in self.cases:
            digest.update(repr(case.assumptions).encode() + case.truth.table.tobytes())
            for scan in case.run.scans:
                digest.update(scan.bearings.tobytes())
        return json.dumps({"recorded": self.name, "runs": digest.hexdigest()[:16]})

    @property
    def columns(self) -> dict[str, Any]:
        """The set's columns in tables."""
        first = self.cases[0]
        return {
            "cell": self.name,
            "landmarks": first.truth.n_landmarks,
            "scans": len(first.run),
            "model": first.assumptions.model.describe(),
        }

    def case(self, scene: int) -> Case:
        """Return the run of this number."""
        return self.cases[scene]


def in_run_frame(points: FloatArray, poses: FloatArray) -> FloatArray:
    """Move points (k, 2) from a recording's frame to the run's: O1 = (0, 0), O2 = (1, 0).

    `poses` is (m, 3) in the recording's frame, the first two at different places.
    """
    origin = poses[0, 0] + 1j * poses[0, 1]
    baseline = poses[1, 0] + 1j * poses[1, 1] - origin
    moved = (points[:, 0] + 1j * points[:, 1] - origin) / baseline
    return np.column_stack([moved.real, moved.imag])


def poses_in_run_frame(poses: FloatArray) -> FloatArray:
    """Move poses (m, 3) as `in_run_frame` moves points."""
    turn = np.arctan2(*(poses[1, :2] - poses[0, :2])[::-1])
    return np.column_stack([in_run_frame(poses[:, :2], poses), poses[:, 2] - turn])
