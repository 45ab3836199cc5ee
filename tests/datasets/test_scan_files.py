"""Scan files give back what was written, and refuse what they cannot understand or hold."""

import math
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mht_slam.association import Association
from mht_slam.datasets import ScanFile, read_scans, write_scans
from mht_slam.datasets.scan_records import exact_degrees
from mht_slam.errors import ScanFileError
from mht_slam.measurements import BearingScan, Odometry, wrap_angle
from mht_slam.simulation import simulate_scene

ONE_FOLDER = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])

ANGLES = st.floats(-math.pi, math.pi)
NUMBERS = st.floats(-1e6, 1e6)
VARIANCES = st.floats(1e-6, 1e3)


@st.composite
def scans(draw, *, for_csv=False):
    bearings = draw(st.lists(ANGLES, min_size=int(for_csv), max_size=5))
    time = draw(st.none() | NUMBERS)
    if for_csv:
        return BearingScan(bearings, time=time)
    n = len(bearings)
    return BearingScan(
        bearings,
        time=time,
        sigma=draw(
            st.none()
            | st.floats(1e-6, 1.0)
            | st.lists(st.floats(1e-6, 1.0), min_size=n, max_size=n)
        ),
        labels=draw(
            st.none()
            | st.lists(st.none() | st.text(max_size=4), min_size=n, max_size=n).filter(
                lambda labels: (
                    len({x for x in labels if x is not None}) == sum(x is not None for x in labels)
                )
            )
        ),
        odometry=draw(
            st.none()
            | st.builds(
                Odometry,
                NUMBERS,
                NUMBERS,
                ANGLES,
                st.none() | st.tuples(VARIANCES, VARIANCES, VARIANCES),
            )
        ),
    )


@st.composite
def scan_files(draw, *, for_csv=False):
    members = draw(st.lists(scans(for_csv=for_csv), min_size=1, max_size=4))
    if not draw(st.booleans()):
        return members, None
    ids = [draw(st.permutations(range(8)))[: len(scan)] for scan in members]
    # Every other id stands for a false alarm.
    truth = Association.from_labels([[i if i % 2 else None for i in row] for row in ids])
    return members, truth


def assert_same(one, other):
    """Equal, with angles within one unit in the last place of their degrees."""
    for mine, theirs in zip(one, other, strict=True):
        turn = wrap_angle(mine.bearings - theirs.bearings)
        np.testing.assert_allclose(turn, 0.0, atol=1e-15 * 4)
        assert mine.time == theirs.time
        assert mine.labels == theirs.labels
        assert (mine.sigma is None) == (theirs.sigma is None)
        if mine.sigma is not None:
            np.testing.assert_allclose(mine.sigma, theirs.sigma, rtol=1e-15 * 4)
        assert (mine.odometry is None) == (theirs.odometry is None)
        if mine.odometry is not None:
            a, b = mine.odometry, theirs.odometry
            assert (a.dx, a.dy) == (b.dx, b.dy)
            assert a.dtheta == pytest.approx(b.dtheta, abs=1e-15 * 4)
            np.testing.assert_array_equal(
                np.array(a.covariance, dtype=float), np.array(b.covariance, dtype=float)
            )


@given(content=scan_files())
@ONE_FOLDER
def test_json_lines_give_back_everything(tmp_path, content):
    path = tmp_path / "scans.jsonl"
    members, truth = content
    write_scans(path, members, truth)
    back = read_scans(path)
    assert_same(back.scans, members)
    assert back.truth == truth


@given(content=scan_files(for_csv=True))
@ONE_FOLDER
def test_csv_gives_back_bearings_times_and_truth(tmp_path, content):
    path = tmp_path / "scans.csv"
    members, truth = content
    write_scans(path, members, truth)
    back = read_scans(path)
    assert_same(back.scans, members)
    assert back.truth == truth


@given(
    degrees=st.lists(st.floats(-179.999, 180.0), min_size=1),
    suffix=st.sampled_from(["jsonl", "csv"]),
)
@ONE_FOLDER
def test_a_file_that_is_read_and_written_reads_bit_for_bit_the_same(tmp_path, degrees, suffix):
    first, second = tmp_path / f"first.{suffix}", tmp_path / f"second.{suffix}"
    if suffix == "csv":
        rows = [f"0,1.5,{bearing!r}" for bearing in degrees]
        first.write_text("\n".join(["scan,time,bearing_deg", *rows]))
    else:
        first.write_text(f'{{"bearings_deg": {degrees}, "sigma_deg": 0.7}}')
    once = read_scans(first)
    write_scans(second, once.scans)
    assert read_scans(second) == once


