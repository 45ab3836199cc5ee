"""The Victoria Park reader turns its bearings, finds the scans, and joins its three files."""

import math

import numpy as np
import pytest

from mht_slam.association import MISSED
from mht_slam.datasets import data_folder, read_victoria_park, straight_window_runs
from mht_slam.datasets.victoria_park import read_measurements
from mht_slam.datasets.victoria_park_windows import TRACK_COLUMNS, WINDOW_COLUMNS, read_windows
from mht_slam.errors import RecordingError, RecordingNotFoundError

MEASUREMENTS = """\
 0.5  4.0  1.5707963  0.3
 0.5  2.0  0.5707963  0.2

 0.7  3.0  1.5707963  0.3
 0.7  1.9  0.5507963  0.2
 0.8  9.0  3.0  0.2
 1.1  2.0  1.5707963  0.3
"""
WINDOW = "0,0,3,0.5,1.1,4,2.0,0.0,0.6,1,1,0.0,3,6,0.1,nan"
TRACKS = """\
0,0,0.5,4,0.0,4.0,0.0,0.0,0.0,4.0,0.1
0,1,0.7,4,0.0,3.0,1.0,0.0,0.2,4.0,0.1
0,3,1.1,4,0.0,2.0,3.0,0.0,0.4,4.0,0.1
"""


def write(folder, measurements=MEASUREMENTS, windows=WINDOW, tracks=TRACKS):
    (folder / "measurements.dat").write_text(measurements)
    (folder / "straight_windows.csv").write_text(f"{','.join(WINDOW_COLUMNS)}\n{windows}\n")
    (folder / "tracks.csv").write_text(f"{','.join(TRACK_COLUMNS)}\n{tracks}")
    return folder


def test_lines_of_equal_time_are_one_scan_and_bearings_are_from_forward(tmp_path):
    laser = read_victoria_park(write(tmp_path)).laser
    assert [scan.time for scan in laser.scans] == laser.times.tolist() == [0.5, 0.7, 0.8, 1.1]
    np.testing.assert_allclose(laser.scans[0].bearings, [0.0, -1.0], atol=1e-7)
    assert laser.ranges[1].tolist() == [3.0, 1.9]
    assert laser.diameters[1].tolist() == [0.3, 0.2]


def test_a_detection_in_no_track_is_a_false_alarm(tmp_path):
    (labelled,) = straight_window_runs(read_victoria_park(write(tmp_path)))
    assert labelled.run.n_detections == (2, 2, 1, 1)
    assert labelled.identities == (4,)
    assert labelled.truth.n_landmarks == 1
    (row,) = labelled.truth.table.tolist()
    assert row[2] == MISSED
    for scan in (0, 1, 3):
        assert labelled.run.scans[scan].bearings[row[scan]] == pytest.approx(0.0, abs=1e-7)
    assert len(labelled.truth.false_alarms) == 3
    assert labelled.reference_landmarks.tolist() == [[4.0, 0.1]]


def test_a_scan_without_a_tracked_detection_has_a_pose_interpolated_in_time(tmp_path):
    (window,) = read_victoria_park(write(tmp_path)).windows
    share = (0.8 - 0.7) / (1.1 - 0.7)
    np.testing.assert_allclose(
        window.reference_poses,
        [[0, 0, 0], [1, 0, 0.2], [1 + 2 * share, 0, 0.2 + 0.2 * share], [3, 0, 0.4]],
    )


@pytest.mark.parametrize(
    ("text", "line", "field"),
    [
        ("0.5 4.0 1.57\n", 1, "row: 3 fields"),
        ("0.5 4.0 1.57 thick\n", 1, "diameter: 'thick'"),
        ("\n0.5 inf 1.57 0.3\n", 2, "range: 'inf'"),
        ("0.5 4.0 1.57 0.3\n0.4 4.0 1.57 0.3\n", 2, "time: 0.4: it runs backwards"),
    ],
)
def test_a_malformed_measurement_is_named_by_file_line_and_field(tmp_path, text, line, field):
    path = tmp_path / "measurements.dat"
    path.write_text(text)
    with pytest.raises(RecordingError, match=field) as raised:
        read_measurements(path)
    assert str(raised.value).startswith(f"{path}:{line}: ")


@pytest.mark.parametrize(
    ("row", "field"),
    [
        (WINDOW.replace("0,0,3", "1,0,3", 1), "window: 1"),
        (WINDOW.replace("0,0,3", "0,0,4", 1), "scan_i: scans 0 to 4"),
        (WINDOW.replace("0,0,3", "0,1,3", 1), "n_scans: 4"),
        (WINDOW.replace("2.0", "far", 1), "chord_m: 'far'"),
        (WINDOW + ",1", "row: 17 fields"),
    ],
)
def test_a_window_that_cannot_be_is_refused(tmp_path, row, field):
    path = write(tmp_path, windows=row) / "straight_windows.csv"
    with pytest.raises(RecordingError, match=f":2: {field}"):
        read_windows(path, n_scans=4)


