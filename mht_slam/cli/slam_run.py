"""One run of the estimator over a stream of scans: result lines, refusals, checkpoints, the end."""

from __future__ import annotations

import json
import math
import signal
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, TextIO

from mht_slam.association import MISSED
from mht_slam.cli.run_folder import to_json
from mht_slam.datasets.scan_records import Place, ScanRecord
from mht_slam.errors import MeasurementError, ScanFileError
from mht_slam.measurements import BearingScan, wrap_angle

if TYPE_CHECKING:
    from mht_slam.datasets.scan_stream import ScanStream
    from mht_slam.incremental.estimator import MultiHypothesisSlam

DIGITS = 6
"""Decimals of a result line; the run's folder holds full precision."""
ALONE = "none"
"""What a result line calls the reading that a detection is no landmark seen before or since."""


@dataclass(frozen=True)
class Checkpoints:
    """Where a run is saved, and after every how many scans."""

    path: Path
    every: int

    def save(self, slam: MultiHypothesisSlam) -> None:
        """Replace the checkpoint; raises `OSError` and leaves the older one where that fails."""
        try:
            slam.save(self.path)
        except OSError as cause:
            raise OSError(
                f"{self.path}: the checkpoint cannot be written ({cause.strerror}): make room or "
                "name another place; one from before is as it was"
            ) from cause


class SlamRun:
    """A run that reads, estimates and tells, scan by scan.

    Parameters
    ----------
    slam : a new estimator, or one from a checkpoint.
    known : the scans that it has taken before.
    name : what the stream is called in messages.
    out : where result lines go.
    strict : end at the first line that is rejected.
    checkpoints, watch : saved to and called, where given, after scans.

    Attributes
    ----------
    records : the scans of the stream that the estimator has, in order.
    rejected : how many lines were "malformed", how many scans "refused" by the estimator.
    """

    def __init__(
        self,
        slam: MultiHypothesisSlam,
        known: Sequence[BearingScan],
        name: Path,
        out: TextIO,
        *,
        strict: bool = False,
        checkpoints: Checkpoints | None = None,
        watch: Callable[[MultiHypothesisSlam], None] | None = None,
    ) -> None:
        self.slam, self.records = slam, list[ScanRecord]()
        self.rejected = Counter({"malformed": 0, "refused": 0})
        self._known, self._name, self._out, self._strict = known, name, out, strict
        self._checkpoints, self._watch = checkpoints, watch

    def follow(
        self, stream: ScanStream, progress: Callable[[int], None]
    ) -> KeyboardInterrupt | BrokenPipeError | ScanFileError | None:
        """Take every scan of the stream, and return what ended the run before the stream did.

        A stream that begins with the first known scan is taken for the recording that they are
        from, and is passed over as far as they go; any other for what comes after them. A
        result line is written before the scan may enter a checkpoint, so that a run which is
        killed and resumed leaves out none: it repeats those since the checkpoint.

        Raises `ScanFileError` where a recording ends before the known scans do, and `OSError` where
        lines or checkpoints cannot be written.
        """
        ended: KeyboardInterrupt | BrokenPipeError | ScanFileError | None = None
        with _Interrupts() as interrupts:
            try:
                while (found := interrupts.next_of(stream)) is not None:
                    self._take(*found)
                    progress(found[0])
            except (KeyboardInterrupt, BrokenPipeError, ScanFileError) as reason:
                ended = reason
            self._finish(ended)
        return ended or (KeyboardInterrupt() if interrupts.came else None)

    def _finish(self, ended: BaseException | None) -> None:
        if ended is None and self._is_passing:
            raise ScanFileError(
                f"{self._name}: has {len(self.records)} of the {len(self._known)} scans of the "
                "checkpoint: give the recording that it was made from, or what comes after them"
            )
        self.records += [ScanRecord(scan, None, 0) for scan in self._known[len(self.records) :]]
        # Whoever read the lines has gone, maybe without the last ones: a resumed run repeats them.
        if not isinstance(ended, BrokenPipeError) and self.slam.n_scans:
            self._save()

    @property
    def _is_passing(self) -> bool:
        """Whether the stream is still among scans that the estimator has."""
        return 0 < len(self.records) < len(self._known)

    def _take(self, line: int, entry: ScanRecord | ScanFileError) -> None:
        if isinstance(entry, ScanFileError):
            self._reject("malformed", entry)
        elif len(self.records) < len(self._known) and _same(entry, self._known[len(self.records)]):
            self.records.append(entry)
        elif self._is_passing:
            self.rejected["refused"] += 1  # as it was when the checkpoint was made
        else:
            self._estimate(line, entry)

    def _estimate(self, line: int, record: ScanRecord) -> None:
        try:
            self.slam.update(record.scan)
        except MeasurementError as cause:
            self._reject("refused", Place(self._name, line).measurement_error(cause))
            return
        if not self.records:
            self.records += [ScanRecord(scan, None, 0) for scan in self._known]
        self.records.append(record)
        self._out.write(result_line(self.slam, record.scan) + "\n")
        self._out.flush()
        if self._watch is not None:
            self._watch(self.slam)
        if self._checkpoints is not None and self.slam.n_scans % self._checkpoints.every == 0:
            self._save()

    def _save(self) -> None:
        if self._checkpoints is not None:
            self._checkpoints.save(self.slam)

    def _reject(self, kind: str, error: ScanFileError) -> None:
        self.rejected[kind] += 1
        if self._strict:
            raise error
        if not self._is_passing:
            sys.stderr.write(f"mht-slam: rejected: {' '.join(str(error).split())}\n")


