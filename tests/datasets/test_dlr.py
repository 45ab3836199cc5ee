"""The DLR reader turns a left-handed frame into ours, and its sources agree."""

import math
from itertools import pairwise

import numpy as np
import pytest

from mht_slam.datasets import (
    data_folder,
    read_dlr,
    read_map_circles,
    read_observations,
    read_reference_landmarks,
    read_reference_poses,
)
from mht_slam.datasets.dlr_segments import COLUMNS, read_segments
from mht_slam.errors import RecordingError, RecordingNotFoundError
from mht_slam.measurements import wrap_angle

SAMPLE = """\
# a comment, then a step: 0.1 m to the right, 0.5 m ahead, a right turn of 0.2
STEP image.0000 0.1 -0.5 0.2 0.01 0.001 0.02 0.002 0.003 0.04
LANDMARK_C 0.0 -2.0 0.9 0.1 0.0 0.1 7
LANDMARK_C -1.0 -1.0 0.8 0.1 0.0 0.1 3
LANDMARK_C 1.0 -1.0 0.7 0.1 0.0 0.1 -1
LANDMARK 1.0 0.0 0.6 0.1 0.0 0.1 -1

STEP image.0001 0.0 -0.1 0.0 0.01 0.0 0.01 0.0 0.0 0.01
STEP image.0002 0.0 -0.1 0.0 0.01 0.0 0.01 0.0 0.0 0.01
LANDMARK_C 1.0 -1.0 0.5 0.1 0.0 0.1 3 9
"""
STEP = SAMPLE.splitlines()[1]
OBSERVATIONS_HEADER = "scan,bearing_rad_ccw_from_forward,range_m,quality,id,label_suspect\n"


@pytest.fixture
def sample(tmp_path):
    path = tmp_path / "map.circles"
    path.write_text(SAMPLE)
    return read_map_circles(path)


@pytest.fixture(scope="module")
def dlr_folder():
    try:
        folder = data_folder() / "dlr"
    except RecordingNotFoundError as reason:
        pytest.skip(str(reason))
    if not folder.is_dir():
        pytest.skip(f"{folder} does not exist")
    return folder


@pytest.fixture(scope="module")
def recording(dlr_folder):
    return read_dlr(dlr_folder)


def test_bearings_are_counter_clockwise_from_forward(sample):
    np.testing.assert_allclose(
        sample.scans[0].bearings, [0.0, math.pi / 4, -math.pi / 4, -math.pi / 2], atol=1e-15
    )
    np.testing.assert_allclose(sample.ranges[0], [2.0, math.sqrt(2), math.sqrt(2), 1.0])
    assert sample.qualities[0].tolist() == [0.9, 0.8, 0.7, 0.6]


def test_every_step_is_a_scan_even_one_that_saw_nothing(sample):
    assert [len(scan) for scan in sample.scans] == [4, 0, 1]


def test_odometry_is_forward_left_and_counter_clockwise(sample):
    odometry = sample.scans[0].odometry
    assert (odometry.dx, odometry.dy, odometry.dtheta) == (0.5, -0.1, -0.2)
    np.testing.assert_allclose(
        odometry.covariance,
        [[0.02, 0.001, 0.003], [0.001, 0.01, 0.002], [0.003, 0.002, 0.04]],
    )


def test_scans_hold_no_identity_and_the_truth_is_apart(sample):
    assert all(scan.labels is None for scan in sample.scans)
    assert [ids.tolist() for ids in sample.identities] == [[7, 3, -1, -1], [], [3]]
    truth = sample.truth(range(3))
    assert truth.table.tolist() == [[0, -1, -1], [1, -1, 0]]
    assert truth.false_alarms == ((0, 2), (0, 3))


def test_a_detection_with_several_ids_is_suspect(sample):
    assert [suspect.tolist() for suspect in sample.label_suspect] == [[False] * 4, [], [True]]


