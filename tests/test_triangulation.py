"""Two scans and a known association give points, covariances and cells in F_R."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import assume, given
from hypothesis import strategies as st

from mht_slam.association import Association
from mht_slam.errors import AssociationError, MeasurementError, OptionError
from mht_slam.measurements import BearingScan
from mht_slam.triangulation import Triangulation, triangulate

PLACES = st.lists(
    st.tuples(st.floats(-4.0, 5.0), st.floats(0.3, 5.0), st.sampled_from([-1.0, 1.0])).map(
        lambda p: (p[0], p[1] * p[2])
    ),
    min_size=1,
    max_size=5,
)


def scans_of(landmarks: np.ndarray) -> tuple[BearingScan, BearingScan]:
    return (
        BearingScan(np.arctan2(landmarks[:, 1], landmarks[:, 0])),
        BearingScan(np.arctan2(landmarks[:, 1], landmarks[:, 0] - 1.0)),
    )


def known(landmarks: np.ndarray, *, epsilon: float = 0.01, sigma: float = 0.002) -> Triangulation:
    association = Association([[k, k] for k in range(len(landmarks))], (len(landmarks),) * 2)
    return triangulate(*scans_of(landmarks), association, epsilon=epsilon, sigma=sigma)


@given(PLACES)
def test_noiseless_landmarks_are_found_inside_their_cells(
    places: list[tuple[float, float]],
) -> None:
    landmarks = np.array(places)
    found = known(landmarks)
    assert found.meets.all()
    np.testing.assert_allclose(found.points, landmarks, atol=1e-9)
    for point, cell in zip(landmarks, found.cells, strict=True):
        assert shapely.covers(cell.buffer(1e-9), shapely.Point(point))


@given(PLACES)
def test_covariances_are_those_of_small_changes_of_the_bearings(
    places: list[tuple[float, float]],
) -> None:
    landmarks, step, sigmas = np.array(places[:1]), 1e-6, np.array([0.01, 0.03])
    bearings = np.array([scan.bearings[0] for scan in scans_of(landmarks)])

    def point(b: np.ndarray) -> np.ndarray:
        lines = np.array([[np.sin(b[0]), -np.cos(b[0])], [np.sin(b[1]), -np.cos(b[1])]])
        return np.linalg.solve(lines, [0.0, np.sin(b[1])])

    jacobian = np.column_stack(
        [(point(bearings + step * e) - point(bearings - step * e)) / (2 * step) for e in np.eye(2)]
    )
    found = triangulate(
        BearingScan(bearings[:1], sigma=sigmas[0]),
        BearingScan(bearings[1:], sigma=sigmas[1]),
        Association([[0, 0]], (1, 1)),
        epsilon=0.05,
        sigma=1.0,
    )
    expected = jacobian @ np.diag(sigmas**2) @ jacobian.T
    np.testing.assert_allclose(found.covariances[0], expected, rtol=1e-3, atol=1e-12)


@given(PLACES)
def test_a_mirrored_world_has_mirrored_landmarks(places: list[tuple[float, float]]) -> None:
    landmarks = np.array(places)
    mirror = np.array([1.0, -1.0])
    found, mirrored = known(landmarks), known(landmarks * mirror)
    np.testing.assert_allclose(mirrored.points, found.points * mirror, atol=1e-12)
    np.testing.assert_allclose(
        mirrored.covariances, found.covariances * np.outer(mirror, mirror), atol=1e-15
    )


def test_rays_that_do_not_meet_in_front_have_no_point() -> None:
    first, second = BearingScan([0.5, 0.5, 1.0]), BearingScan([0.4, 0.5, 1.3])
    association = Association([[0, 0], [1, 1], [2, 2]], (3, 3))
    found = triangulate(first, second, association, epsilon=0.06, sigma=0.01)
    assert found.meets.tolist() == [False, False, True]
    assert len(found.rows) == len(found.cells) == 3
    assert found.points.shape == (1, 2)
    assert found.covariances.shape == (1, 2, 2)
    assert found.unbounded.tolist() == [True, True, False]
    narrow = triangulate(first, second, association, epsilon=0.01, sigma=0.01)
    assert narrow.cells[0].is_empty  # even the cones diverge


def test_landmarks_that_one_scan_misses_are_left_out() -> None:
    landmarks = np.array([(0.5, 1.0), (2.0, -1.0)])
    first, second = scans_of(landmarks)
    association = Association([[0, -1], [1, 1], [-1, 0]], (2, 2))
    found = triangulate(first, second, association, epsilon=0.01, sigma=0.002)
    np.testing.assert_allclose(found.points, landmarks[1:])
    assert association.table[found.rows].tolist() == [[1, 1]]
    nobody = triangulate(first, second, Association([], (2, 2)), epsilon=0.01, sigma=0.002)
    assert nobody.points.shape == (0, 2)
    assert nobody.cells == ()


@given(PLACES, st.integers(0, 1000))
def test_bounded_noise_keeps_the_landmark_in_its_cell(
    places: list[tuple[float, float]], seed: int
) -> None:
    landmarks, epsilon = np.array(places), 0.02
    noise = np.random.default_rng(seed).uniform(-epsilon, epsilon, (2, len(landmarks)))
    first, second = scans_of(landmarks)
    association = Association([[k, k] for k in range(len(landmarks))], (len(landmarks),) * 2)
    assume(np.hypot(*landmarks.T).max() < 50.0)
    found = triangulate(
        BearingScan(first.bearings + noise[0]),
        BearingScan(second.bearings + noise[1]),
        association,
        epsilon=epsilon,
        sigma=0.01,
    )
    for point, cell in zip(landmarks, found.cells, strict=True):
        assert shapely.covers(cell.buffer(1e-9), shapely.Point(point))


def test_what_makes_no_sense_is_refused() -> None:
    first, second = scans_of(np.array([(0.5, 1.0)]))
    one = Association([[0, 0]], (1, 1))
    with pytest.raises(MeasurementError, match="second is list"):
        triangulate(first, [0.1], one, epsilon=0.1, sigma=0.1)  # type: ignore[arg-type]
    with pytest.raises(AssociationError, match="association is NoneType"):
        triangulate(first, second, None, epsilon=0.1, sigma=0.1)  # type: ignore[arg-type]
    with pytest.raises(AssociationError, match="these two scans"):
        triangulate(first, second, Association([[0, 0]], (1, 2)), epsilon=0.1, sigma=0.1)
    for options in ({"epsilon": math.pi}, {"sigma": 0.0}, {"max_range": 0.1}):
        with pytest.raises(OptionError, match=next(iter(options))):
            triangulate(first, second, one, **{"epsilon": 0.1, "sigma": 0.1, **options})
