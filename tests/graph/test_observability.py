"""Equations less unknowns, held against ranks of plain Jacobians; and the names of what is free."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import mht_slam as ms
from mht_slam.arrays import FloatArray, IntArray
from mht_slam.errors import AssociationError, MeasurementError, OptionError, UnobservableError
from mht_slam.graph.build import build_graph, graph_keys, make_values
from mht_slam.graph.free_directions import pose_coordinates, whitened_jacobian
from mht_slam.graph.observability import observability, require_observable
from mht_slam.graph.problem import make_problem

SIGMA = np.deg2rad(1.0)
COMMON_HEADING = ms.ObservationModel(sigma=SIGMA)
FREE_HEADINGS = ms.ObservationModel(sigma=SIGMA, heading_sigma=0.05)
FREE_HEADINGS_AND_SIDES = ms.ObservationModel(sigma=SIGMA, heading_sigma=0.05, lateral_sigma=0.1)
SMOOTH = ms.ObservationModel(sigma=SIGMA, motion="smooth")
FREE_POSES = ms.ObservationModel(sigma=SIGMA, motion="free")

Poses = Callable[[FloatArray, int], FloatArray]
"""(m, 3) poses from raw parameters; the parameters leave gauges to the rank."""


def on_line(p: FloatArray, m: int) -> FloatArray:
    return np.column_stack([p[:m], np.zeros(m), np.zeros(m)])


def on_line_any_heading(p: FloatArray, m: int) -> FloatArray:
    return np.column_stack([p[:m], np.zeros(m), p[m : 2 * m]])


def anywhere(p: FloatArray, m: int) -> FloatArray:
    return p[: 3 * m].reshape(m, 3)


def two_lines(p: FloatArray, m: int) -> FloatArray:
    assert m == 4
    x, y, psi, step = p[2:6]
    fourth = [x + step * np.cos(psi), y + step * np.sin(psi), psi]
    return np.array([[p[0], 0.0, 0.0], [p[1], 0.0, 0.0], [x, y, psi], fourth])


CASES: dict[str, tuple[Poses, int, ms.ObservationModel]] = {
    "common heading": (on_line, 1, COMMON_HEADING),
    "free headings": (on_line_any_heading, 2, FREE_HEADINGS),
    "free headings and sides": (anywhere, 3, FREE_HEADINGS_AND_SIDES),
    "smooth": (anywhere, 3, SMOOTH),
    "free poses": (anywhere, 3, FREE_POSES),
}


def rank_of(poses_of: Poses, per_scan: int, seen: FloatArray, rng: np.random.Generator) -> int:
    """Rank of the bearings' Jacobian by raw parameters, at a generic scene."""
    n, m = seen.shape
    n_poses = 6 if poses_of is two_lines else per_scan * m
    at = rng.uniform(-2.0, 2.0, n_poses + 2 * n)
    rows, columns = np.nonzero(seen)

    def bearings(p: FloatArray) -> FloatArray:
        poses, landmarks = poses_of(p, m), p[n_poses:].reshape(n, 2)
        offset = landmarks[rows] - poses[columns, :2]
        return np.arctan2(offset[:, 1], offset[:, 0]) - poses[columns, 2]

    jacobian = []
    for i in range(len(at)):
        step = np.zeros(len(at))
        step[i] = 1e-6
        difference = bearings(at + step) - bearings(at - step)
        jacobian.append(((difference + np.pi) % (2.0 * np.pi) - np.pi) / 2e-6)
    values = np.linalg.svd(np.array(jacobian))[1]
    return int((values > 1e-6 * values[0]).sum())


def scene(
    landmarks: FloatArray, xs: FloatArray | list[float], seen: FloatArray | None = None
) -> tuple[ms.StraightRun, ms.Association]:
    """A straight run past landmarks, (n, m) of which are seen, and its true association."""
    seen = np.ones((len(landmarks), len(xs)), bool) if seen is None else seen
    scans = []
    table = np.full(seen.shape, -1)
    for k, x in enumerate(xs):
        rows = np.flatnonzero(seen[:, k])
        table[rows, k] = np.arange(len(rows))
        scans.append(ms.BearingScan(np.arctan2(landmarks[rows, 1], landmarks[rows, 0] - x)))
    return ms.StraightRun(scans), ms.Association(table, [len(scan) for scan in scans])