@pytest.mark.parametrize(
    ("text", "line", "field"),
    [
        ("LANDMARK_C 0 -2 0.9 0.1 0 0.1 7\n", 1, "before the first STEP"),
        ("STEP image 0.1 -0.5\n", 1, "STEP: 3 fields"),
        (STEP.replace("0.2", "fast") + "\n", 1, "dPhi: 'fast'"),
        (STEP.replace("0.2", "nan") + "\n", 1, "dPhi: 'nan'"),
        (STEP.replace("0.04", "-0.04") + "\n", 1, "positive definite"),
        (f"{STEP}\nLANDMARK_C 0 -2 0.9 0.1 0 0.1\n", 2, "LANDMARK: 6 fields"),
        (f"{STEP}\nLANDMARK_C 0 -2 0.9 0.1 0 0.1 x\n", 2, "ID: 'x'"),
        (f"{STEP}\nLANDMARK_C 0 -2 0.9 0.1 0 0.1 -4\n", 2, "ID: -4"),
        (f"{STEP}\nLANDMARK_C 0 -2 0.9 0.1 0 nan 1\n", 2, "cYY"),
        (f"{STEP}\n" + "LANDMARK_C 0 -2 0.9 0.1 0 0.1 7\n" * 2, 3, "landmark 7 is there twice"),
        (f"{STEP}\n\nRANGE 3\n", 3, "RANGE: unknown record"),
    ],
)
def test_a_malformed_record_is_named_by_file_line_and_field(tmp_path, text, line, field):
    path = tmp_path / "map.circles"
    path.write_text(text)
    with pytest.raises(RecordingError, match=field) as raised:
        read_map_circles(path)
    assert str(raised.value).startswith(f"{path}:{line}: ")


@pytest.mark.parametrize(
    ("text", "line", "field"),
    [
        ("scan,bearing\n", 1, "header"),
        (OBSERVATIONS_HEADER + "0,0.1,2.0,0.9,4\n", 2, "row: 5 fields"),
        (OBSERVATIONS_HEADER + "0,0.1,2.0,0.9,4,0\n0,0.2,2.0,0.9,4,0\n", 3, "twice"),
        (OBSERVATIONS_HEADER + "9,0.1,2.0,0.9,4,0\n", 2, "scan: 9"),
        (OBSERVATIONS_HEADER + "0,inf,2.0,0.9,4,0\n", 2, "bearing: 'inf'"),
    ],
)
def test_a_malformed_observation_is_named_by_file_line_and_field(tmp_path, text, line, field):
    path = tmp_path / "observations.csv"
    path.write_text(text)
    with pytest.raises(RecordingError, match=field) as raised:
        read_observations(path, n_scans=3)
    assert str(raised.value).startswith(f"{path}:{line}: ")


def test_observations_keep_scans_that_saw_nothing(tmp_path):
    path = tmp_path / "observations.csv"
    path.write_text(OBSERVATIONS_HEADER + "1,0.1,2.0,0.9,4,1\n")
    assert [len(scan) for scan in read_observations(path).scans] == [0, 1]
    observed = read_observations(path, n_scans=3)
    assert [len(scan) for scan in observed.scans] == [0, 1, 0]
    assert observed.label_suspect[1].tolist() == [True]


@pytest.mark.parametrize(
    ("row", "field"),
    [
        ("strict,2,9,8,1,0,1,3,3,0", "scans 2 to 9"),
        ("strict,2,4,2,1,0,1,3,3,0", "n_scans: 2"),
        ("strict,4,2,3,1,0,1,3,3,0", "scans 4 to 2"),
        ("strict,2,4,3,far,0,1,3,3,0", "chord_m"),
    ],
)
def test_a_segment_that_cannot_be_is_refused(tmp_path, row, field):
    path = tmp_path / "segments.csv"
    path.write_text(",".join(COLUMNS) + "\n" + row + "\n")
    with pytest.raises(RecordingError, match=f":2: .*{field}"):
        read_segments(path, n_scans=6)


def test_reference_files_that_skip_or_repeat_are_refused(tmp_path):
    poses, landmarks = tmp_path / "poses.csv", tmp_path / "landmarks.csv"
    poses.write_text("scan,x_m,y_m,theta_rad\n0,0,0,0\n2,1,0,0\n")
    landmarks.write_text("id,x_m,y_m\n1,0,0\n1,1,0\n")
    with pytest.raises(RecordingError, match=":3: scan"):
        read_reference_poses(poses)
    with pytest.raises(RecordingError, match=":3: id"):
        read_reference_landmarks(landmarks)