def result_line(slam: MultiHypothesisSlam, scan: BearingScan) -> str:
    """Return what the estimator says after a scan, as one JSON object.

    The pose is the newest one, in the frame of the first, as known at this moment. `detections` has
    for each detection of the scan the probability of each landmark, the most probable first.
    """
    posterior = slam.posterior
    best = posterior[0] if len(posterior) else None
    poses = slam.online_trajectory if best is None or best.poses is None else best.poses
    x, y, theta = (float(value) for value in poses[-1])
    values = {
        "scan": slam.n_scans - 1,
        "time": scan.time,
        "status": slam.status,
        "hypotheses": len(posterior),
        "probability": None if best is None else round(best.probability, DIGITS),
        "pose": {
            "x": round(x, DIGITS),
            "y": round(y, DIGITS),
            "theta_deg": round(math.degrees(wrap_angle(theta)), DIGITS),
        },
        "detections": [_readings(marginal) for marginal in slam.marginal_associations],
        "dropped": dict(sorted(Counter(dropped.reason for dropped in slam.dropped).items())),
        "loops": len(slam.loops),
    }
    return json.dumps(to_json(values), allow_nan=False)


def _readings(marginal: dict[int, float]) -> dict[str, float]:
    ordered = sorted(marginal.items(), key=lambda reading: (-reading[1], reading[0]))
    return {
        ALONE if landmark == MISSED else f"{landmark}": round(probability, DIGITS)
        for landmark, probability in ordered
    }


def _same(record: ScanRecord, known: BearingScan) -> bool:
    scan = BearingScan(record.scan.bearings, time=record.scan.time)
    return scan == known


class _Interrupts:
    """Interrupts that end a run only where it waits: half an update is nothing to save."""

    def __init__(self) -> None:
        self.came, self._waits = False, False

    def __enter__(self) -> _Interrupts:
        self._before = signal.getsignal(signal.SIGINT)
        if self._before is not signal.SIG_IGN:  # as in the background of a script
            signal.signal(signal.SIGINT, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        signal.signal(signal.SIGINT, self._before)

    def next_of(self, stream: ScanStream) -> tuple[int, ScanRecord | ScanFileError] | None:
        """Wait for the next line, None at the end; raises `KeyboardInterrupt`, also a late one."""
        self._waits = True
        try:
            if self.came:
                raise KeyboardInterrupt
            return next(stream, None)
        finally:
            self._waits = False

    def _note(self, _number: int, _frame: FrameType | None) -> None:
        self.came = True
        if self._waits:
            raise KeyboardInterrupt
