"""A live view of a drive in the rerun viewer, or a recording of it that rerun opens later."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.errors import MissingExtraError, OptionError
from mht_slam.plotting.slam_frames import SlamFrame

INK, LIGHT, BLUE, RED = (230, 230, 230), (224, 168, 96), (127, 168, 209), (220, 60, 60)
"""Colours on the viewer's dark ground."""
STRETCH = 100
"""Settled poses in one piece of path: a scan is to cost the same all along a run."""


class RerunView:
    """The viewer, given one frame after the other.

    The path, the settled landmarks, what the best hypothesis has over the open scans, and the paths
    of the alternatives lie in the plane z = 0 of the first pose's frame; the timeline is ``scan``.

    Parameters
    ----------
    recording : file to write (.rrd); None opens the viewer's window.

    Raises `MissingExtraError` without rerun, and `OptionError` where there is no viewer to open or
    the file cannot be written.
    """

    def __init__(self, recording: Path | None = None) -> None:
        self._rerun = _rerun()
        self._stream = self._rerun.RecordingStream("mht-slam")
        try:
            if recording is None:
                self._stream.spawn()
            else:
                self._stream.save(recording)
        except (OSError, RuntimeError) as cause:
            what = "no viewer can be opened" if recording is None else f"{recording}: no such place"
            raise OptionError(f"rerun: {what} ({cause}): name a file to record to") from cause
        up = self._rerun.ViewCoordinates.RIGHT_HAND_Z_UP
        self._stream.log("/", up, static=True)
        self._settled: dict[int, FloatArray] = {}
        self._before: SlamFrame | None = None

    def show(self, frame: SlamFrame) -> None:
        """Show a frame; frames come in the order of their scans."""
        rerun = self._rerun
        self._stream.set_time("scan", sequence=frame.scan)
        self._log_settled(frame)
        best, *others = [_in_space(poses[:, :2]) for poses in frame.poses]
        self._stream.log("open/best", rerun.LineStrips3D([best], colors=[INK]))
        self._stream.log("open/alternatives", rerun.LineStrips3D(others, colors=[LIGHT]))
        tentative = rerun.Points3D(_in_space(frame.tentative), colors=[LIGHT])
        self._stream.log("open/landmarks", tentative)
        self._stream.log("robot", rerun.Points3D(best[-1:], colors=[RED]))
        self._stream.log("map", rerun.Points3D(_in_space(frame.settled), colors=[BLUE]))
        before = self._before
        if before is None or before.status != frame.status:
            self._stream.log("log", rerun.TextLog(f"status: {frame.status}"))
        if before is not None and before.n_loops < frame.n_loops:
            self._stream.log("log", rerun.TextLog(f"loops closed: {frame.n_loops}"))
        self._before = frame

    def close(self) -> None:
        """Hand over what is still on its way."""
        self._stream.flush()
        self._stream.disconnect()

    def _log_settled(self, frame: SlamFrame) -> None:
        """Log the stretch of path that grew: what the frame before had as its oldest open poses."""
        if self._before is None:
            return
        newly = range(self._before.first_open, frame.first_open)
        for scan, pose in zip(newly, self._before.poses[0], strict=False):
            self._settled[scan] = pose[:2]
            piece = scan // STRETCH
            # One pose more than the stretch, so that pieces meet.
            self._settled = {k: at for k, at in self._settled.items() if k >= piece * STRETCH - 1}
            strip = _in_space(np.array(list(self._settled.values())))
            line = self._rerun.LineStrips3D([strip], colors=[INK])
            self._stream.log(f"path/{piece}", line)


def _in_space(points: FloatArray) -> FloatArray:
    return np.column_stack([points, np.zeros(len(points))])


def _rerun() -> Any:
    try:
        return import_module("rerun")
    except ImportError as cause:
        raise MissingExtraError(
            "rerun is not installed: pip install 'mht-slam[rerun]', or leave --rerun"
        ) from cause