def test_sources_that_disagree_are_refused(tmp_path):
    (tmp_path / "map.circles").write_text(SAMPLE)
    (tmp_path / "observations.csv").write_text(OBSERVATIONS_HEADER + "0,0.0,2.0,0.9,8,0\n")
    (tmp_path / "segments.csv").write_text(",".join(COLUMNS) + "\n")
    with pytest.raises(RecordingError, match="scan 0: its identities differ"):
        read_dlr(tmp_path)


def test_a_recording_has_a_reference_pose_for_every_scan(tmp_path):
    (tmp_path / "map.circles").write_text(f"{STEP}\n" * 2)
    (tmp_path / "observations.csv").write_text(OBSERVATIONS_HEADER)
    (tmp_path / "segments.csv").write_text(",".join(COLUMNS) + "\n")
    (tmp_path / "reference_landmarks.csv").write_text("id,x_m,y_m\n1,0,2\n")
    poses = tmp_path / "reference_poses.csv"
    poses.write_text("scan,x_m,y_m,theta_rad\n0,0,0,0\n")
    with pytest.raises(RecordingError, match="1 poses for the 2 scans"):
        read_dlr(tmp_path)
    poses.write_text("scan,x_m,y_m,theta_rad\n0,0,0,0\n1,1,0,0.5\n")
    recording = read_dlr(tmp_path)
    assert recording.reference_poses.tolist() == [[0, 0, 0], [1, 0, 0.5]]
    assert recording.reference_landmarks == {1: (0.0, 2.0)}


def test_a_folder_without_the_recording_says_what_is_missing(tmp_path):
    with pytest.raises(RecordingNotFoundError, match=r"map\.circles"):
        read_dlr(tmp_path)


def test_the_original_file_and_the_observations_agree(dlr_folder, recording):
    observed = read_observations(dlr_folder / "observations.csv", n_scans=len(recording.scans))
    assert len(recording.scans) == 2200
    for i, scan in enumerate(recording.scans):
        # The table is rounded to five and four decimals.
        np.testing.assert_allclose(scan.bearings, observed.scans[i].bearings, atol=5.1e-6)
        np.testing.assert_allclose(recording.ranges[i], observed.ranges[i], atol=5.1e-5)
        np.testing.assert_array_equal(recording.identities[i], observed.identities[i])


def test_odometry_agrees_with_the_reference_poses(dlr_folder, recording):
    poses = read_reference_poses(dlr_folder / "reference_poses.csv")
    differences = []
    for (before, after), scan in zip(pairwise(poses), recording.scans[1:], strict=True):
        turn = np.array([[math.cos(before[2]), math.sin(before[2])],
                         [-math.sin(before[2]), math.cos(before[2])]])  # fmt: skip
        forward, left = turn @ (after - before)[:2]
        step = scan.odometry
        differences.append(
            [step.dx - forward, step.dy - left, wrap_angle(step.dtheta - (after - before)[2])]
        )
    # A wrong sign or a swapped axis would leave a step of 0.16 m or a turn of degrees.
    assert (np.median(np.abs(differences), axis=0) < [0.01, 0.005, 0.006]).all()


def test_bearings_agree_with_the_reference_map(dlr_folder, recording):
    poses = read_reference_poses(dlr_folder / "reference_poses.csv")
    landmarks = read_reference_landmarks(dlr_folder / "reference_landmarks.csv")
    errors = [
        wrap_angle(bearing - math.atan2(landmarks[i][1] - y, landmarks[i][0] - x) + theta)
        for scan, ids, (x, y, theta) in zip(
            recording.scans, recording.identities, poses, strict=True
        )
        for bearing, i in zip(scan.bearings.tolist(), ids.tolist(), strict=True)
        if i in landmarks
    ]
    spread = 1.4826 * math.degrees(np.median(np.abs(errors)))
    assert len(errors) > 9000
    assert 0.15 < spread < 0.4
