"""What is wrong with a file of a drive is named by file, line and field."""

import shutil
from pathlib import Path

import pytest

from mht_slam.datasets.drive_car_park import DETECTION_COLUMNS, POSE_COLUMNS, car_park_drive
from mht_slam.datasets.drive_mrclam import IMAGE_PERIOD, RESPONSE, mrclam_drive
from mht_slam.datasets.tables import read_numbers
from mht_slam.errors import RecordingError, RecordingNotFoundError

ROBOT = {
    "Robot1_Measurement.dat": "# Time\n10.0 \t 63 1.0 0.5\n10.001 7 2.0 -0.5\n10.2 5 1.0 0.1\n",
    "Robot1_Odometry.dat": "9.0 1.0 0.0\n10.1 2.0 0.0\n",
    "Robot1_Groundtruth.dat": "10.0 0.0 1.0 3.1\n10.1 1.0 1.0 -3.1\n",
    "Landmark_Groundtruth.dat": "6 1.5 -2.5 0.001 0.001\n7 0.5 0.0 0.0 0.0\n",
    "Barcodes.dat": "1 14\n2 5\n6 63\n7 81\n",
}
CAR = {
    "poses.csv": ",".join(POSE_COLUMNS) + "\n0,1.0,0,0,0,,,,0\n1,1.2,0.1,0,0,,,,0\n",
    "detections.csv": ",".join(DETECTION_COLUMNS)
    + "\n0,1.0,0.1,3.0,2,1,0,0,0\n0,1.0,0.2,3.0,2,-1,0,0,0\n1,1.2,0.4,3.0,2,1,0,0,0\n",
    "velocity_steering.csv": "t_s,velocity_m_s,steering_rad\n0.9,1.0,0.0\n",
    "beacons.csv": "beacon,x_m,y_m\n1,3.0,0.5\n",
}


def write(folder: Path, files: dict[str, str], **changes: str) -> Path:
    for name, text in files.items():
        (folder / name).write_text(changes.get(name.partition(".")[0], text))
    return folder


def test_a_robot_frame_is_an_image_and_other_robots_are_clutter(tmp_path: Path) -> None:
    drive = mrclam_drive(1, write(tmp_path, ROBOT))
    assert drive.n_detections == (2, 1)
    ids = dict(zip(drive.scans[0].bearings.tolist(), drive.identities[0].tolist(), strict=True))
    assert ids == {0.5: 6, -0.5: -1}  # nobody has the barcode 7
    assert drive.identities[1].tolist() == [-1]  # barcode 5 is robot 2
    assert drive.reference_landmarks == {6: (1.5, -2.5), 7: (0.5, 0.0)}
    step = drive.scans[1].odometry
    assert step is not None
    assert step.dx == pytest.approx(0.2 * 1.0)  # told at 10.1 to go faster, it does so later
    assert drive.reference_poses[0].tolist() == [0.0, 1.0, 3.1]
    assert drive.reference_poses[1, 0] != drive.reference_poses[1, 0]  # NaN after the last


def test_a_robot_does_what_it_was_told_after_its_response(tmp_path: Path) -> None:
    told = f"9.0 1.0 0.0\n{10.1 - RESPONSE} 2.0 0.0\n"
    drive = mrclam_drive(1, write(tmp_path, ROBOT, Robot1_Odometry=told))
    step = drive.scans[1].odometry
    assert step is not None
    assert step.dx == pytest.approx(0.1 * 1.0 + 0.1 * 2.0)


def test_images_that_left_no_line_are_scans_of_nothing(tmp_path: Path) -> None:
    last = 10.0 + 4.1 * IMAGE_PERIOD
    seen = f"10.0 63 1.0 0.5\n10.001 7 2.0 -0.5\n{last} 63 1.0 0.1\n"
    drive = mrclam_drive(1, write(tmp_path, ROBOT, Robot1_Measurement=seen))
    assert drive.n_detections == (2, 0, 0, 0, 1)
    times = [scan.time for scan in drive.scans]
    assert times == pytest.approx([10.0 + k * (last - 10.0) / 4 for k in range(5)])
    assert drive.has_odometry


def test_the_car_park_joins_its_files(tmp_path: Path) -> None:
    drive = car_park_drive(write(tmp_path, CAR))
    assert [sorted(ids.tolist()) for ids in drive.identities] == [[-1, 1], [1]]
    step = drive.scans[1].odometry
    assert step is not None
    assert (step.dx, step.dy, step.dtheta) == pytest.approx((0.2, 0.0, 0.0))
    assert drive.reference_landmarks == {1: (3.0, 0.5)}


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("# t v w\n1.0 2.0\n", 2, "row: 2 fields: expected t v w"),
        ("1.0 2.0 fast\n", 1, "w: 'fast': a finite number"),
        ("1.0 2.0 1.0\n\n2.0 inf 0.0\n", 3, "v: 'inf'"),
        ("2.0 0.0 0.0\n1.0 0.0 0.0\n", 2, "t: 1.0: it runs backwards from 2.0"),
    ],
)
def test_a_line_that_is_no_row_of_numbers_is_named(
    tmp_path: Path, text: str, line: int, message: str
) -> None:
    path = tmp_path / "Odometry.dat"
    path.write_text(text)
    with pytest.raises(RecordingError, match=message) as raised:
        read_numbers(path, ("t", "v", "w"))
    assert str(raised.value).startswith(f"{path}:{line}: ")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("Barcodes", "1 14\n2 x\n", r"Barcodes.dat:2: barcode: 'x'"),
        ("Landmark_Groundtruth", "6 1.0\n", r"Landmark_Groundtruth.dat:1: row: 2 fields"),
        ("Barcodes", "", "Barcodes.dat: it is empty"),
    ],
)
def test_a_malformed_file_of_the_robots_is_refused(
    tmp_path: Path, name: str, text: str, message: str
) -> None:
    with pytest.raises(RecordingError, match=message):
        mrclam_drive(1, write(tmp_path, ROBOT, **{name: text}))


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("detections", "\n1,1.2", "\n2,1.2", "detections.csv:4: scan: 2: it is outside"),
        ("detections", "2,-1,", "2,1,", "detections.csv:3: beacon_index0: 1: a scan sees"),
        ("poses", "\n1,", "\n3,", "poses.csv:3: scan: 3: scan 1 comes here"),
        ("poses", "1,1.2", "1,0.2", "poses.csv:3: t_s: 0.2: it runs backwards"),
        ("beacons", "0.5", "near", "beacons.csv:2: y_m: 'near'"),
    ],
)
def test_a_malformed_file_of_the_car_park_is_refused(
    tmp_path: Path, name: str, old: str, new: str, message: str
) -> None:
    with pytest.raises(RecordingError, match=message):
        car_park_drive(write(tmp_path, CAR, **{name: CAR[f"{name}.csv"].replace(old, new)}))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingNotFoundError, match=r"Robot6_Measurement\.dat"):
        mrclam_drive(6, write(tmp_path, ROBOT))
    shutil.rmtree(write(tmp_path, CAR))
    with pytest.raises(RecordingNotFoundError, match=r"poses\.csv"):
        car_park_drive(tmp_path)
