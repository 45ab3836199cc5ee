"""The UTIAS multi-robot recording, one drive for each robot, in its original text files.

Leung, Halpern, Barfoot, Liu, "The UTIAS Multi-Robot Cooperative Localization and Mapping Dataset",
International Journal of Robotics Research 30(8), 2011.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mht_slam.arrays import FloatArray, whole_number
from mht_slam.association import MISSED
from mht_slam.datasets.drive import Drive, shuffled_drive
from mht_slam.datasets.drive_odometry import StepNoise, integrated_motions
from mht_slam.datasets.location import data_folder, recording_file
from mht_slam.datasets.tables import FieldReader, read_numbers, read_text
from mht_slam.errors import RecordingError
from mht_slam.measurements import BearingScan

FOLDER = Path("mrclam", "MRCLAM_Dataset6")
SAME_FRAME = 0.01
"""Seconds: stamps of one image differ by a millisecond."""
IMAGE_PERIOD = 0.235
"""Seconds from image to image. An image in which no code was read left no line in the files: the
times between two that did are multiples of this."""
RESPONSE = 0.17
"""Seconds after which a robot does what it was told, where odometry, which is what it was told,
agrees best with the turns that motion capture saw of robots 1, 3 and 5 (tuning half)."""
ROBOT_NOISE = StepNoise(
    floor=0.001,
    forward_share=0.2,
    lateral_share=0.05,
    turn_floor=0.006,
    turn_per_metre=0.1,
    turn_share=0.15,
)
"""Rounded from odometry minus motion capture, image by image, of the same three robots."""


def mrclam_drive(robot: int, folder: Path | None = None) -> Drive:
    """Return everything that one robot, 1 to 5, saw, with odometry.

    A scan is an image: what was seen within `SAME_FRAME`, or nothing, in the images between that
    left no line in the files. Landmarks have their subject number as identity; other robots, which
    move, and codes of nobody are false alarms (-1). Ranges and codes are withheld. References are
    those of motion capture, interpolated in time.

    `folder` holds the robots' files; None looks in `data_folder()`. Raises
    `RecordingNotFoundError` where a file is missing, as for a robot that there is not, and
    `RecordingError`, with file, line and field, where one is malformed.
    """
    whole_number(robot, "robot", at_least=1)
    source = data_folder() / FOLDER if folder is None else Path(folder)

    def numbers(kind: str, *fields: str) -> FloatArray:
        return read_numbers(recording_file(source, f"Robot{robot}_{kind}.dat"), ("time", *fields))

    seen = numbers("Measurement", "barcode", "range", "bearing")
    driven = numbers("Odometry", "speed", "turn")
    truth = numbers("Groundtruth", "x", "y", "orientation")
    landmarks = _landmarks(recording_file(source, "Landmark_Groundtruth.dat"))
    subjects = _subjects(recording_file(source, "Barcodes.dat"))
    times, frames = _images(seen)
    twists = np.column_stack([driven[:, 1], np.zeros(len(driven)), driven[:, 2]])
    motions = integrated_motions(driven[:, 0] + RESPONSE, twists, times)
    steps = [None, *(ROBOT_NOISE.odometry(motion) for motion in motions)][: len(frames)]
    identities = []
    for frame in frames:
        of_frame = [subjects.get(int(code), MISSED) for code in frame[:, 1]]
        identities.append(np.array([i if i in landmarks else MISSED for i in of_frame], np.int64))
    return shuffled_drive(
        f"mrclam robot {robot}",
        [
            BearingScan(frame[:, 3], time=time, odometry=step)
            for frame, time, step in zip(frames, times.tolist(), steps, strict=True)
        ],
        identities,
        poses=_interpolated(truth, times),
        landmarks=landmarks,
    )


def _images(seen: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
    """Times of all images, and the lines of each: those without a line lie evenly between."""
    if not len(seen):
        return np.empty(0), []
    recorded = np.split(seen, _begins(seen[:, 0])[1:])
    times, frames = [float(recorded[0][0, 0])], [recorded[0]]
    for frame in recorded[1:]:
        before, now = times[-1], float(frame[0, 0])
        steps = max(1, round((now - before) / IMAGE_PERIOD))
        times += np.linspace(before, now, steps + 1)[1:].tolist()
        frames += [seen[:0]] * (steps - 1) + [frame]
    return np.array(times), frames


def _begins(times: FloatArray) -> list[int]:
    """Index of the first detection of each frame."""
    begins: list[int] = []
    for k, time in enumerate(times.tolist()):
        if not begins or time - times[begins[-1]] > SAME_FRAME:
            begins.append(k)
    return begins


def _interpolated(truth: FloatArray, times: FloatArray) -> FloatArray:
    """Poses at these times, (m, 3); NaN before the first and after the last true one."""
    columns = truth[:, 1:].T.copy()
    columns[2] = np.unwrap(columns[2])
    known = [np.interp(times, truth[:, 0], column, left=np.nan, right=np.nan) for column in columns]
    return np.column_stack(known)


def _landmarks(path: Path) -> dict[int, tuple[float, float]]:
    names = ("subject", "x", "y", "x_sd", "y_sd")
    return {
        read.whole(words[0], "subject"): (read.number(words[1], "x"), read.number(words[2], "y"))
        for read, words in _rows(path, names)
    }


def _subjects(path: Path) -> dict[int, int]:
    """Barcode to subject."""
    return {
        read.whole(words[1], "barcode"): read.whole(words[0], "subject")
        for read, words in _rows(path, ("subject", "barcode"))
    }


def _rows(path: Path, names: tuple[str, ...]) -> list[tuple[FieldReader, list[str]]]:
    rows = []
    for line, text in enumerate(read_text(path).split("\n"), start=1):
        words, read = text.split(), FieldReader(path, line)
        if not words or words[0].startswith("#"):
            continue
        if len(words) != len(names):
            raise read.error("row", f"{len(words)} fields", f"expected {' '.join(names)}")
        rows.append((read, words))
    if not rows:
        raise RecordingError(f"{path}: it is empty: take an unspoilt copy")
    return rows