@given(ANGLES)
def test_degrees_that_came_from_a_file_return_to_the_same_radians(angle):
    radians = math.radians(math.degrees(angle))
    assert math.radians(exact_degrees(radians)) == radians


@pytest.mark.parametrize("suffix", ["jsonl", "csv"])
def test_a_simulated_scene_survives_its_file(tmp_path, suffix):
    scene = simulate_scene("annulus", 5, np.random.default_rng(2), sigma=0.02)
    path = tmp_path / f"scene.{suffix}"
    write_scans(path, scene.scans, scene.truth)
    back = read_scans(path)
    assert back.truth == scene.truth
    assert_same(back.scans, scene.scans)


def test_the_documented_line_is_read(tmp_path):
    path = tmp_path / "scans.json"
    path.write_text(
        '{"time": 0.0, "bearings_deg": [10, -35.5], "sigma_deg": [1, 2], "labels": [null, "door"],'
        ' "odometry": {"dx": 1, "dy": 0.5, "dtheta_deg": 90, "covariance": [0.01, 0.02, 0.03]},'
        ' "landmarks": [4, -1]}\r\n\r\n'
    )
    (scan,), truth = read_scans(path).scans, read_scans(path).truth
    np.testing.assert_allclose(scan.bearings, np.deg2rad([10, -35.5]))
    np.testing.assert_allclose(scan.sigma, np.deg2rad([1, 2]))
    assert scan.labels == (None, "door")
    assert scan.odometry == Odometry(1.0, 0.5, math.pi / 2, [0.01, 0.02, 0.03])
    assert truth == Association([[0]], (2,))


@pytest.mark.parametrize(
    "covariance",
    ["[[4,1,0],[1,5,0],[0,0,6]]", "[4,1,0,1,5,0,0,0,6]"],
)
def test_a_full_covariance_is_nested_or_flat(tmp_path, covariance):
    path = tmp_path / "scans.jsonl"
    path.write_text(
        '{"bearings_deg": [], "odometry": {"dx": 0, "dy": 0, "dtheta_deg": 0, "covariance": '
        f"{covariance}}}}}"
    )
    matrix = read_scans(path).scans[0].odometry.covariance
    np.testing.assert_array_equal(matrix, [[4, 1, 0], [1, 5, 0], [0, 0, 6]])


GOOD_LINE = '{"bearings_deg": [1.0, 2.0]}\n'
ODOMETRY = '{"bearings_deg": [], "odometry": {"dx": 1, "dy": 0, "dtheta_deg": 0, "covariance": %s}}'