@pytest.mark.parametrize(
    ("track", "field"),
    [
        ("1,1,0.7,4,0.0,3.0,1.0,0.0,0.2,4.0,0.1", "window: 1: no such window"),
        ("0,4,0.7,4,0.0,3.0,1.0,0.0,0.2,4.0,0.1", "scan_index: 4: outside its window"),
        ("0,1,0.7,4,0.1,3.0,1.0,0.0,0.2,4.0,0.1", "bearing_rad_ccw_from_forward: 0.1: 0 such"),
        ("0,1,0.7,4,0.0,3.1,1.0,0.0,0.2,4.0,0.1", "bearing_rad_ccw_from_forward: 0.0: 0 such"),
        ("0,1,0.9,4,0.0,3.0,1.0,0.0,0.2,4.0,0.1", "t_s: 0.9: the scan has another time"),
        ("0,0,0.5,5,-1.0,2.0,0.5,0.0,0.0,1.0,1.0", "ref_x: .*another pose"),
        ("0,0,0.5,4,-1.0,2.0,0.0,0.0,0.0,4.0,0.1", "track_in_window: 4: twice"),
        ("0,1,0.7,4,0.0,3.0,1.0,0.0,0.2,4.0,0.2", "ref_lm_x: .*elsewhere"),
        (
            "0,0,0.5,5,0.0,4.0,0.0,0.0,0.0,9.0,0.1",
            "bearing_rad_ccw_from_forward: 0.0: 0 such",
        ),  # it is of track 4
        ("0,1,0.7,4,ahead,3.0,1.0,0.0,0.2,4.0,0.1", "bearing_rad_ccw_from_forward: 'ahead'"),
    ],
)
def test_a_track_that_contradicts_the_scans_is_named_by_line(tmp_path, track, field):
    first = TRACKS.splitlines()[0]
    folder = write(tmp_path, tracks=f"{first}\n{track}\n")
    with pytest.raises(RecordingError, match=f"tracks.csv:3: {field}"):
        read_victoria_park(folder)


def test_counts_of_the_window_that_the_tracks_do_not_give_are_refused(tmp_path):
    folder = write(tmp_path, tracks="".join(TRACKS.splitlines(keepends=True)[:2]))
    with pytest.raises(RecordingError, match=r"window 0: .*: 6 and 4 are in the other"):
        read_victoria_park(folder)


def test_a_window_without_a_track_is_refused(tmp_path):
    folder = write(tmp_path, windows=WINDOW.replace(",3,6,", ",6,6,"), tracks="")
    with pytest.raises(RecordingError, match="window 0: it has no track"):
        read_victoria_park(folder)


def test_a_folder_without_the_recording_says_what_is_missing(tmp_path):
    with pytest.raises(RecordingNotFoundError, match=r"measurements\.dat"):
        read_victoria_park(tmp_path)


@pytest.fixture(scope="module")
def recording():
    try:
        return read_victoria_park(data_folder() / "victoria_park")
    except RecordingNotFoundError as reason:
        pytest.skip(str(reason))


def test_the_windows_of_the_recording_hold_every_detection(recording):
    runs = straight_window_runs(recording)
    assert len(recording.laser.scans) == 4207
    assert len(runs) == 111
    assert sum(sum(labelled.run.n_detections) for labelled in runs) == 21452
    assert sum(len(labelled.truth.false_alarms) for labelled in runs) == 1441
    assert all((labelled.truth.table != MISSED).sum(axis=1).min() >= 3 for labelled in runs)


def test_bearings_agree_with_the_reference_map(recording):
    errors = [
        math.remainder(bearing - math.atan2(map_[i][1] - y, map_[i][0] - x) + theta, math.tau)
        for labelled in straight_window_runs(recording)
        for map_ in [labelled.reference_landmarks]
        for scan, rows, (x, y, theta) in zip(
            labelled.run.scans,
            labelled.truth.landmark_of_detection(),
            labelled.reference_poses,
            strict=True,
        )
        for bearing, i in zip(scan.bearings.tolist(), rows.tolist(), strict=True)
        if i != MISSED
    ]
    assert len(errors) == 21452 - 1441
    spread = 1.4826 * math.degrees(np.median(np.abs(errors)))
    assert 0.08 < spread < 0.15
