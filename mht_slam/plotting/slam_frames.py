"""What an estimator thought at a row of moments: the frames of an animation, also across a kill."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.errors import NoEstimateError

if TYPE_CHECKING:
    from mht_slam.incremental.estimator import MultiHypothesisSlam

MOST_FRAMES = 120
MOST_ALTERNATIVES = 5
"""Of one frame, besides the best hypothesis."""


@dataclass(frozen=True, eq=False)
class SlamFrame:
    """What the estimator thought after a scan, in the frame of the first pose.

    Attributes
    ----------
    scan : its number.
    first_open : number of the oldest scan whose associations were open.
    poses : (w, 3) of the open scans by the best hypothesis, then by each alternative.
    settled : (n, 2) landmarks of the committed map.
    tentative : (k, 2) landmarks that the best hypothesis sees in open scans and knows the range of.
    status, n_loops : at the time.
    """

    scan: int
    first_open: int
    poses: tuple[FloatArray, ...]
    settled: FloatArray
    tentative: FloatArray
    status: str
    n_loops: int


def frame_of(slam: MultiHypothesisSlam) -> SlamFrame:
    """Return what an estimator thinks now. Raises `NoEstimateError` while it is initialising."""
    posterior = slam.posterior
    if not len(posterior):
        raise NoEstimateError("the estimator is initialising: give it three scans")
    best = posterior[0]
    assert best.landmarks is not None  # noqa: S101 - narrows the type
    assert best.ranged is not None  # noqa: S101 - narrows the type
    return SlamFrame(
        scan=slam.n_scans - 1,
        first_open=posterior.scans[0],
        poses=tuple(h.poses for h in posterior[: 1 + MOST_ALTERNATIVES] if h.poses is not None),
        settled=slam.committed.points,
        tentative=best.landmarks[best.ranged],
        status=slam.status,
        n_loops=len(slam.loops),
    )


class FrameRecorder:
    """Frames of a run of unknown length: evenly spread, `MOST_FRAMES` at most.

    A frame is taken after every scan at first; whenever there are too many, every other one is
    left out, and half as many are taken from then on. Which scans have frames depends on the
    number of the last one alone.

    Parameters
    ----------
    log : file that gets every frame taken, for a run that goes on after a kill; None keeps none.
    resumed_at : scans that the run has from a checkpoint. Frames of these are read from the log;
        there are none where there is no log.

    Raises `OSError` where the log cannot be written.
    """

    def __init__(self, log: Path | None = None, resumed_at: int = 0) -> None:
        self._log, self._stride = log, 1
        self._frames: dict[int, SlamFrame] = {}
        if log is None:
            return
        for frame in _logged(log) if resumed_at else []:
            if frame.scan < resumed_at:
                self._add(frame)
        log.write_text("".join(map(_line, self.frames)), encoding="utf-8")

    @property
    def frames(self) -> tuple[SlamFrame, ...]:
        """The frames, in the order of their scans."""
        return tuple(self._frames.values())

    def take(self, slam: MultiHypothesisSlam) -> None:
        """Take a frame of the estimator, where one is due after its last scan."""
        if (slam.n_scans - 1) % self._stride or not len(slam.posterior):
            return
        frame = frame_of(slam)
        self._add(frame)
        if self._log is not None:
            with self._log.open("a", encoding="utf-8") as file:
                file.write(_line(frame))

    def _add(self, frame: SlamFrame) -> None:
        self._frames[frame.scan] = frame
        while len(self._frames) > MOST_FRAMES:
            self._stride *= 2
            self._frames = {k: f for k, f in self._frames.items() if k % self._stride == 0}


def _line(frame: SlamFrame) -> str:
    values = {
        "scan": frame.scan,
        "first_open": frame.first_open,
        "poses": [poses.tolist() for poses in frame.poses],
        "settled": frame.settled.tolist(),
        "tentative": frame.tentative.tolist(),
        "status": frame.status,
        "n_loops": frame.n_loops,
    }
    return json.dumps(values) + "\n"


def _logged(log: Path) -> list[SlamFrame]:
    """Read the frames of a log as far as it is whole; a kill may have cut its last line."""
    if not log.exists():
        return []
    frames = []
    for line in log.read_text(encoding="utf-8").splitlines():
        try:
            values = json.loads(line)
            frame = SlamFrame(
                scan=values["scan"],
                first_open=values["first_open"],
                poses=tuple(np.array(poses) for poses in values["poses"]),
                settled=np.array(values["settled"]).reshape(-1, 2),
                tentative=np.array(values["tentative"]).reshape(-1, 2),
                status=values["status"],
                n_loops=values["n_loops"],
            )
        except (ValueError, KeyError, TypeError):
            break
        frames.append(frame)
    return frames