@pytest.mark.parametrize(
    ("line", "field"),
    [
        ("[1, 2]", "line"),
        ('{"bearings_deg": [1.0]', "column"),
        ('{"bearings": [1.0]}', "bearings: unknown key"),
        ('{"time": 1.0}', "bearings_deg: missing"),
        ('{"bearings_deg": 1.0}', "bearings_deg: 1.0"),
        ('{"bearings_deg": null}', "bearings_deg: null"),
        ('{"bearings_deg": [1.0, "x"]}', r"bearings_deg\[1\]: a string"),
        ('{"bearings_deg": [true]}', r"bearings_deg\[0\]: true or false"),
        ('{"bearings_deg": [NaN]}', "NaN"),
        ('{"bearings_deg": [-Infinity]}', "-Infinity"),
        ('{"bearings_deg": [1e999]}', r"bearings_deg\[0\]: not finite"),
        ('{"bearings_deg": [1' + "0" * 400 + "]}", r"bearings_deg\[0\]: not finite"),
        ('{"bearings_deg": [1' + "0" * 5000 + "]}", "too many digits"),
        ("[" * 100_000, "nested too deeply|not JSON"),
        ('{"bearings_deg": [], "bearings_deg": [1]}', "bearings_deg: the key is there twice"),
        ('{"bearings_deg": [1], "time": "noon"}', "time: a string"),
        ('{"bearings_deg": [1], "sigma_deg": [1, 2]}', "sigma"),
        ('{"bearings_deg": [1], "sigma_deg": 0}', "sigma"),
        ('{"bearings_deg": [1], "sigma_deg": "1"}', "sigma_deg: a string"),
        ('{"bearings_deg": [1], "labels": ["a", "b"]}', "labels"),
        ('{"bearings_deg": [1, 2], "labels": ["a", "a"]}', r"labels\[1\]"),
        ('{"bearings_deg": [1], "labels": [3]}', r"labels\[0\]: 3"),
        ('{"bearings_deg": [1], "odometry": [1, 2, 3]}', "odometry: a list"),
        ('{"bearings_deg": [1], "odometry": {"dx": 1, "dy": 2}}', "odometry.dtheta_deg: missing"),
        (
            '{"bearings_deg": [1], "odometry": {"dx": 1, "dy": 2, "dtheta_deg": 3, "dz": 4}}',
            "odometry.dz: unknown key",
        ),
        (ODOMETRY % "[1, 2]", "odometry.covariance: 2 numbers"),
        (ODOMETRY % "[[1, 2, 3], [1, 2], [1, 2, 3, 4]]", r"rows of \[3, 2, 4\]"),
        (ODOMETRY % "[[1,0,0],[0,1,0],[0,0,null]]", r"odometry.covariance\[2\]\[2\]: null"),
        (ODOMETRY % "[1, 1, -1]", "positive definite"),
        (ODOMETRY % "3", "odometry.covariance: 3"),
        ('{"bearings_deg": [1, 2], "landmarks": [0]}', "landmarks: 1 ids for 2 bearings"),
        ('{"bearings_deg": [1, 2], "landmarks": [5, 5]}', r"landmarks\[1\]: landmark 5"),
        ('{"bearings_deg": [1], "landmarks": [-2]}', r"landmarks\[0\]: -2"),
        ('{"bearings_deg": [1], "landmarks": [1.0]}', r"landmarks\[0\]: 1.0"),
        ('{"bearings_deg": [1], "landmarks": {"a": 1}}', "landmarks: an object"),
    ],
)
def test_a_malformed_json_line_is_named_by_file_line_and_field(tmp_path, line, field):
    path = tmp_path / "scans.jsonl"
    path.write_text(GOOD_LINE + "\n" + line + "\n" + GOOD_LINE)
    with pytest.raises(ScanFileError, match=field) as raised:
        read_scans(path)
    assert str(raised.value).startswith(f"{path}:3: ")


def test_landmarks_are_given_in_every_scan_or_in_none(tmp_path):
    path = tmp_path / "scans.jsonl"
    path.write_text('{"bearings_deg": [1], "landmarks": [3]}\n' + GOOD_LINE)
    with pytest.raises(ScanFileError, match=":2: landmarks: missing"):
        read_scans(path)


@pytest.mark.parametrize(
    ("rows", "line", "field"),
    [
        ("scan,bearing_deg\n0,1\n", 1, "header"),
        ("scan,time,bearing_deg,colour\n0,0,1,red\n", 1, "header"),
        ("scan,time,bearing_deg\n0,0,1\n0,0\n", 3, "row: 2 fields"),
        ("scan,time,bearing_deg\n0,0,1\n0,0,x\n", 3, "bearing_deg: 'x'"),
        ("scan,time,bearing_deg\n0,0,nan\n", 2, "bearing_deg: 'nan'"),
        ("scan,time,bearing_deg\n0,0,1_0\n", 2, "bearing_deg: '1_0'"),
        ("scan,time,bearing_deg\n0,inf,1\n", 2, "time: 'inf'"),
        ("scan,time,bearing_deg\n0.5,0,1\n", 2, "scan: '0.5'"),
        ("scan,time,bearing_deg\n-1,0,1\n", 2, "scan: -1"),
        ("scan,time,bearing_deg\n1,0,1\n0,0,1\n", 3, "scan: 0 follows 1"),
        ("scan,time,bearing_deg\n0,0,1\n2,0,1\n", 3, "scan: 2 follows 0"),
        ("scan,time,bearing_deg\n0,0,1\n1,0,1\n0,0,1\n", 4, "scan: 0 follows 1"),
        ("scan,time,bearing_deg\n0,0,1\n0,1,1\n", 3, "time"),
        ("scan,time,bearing_deg,landmark\n0,0,1,4\n0,0,2,4\n", 3, "landmark 4 is there twice"),
        ("scan,time,bearing_deg,landmark\n0,0,1,\n", 2, "landmark: ''"),
        ("scan,time,bearing_deg,landmark\n0,0,1,-3\n", 2, "-3"),
        ("scan,time,bearing_deg\n", 1, "only a header"),
        ('scan,time,bearing_deg\n0,0,"1\n', 2, "not CSV"),
    ],
)
def test_a_malformed_csv_row_is_named_by_file_line_and_field(tmp_path, rows, line, field):
    path = tmp_path / "scans.csv"
    path.write_text(rows)
    with pytest.raises(ScanFileError, match=field) as raised:
        read_scans(path)
    assert str(raised.value).startswith(f"{path}:{line}: ")