def some_landmarks(n: int, seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.column_stack(
        [rng.uniform(-1.0, 4.0, n), rng.choice([-1, 1], n) * rng.uniform(1, 3, n)]
    )


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(("m", "n"), list(product((3, 4), (1, 3, 6))))
def test_the_redundancy_is_what_the_rank_leaves(case: str, m: int, n: int) -> None:
    poses_of, per_scan, model = CASES[case]
    run, truth = scene(some_landmarks(n, 5), np.arange(m) * 1.1)
    found = observability(run, truth, model)
    rank = rank_of(poses_of, per_scan, np.ones((n, m)), np.random.default_rng(2))
    assert found.n_measurements == m * n
    if found.redundancy_of_bearings >= 0:
        assert rank == found.n_unknowns
    assert m * n - rank >= found.redundancy_of_bearings


@pytest.mark.parametrize(
    ("model", "expected"),
    [(COMMON_HEADING, 2), (FREE_HEADINGS, -1), (FREE_POSES, -2), (SMOOTH, -2)],
)
def test_three_landmarks_in_three_scans_are_the_table_of_the_method(
    model: ms.ObservationModel, expected: int
) -> None:
    run, truth = scene(some_landmarks(3, 1), [0.0, 1.0, 2.0])
    assert observability(run, truth, model).redundancy_of_bearings == expected


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_misses_are_counted_as_the_rank_counts_them(data: st.DataObject) -> None:
    m, n = data.draw(st.integers(3, 5)), data.draw(st.integers(3, 7))
    seen = np.array(
        data.draw(st.lists(st.lists(st.booleans(), min_size=m, max_size=m), min_size=n, max_size=n))
    )
    poses_of, per_scan, model = CASES[data.draw(st.sampled_from(sorted(CASES)))]
    assume(seen.any(axis=1).all())
    run, truth = scene(some_landmarks(n, 3), np.arange(m) * 1.1, seen)
    found = observability(run, truth, model)
    shared = seen[seen.sum(axis=1) >= 2]
    assert found.n_measurements == shared.sum()
    if not len(shared):
        assert found.redundancy == 0
        return
    rank = rank_of(poses_of, per_scan, shared, np.random.default_rng(4))
    # Bearings that leave an unknown alone have more to spare than the count says, never less.
    assert rank <= found.n_unknowns
    assert found.n_measurements - rank >= found.redundancy_of_bearings


def test_two_runs_are_counted_as_the_rank_counts_them() -> None:
    for n in (2, 3, 5):
        landmarks = some_landmarks(n, 7)
        run, truth = scene(landmarks, [0.0, 1.0, 2.0, 3.1])
        pair = ms.RunPair(run.scans[:2], run.scans[2:])
        found = observability(pair, truth, COMMON_HEADING)
        assert found.redundancy_of_bearings == 2 * n - 4
        assert found.redundancy == 2 * n - 3
        assert rank_of(two_lines, 0, np.ones((n, 4)), np.random.default_rng(1)) == found.n_unknowns


def test_a_proper_prior_counts_as_a_measurement() -> None:
    run, truth = scene(some_landmarks(3, 1), [0.0, 1.0, 2.0])
    for model in (COMMON_HEADING, FREE_HEADINGS, FREE_HEADINGS_AND_SIDES, SMOOTH):
        assert observability(run, truth, model).redundancy == 9 - 6
    free = observability(run, truth, FREE_POSES)
    assert (free.redundancy_of_bearings, free.redundancy) == (-2, -1)
    assert free.ranks_by_priors
    assert "priors and sides rank" in free.describe()


@pytest.mark.parametrize("model", [FREE_HEADINGS_AND_SIDES, SMOOTH, "odometry"])
def test_the_information_is_that_of_the_graph(model: ms.ObservationModel | str) -> None:
    landmarks = some_landmarks(4, 2)
    run, truth = scene(landmarks, [0.0, 1.0, 2.2, 3.1])
    poses = np.array([[0.0, 0, 0.03], [1.0, 0, -0.02], [2.2, 0.05, 0.01], [3.1, -0.03, 0.04]])
    if model == "odometry":
        covariance = np.array([[0.02, 0.004, 0.0], [0.004, 0.01, 0.002], [0.0, 0.002, 0.003]])
        steps = np.diff(poses, axis=0)
        scans = [run.scans[0]]
        for scan, pose, step in zip(run.scans[1:], poses, steps, strict=False):
            c, s = np.cos(pose[2]), np.sin(pose[2])
            dx, dy = c * step[0] + s * step[1], -s * step[0] + c * step[1]
            scans.append(
                ms.BearingScan(scan.bearings, odometry=ms.Odometry(dx, dy, step[2], covariance))
            )
        run = ms.StraightRun(scans)
        model = ms.ObservationModel(sigma=SIGMA, motion="odometry")
    assert isinstance(model, ms.ObservationModel)
    # Bearings so vague that the soft gauge of the graph does not matter beside them.
    model = ms.ObservationModel(**{**model.to_dict(), "sigma": 0.1})
    problem = make_problem(run, (0, 1, 2, 3), model)
    table: IntArray = truth.table
    values = make_values(graph_keys(len(poses), len(landmarks)), poses, landmarks)

    def log_determinant(rows: IntArray) -> float:
        hessian = build_graph(problem, rows, poses).linearize(values).hessian()[0]
        return float(np.linalg.slogdet(hessian)[1])

    jacobian = whitened_jacobian(
        problem, table, poses, landmarks, pose_coordinates(problem, poses, range(4))
    )
    ours = np.linalg.slogdet(np.eye(jacobian.shape[1]) + jacobian.T @ jacobian)[1]
    expected = log_determinant(table) - log_determinant(np.full_like(table, -1))
    assert ours == pytest.approx(expected, abs=0.02)


def test_what_is_well_seen_is_not_free() -> None:
    run, truth = scene(some_landmarks(4, 2), [0.0, 1.0, 2.2])
    for model in (COMMON_HEADING, ms.ObservationModel(sigma=SIGMA, bearing_dof=3.0)):
        assert observability(run, truth, model).free_directions == ()


def test_landmarks_on_the_line_of_motion_leave_distances_and_the_step_free() -> None:
    run, truth = scene(np.array([[5.0, 0.0], [8.0, 0.0], [-4.0, 0.0]]), [0.0, 1.0, 2.0])
    free = set(observability(run, truth, COMMON_HEADING).free_directions)
    assert free == {"step from scan 1 to scan 2", *(f"distance of landmark {i}" for i in range(3))}


def test_a_far_landmark_leaves_its_distance_free() -> None:
    landmarks = np.array([[1.0, 2.0], [2.0, -1.5], [1e4, 1e4]])
    run, truth = scene(landmarks, [0.0, 1.0, 2.2])
    assert observability(run, truth, COMMON_HEADING).free_directions == ("distance of landmark 2",)


def test_a_landmark_seen_once_leaves_its_distance_free() -> None:
    seen = np.array([[1, 1, 1], [1, 1, 1], [0, 1, 0]], bool)
    run, truth = scene(some_landmarks(3, 4), [0.0, 1.0, 2.2], seen)
    found = observability(run, truth, COMMON_HEADING)
    assert found.free_directions == ("distance of landmark 2",)
    assert found.n_measurements == 6


def test_a_scan_that_sees_nothing_leaves_its_step_and_heading_free() -> None:
    seen = np.ones((4, 4), bool)
    seen[:, 3] = False
    run, truth = scene(some_landmarks(4, 2), [0.0, 1.0, 2.2, 3.0], seen)
    assert observability(run, truth, COMMON_HEADING).free_directions == (
        "step from scan 2 to scan 3",
    )
    free = observability(run, truth, FREE_HEADINGS).free_directions
    assert {"step from scan 2 to scan 3", "heading of scan 3"} <= set(free)


def test_a_first_scan_that_sees_nothing_leaves_the_scale_of_the_rest_free() -> None:
    seen = np.ones((4, 4), bool)
    seen[:, 0] = False
    run, truth = scene(some_landmarks(4, 2), [0.0, 1.0, 2.2, 3.0], seen)
    assert observability(run, truth, COMMON_HEADING).free_directions == (
        "scale after the first step",
    )


def test_tight_headings_are_decided_together_by_their_prior() -> None:
    run, truth = scene(some_landmarks(5, 2), [0.0, 1.0, 2.2])
    tight = ms.ObservationModel(sigma=np.deg2rad(3.0), heading_sigma=np.deg2rad(0.1))
    free = observability(run, truth, tight).free_directions
    assert free[0] == "common heading"
    assert len(free) == 3


def test_a_standstill_leaves_its_step_free() -> None:
    run, truth = scene(some_landmarks(4, 2), [0.0, 1.0, 1.0])
    vague = ms.ObservationModel(sigma=np.deg2rad(3.0))
    assert observability(run, truth, vague).free_directions == ("step from scan 1 to scan 2",)


def test_a_robot_that_never_moves_leaves_all_distances_and_steps_free() -> None:
    run, truth = scene(some_landmarks(4, 2), [0.0, 0.0, 0.0])
    free = set(observability(run, truth, COMMON_HEADING).free_directions)
    assert free == {"step from scan 1 to scan 2", *(f"distance of landmark {i}" for i in range(4))}


@pytest.mark.parametrize("sigma", [1e-4, 0.01, 0.1])
@pytest.mark.parametrize("landmark_sigma", [3.0, 300.0])
def test_exactly_parallel_bearings_are_as_precise_as_the_prior(
    sigma: float, landmark_sigma: float
) -> None:
    run, truth = scene(np.array([[1.0, 2.0], [2.0, -1.5], [1e9, 1e9]]), [0.0, 1.0, 2.2])
    model = ms.ObservationModel(sigma=sigma, landmark_sigma=landmark_sigma)
    assert observability(run, truth, model).free_directions == ("distance of landmark 2",)


def test_a_single_landmark_leaves_headings_to_their_prior() -> None:
    run, truth = scene(np.array([[1.0, 2.0]]), [0.0, 1.0, 2.0])
    found = observability(run, truth, FREE_HEADINGS)
    assert found.redundancy_of_bearings == 3 - 2 - 1 - 3
    assert found.redundancy == 1
    # Three bearings can determine three of the six unknowns at most.
    assert len(found.free_directions) >= 3


def test_a_place_beyond_the_squares_of_floats_is_linearised_without_overflow() -> None:
    """A single bearing of 1e-181 in the second run lies 1e180 baselines away from the first."""
    scans = [[], [0.7, 0.0], [], [9.78335057e-182]]
    pair = ms.RunPair(
        [ms.BearingScan(b, sigma=1000.0) for b in scans[:2]],
        [ms.BearingScan(b, sigma=1000.0) for b in scans[2:]],
    )
    association = ms.Association([[-1, 0, -1, 0], [-1, 1, -1, -1]], (0, 2, 0, 1))
    found = observability(pair, association, ms.ObservationModel(sigma=0.02, heading_sigma=0.0))
    assert "distance of landmark 0" in found.free_directions


def test_names_say_scans_of_the_run() -> None:
    seen = np.ones((4, 5), bool)
    seen[:, 4] = False
    run, truth = scene(some_landmarks(4, 2), [0.0, 0.4, 1.0, 2.2, 3.0], seen)
    part = truth.restrict([0, 2, 3, 4])
    found = observability(run, part, COMMON_HEADING, scans=(0, 2, 3, 4))
    assert found.free_directions == ("step from scan 3 to scan 4",)


def test_only_associations_that_nothing_can_contradict_are_refused() -> None:
    run, truth = scene(some_landmarks(3, 1), [0.0, 1.0, 2.0])
    counts = run.n_detections
    pairs = [
        ms.Association([[0, 0, -1], [1, 1, -1], [2, 2, -1]], counts),
        ms.Association([[0, 1, -1], [1, 0, -1], [2, 2, -1]], counts),
    ]
    with pytest.raises(UnobservableError, match=r"2 associations apart.*6 bearings"):
        require_observable(run, pairs, COMMON_HEADING)
    require_observable(run, pairs[:1], COMMON_HEADING)
    require_observable(run, [*pairs, truth], COMMON_HEADING)
    require_observable(run, [], COMMON_HEADING)


def test_free_poses_are_refused_where_three_landmarks_fit_everything() -> None:
    run, truth = scene(some_landmarks(3, 1), [0.0, 1.0, 2.0])
    swapped = ms.Association([[0, 1, 0], [1, 0, 1], [2, 2, 2]], run.n_detections)
    with pytest.raises(UnobservableError):
        require_observable(run, [truth, swapped], FREE_POSES)
    require_observable(run, [truth, swapped], SMOOTH)


def test_wrong_arguments_are_named() -> None:
    run, truth = scene(some_landmarks(3, 1), [0.0, 1.0, 2.0])
    pair = ms.RunPair(run.scans[:2], run.scans[:2])
    with pytest.raises(OptionError, match="run is list"):
        observability([], truth, COMMON_HEADING)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="model is None"):
        observability(run, truth, None)  # type: ignore[arg-type]
    with pytest.raises(OptionError, match="used whole"):
        observability(pair, truth, COMMON_HEADING, scans=(0, 1, 2))
    with pytest.raises(AssociationError, match="give an Association over"):
        observability(run, truth.restrict([0, 1]), COMMON_HEADING)
    with pytest.raises(MeasurementError, match="scan 7"):
        observability(run, truth, COMMON_HEADING, scans=(0, 1, 7))