@pytest.mark.parametrize("suffix", ["jsonl", "csv"])
@pytest.mark.parametrize("content", [b"", b"\n \n\r\n"])
def test_a_blank_file_is_refused(tmp_path, suffix, content):
    path = tmp_path / f"scans.{suffix}"
    path.write_bytes(content)
    with pytest.raises(ScanFileError, match=":1: file: blank"):
        read_scans(path)


@pytest.mark.parametrize("suffix", ["jsonl", "csv"])
def test_text_that_is_not_utf8_is_named_by_its_line(tmp_path, suffix):
    path = tmp_path / f"scans.{suffix}"
    path.write_bytes(b"\n\n\xff\xfe\n")
    with pytest.raises(ScanFileError, match=":3: text: not UTF-8"):
        read_scans(path)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(ScanFileError, match="cannot be read"):
        read_scans(tmp_path / "absent.jsonl")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(ScanFileError, match="cannot be read"):
        read_scans(tmp_path / "folder.csv")


def test_the_suffix_decides_the_format_unless_it_is_given(tmp_path):
    scan = BearingScan([0.1])
    with pytest.raises(ScanFileError, match="suffix"):
        write_scans(tmp_path / "scans.txt", [scan])
    with pytest.raises(ScanFileError, match="file_format"):
        write_scans(tmp_path / "scans.txt", [scan], file_format="yaml")
    write_scans(tmp_path / "scans.txt", [scan], file_format="csv")
    assert (tmp_path / "scans.txt").read_text().startswith("scan,time,bearing_deg\n")
    assert_same(read_scans(tmp_path / "scans.txt", file_format="csv").scans, [scan])


@pytest.mark.parametrize(
    ("scan", "field"),
    [
        (BearingScan([]), "no detections"),
        (BearingScan([0.1], sigma=0.1), "sigma"),
        (BearingScan([0.1], labels=["a"]), "labels"),
        (BearingScan([0.1], odometry=Odometry(1, 0, 0)), "odometry"),
    ],
)
def test_csv_refuses_what_it_has_no_room_for(tmp_path, scan, field):
    path = tmp_path / "scans.csv"
    path.write_text("old")
    with pytest.raises(ScanFileError, match=f"scan 1: .*{field}"):
        write_scans(path, [BearingScan([0.2]), scan])
    assert path.read_text() == "old"


def test_writing_nothing_or_the_truth_of_other_scans_is_refused(tmp_path):
    with pytest.raises(ScanFileError, match="scans: none"):
        write_scans(tmp_path / "scans.jsonl", [])
    with pytest.raises(ScanFileError, match="truth"):
        write_scans(tmp_path / "scans.jsonl", [BearingScan([0.1])], Association([[0]], (2,)))
    assert list(tmp_path.iterdir()) == []


def test_a_write_that_fails_leaves_the_old_file_and_no_other(tmp_path, monkeypatch):
    path = tmp_path / "scans.jsonl"
    write_scans(path, [BearingScan([0.1])])
    before = path.read_bytes()

    def full_disc(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full_disc)
    with pytest.raises(ScanFileError, match="No space left"):
        write_scans(path, [BearingScan([0.2])])
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_is_replaced_as_a_whole_and_never_written_over(tmp_path):
    path, old = tmp_path / "scans.jsonl", tmp_path / "old.jsonl"
    write_scans(path, [BearingScan([0.1])])
    before = path.read_bytes()
    os.link(path, old)
    write_scans(path, [BearingScan([0.2])])
    assert old.read_bytes() == before
    assert path.read_bytes() != before


def test_writing_into_a_folder_that_is_none_is_named():
    with pytest.raises(ScanFileError, match="cannot be written"):
        write_scans(Path("absent-folder", "scans.jsonl"), [BearingScan([0.1])])


def test_a_scan_file_without_truth_says_so(tmp_path):
    (tmp_path / "scans.jsonl").write_text(GOOD_LINE)
    content = read_scans(tmp_path / "scans.jsonl")
    assert isinstance(content, ScanFile)
    assert content.truth is None
