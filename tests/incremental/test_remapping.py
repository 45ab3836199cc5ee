"""Landmarks drawn anew: what a place is worth by hand, and yards that are found whole."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.remapping import (
    LEAST,
    SEEN,
    Panorama,
    Track,
    disjoint,
    find_tracks,
    owners_of,
    support,
)

from .rows import CONFIG, SIGMA, Row

TURN, SIDE, CHANCE = 0.02, 0.05, 0.9


def random_panorama(rng: np.random.Generator, n_scans: int, most: int) -> Panorama:
    bearings = rng.uniform(-4.0, 4.0, (n_scans, most))
    for z in bearings:
        z[rng.integers(0, most + 1) :] = math.nan
    return Panorama(
        poses=rng.normal(size=(n_scans, 3)),
        bearings=bearings,
        sigmas=np.where(np.isnan(bearings), math.nan, rng.uniform(0.1, 0.5, bearings.shape)),
        log_density=rng.normal(size=n_scans),
        chance=CHANCE,
        turn=TURN,
        side=SIDE,
    )


def worth_by_hand(
    panorama: Panorama, point: FloatArray, k: int, scans_away: int
) -> tuple[float, int | None, float]:
    """Nats of one scan, its detection if one is used, and the nearest detection's variance."""
    x, y, theta = panorama.poses[k]
    dx, dy = point[0] - x, point[1] - y
    best, nearest, of = math.inf, None, math.nan
    for j, bearing in enumerate(panorama.bearings[k]):
        turn = math.atan2(dy, dx) - theta - bearing
        off = abs(math.atan2(math.sin(turn), math.cos(turn)))
        if off < best:  # false for nan
            best, nearest = off, j
    missed = math.log(1.0 - CHANCE)
    if nearest is None:
        return missed, None, of
    of = panorama.sigmas[k, nearest] ** 2
    of += (TURN**2 + SIDE**2 / (dx**2 + dy**2)) * max(scans_away, 0.5)
    seen = math.log(CHANCE) - 0.5 * best**2 / of - 0.5 * math.log(2.0 * math.pi * of)
    seen -= panorama.log_density[k]
    return (seen, nearest, of) if seen > missed else (missed, None, of)


def support_by_hand(
    panorama: Panorama, point: FloatArray, scans: Sequence[int], first: int, second: int
) -> tuple[float, dict[int, int]]:
    """Try every run of scans that contains the two."""
    worth = {
        k: worth_by_hand(panorama, point, k, min(abs(k - first), abs(k - second))) for k in scans
    }
    best, places = -math.inf, {}
    for start in range(scans[0], first + 1):
        for end in range(second, scans[-1] + 1):
            total = sum(worth[k][0] for k in range(start, end + 1))
            if total > best:
                best = total
                places = {
                    k: j for k in range(start, end + 1) if (j := worth[k][1]) is not None
                }  # fmt: skip
    return best, places


@given(
    seed=st.integers(0, 2**32 - 1),
    n_scans=st.integers(2, 9),
    most=st.integers(1, 6),
    data=st.data(),
)
def test_support_is_that_of_the_best_run_of_scans(
    seed: int, n_scans: int, most: int, data: st.DataObject
) -> None:
    rng = np.random.default_rng(seed)
    panorama, points = random_panorama(rng, n_scans, most), 3.0 * rng.normal(size=(4, 2))
    first = data.draw(st.integers(0, n_scans - 2))
    second = data.draw(st.integers(first + 1, n_scans - 1))
    start = data.draw(st.integers(0, first))
    scans = np.arange(start, data.draw(st.integers(second, n_scans - 1)) + 1)
    found = support(panorama, points, scans, first, second)
    for i, point in enumerate(points):
        log_odds, places = support_by_hand(panorama, point, scans.tolist(), first, second)
        assert math.isclose(found.log_odds[i], log_odds, rel_tol=1e-9, abs_tol=1e-9)
        used = np.flatnonzero(found.used[i])
        assert (
            dict(zip(scans[used].tolist(), found.nearest[i, used].tolist(), strict=True)) == places
        )


def yard(seed: int, n_landmarks: int = 15, n_scans: int = 20) -> tuple[FloatArray, FloatArray]:
    """A round of poses, and landmarks about it that keep some distance from each other."""
    rng = np.random.default_rng(seed)
    angles = np.linspace(0.0, 1.5 * math.pi, n_scans)
    poses = np.column_stack([5.0 * np.cos(angles), 5.0 * np.sin(angles), angles + math.pi / 2])
    landmarks: list[FloatArray] = []
    while len(landmarks) < n_landmarks:
        landmark = rng.uniform(-9.0, 9.0, 2)
        apart = [*landmarks, *poses[:, :2]]
        if min(math.dist(landmark, other) for other in apart) > 1.0:
            landmarks.append(landmark)
    return poses, np.array(landmarks)


def seen_from(
    poses: FloatArray, landmarks: FloatArray, rng: np.random.Generator
) -> tuple[list[FloatArray], list[IntArray]]:
    """Bearings without noise in random order, and whose they are."""
    labels = [rng.permutation(len(landmarks)) for _ in poses]
    away = [landmarks[owner] - pose[:2] for pose, owner in zip(poses, labels, strict=True)]
    return [
        np.arctan2(a[:, 1], a[:, 0]) - pose[2] for pose, a in zip(poses, away, strict=True)
    ], labels


@pytest.mark.parametrize("seed", range(3))
def test_a_yard_is_drawn_whole_from_its_poses(seed: int) -> None:
    """Each true landmark is one track, over all scans that the reach holds, in its place."""
    poses, landmarks = yard(seed)
    bearings, labels = seen_from(poses, landmarks, np.random.default_rng(seed))
    tracks = disjoint(
        find_tracks(poses, bearings, [np.full(len(z), SIGMA) for z in bearings], CONFIG, 0.25)
    )
    assert all(
        len({int(labels[scan][detection]) for scan, detection in track.places}) == 1
        for track in tracks
    )
    whole = {
        int(labels[track.places[0][0]][track.places[0][1]]): track
        for track in tracks
        if len(track.places) >= len(poses) - 1
    }
    assert sorted(whole) == list(range(len(landmarks)))
    for landmark, track in whole.items():
        assert math.dist(track.point, landmarks[landmark]) < 0.05


def test_tracks_do_not_depend_on_the_frame() -> None:
    row = Row(None, range(0))
    here = find_tracks(row.poses, row.bearings, row.sigmas, CONFIG)
    turn = np.array([[math.cos(2.0), math.sin(2.0)], [-math.sin(2.0), math.cos(2.0)]])
    moved = np.column_stack([row.poses[:, :2] @ turn + [30.0, -7.0], row.poses[:, 2] + 2.0])
    there = find_tracks(moved, row.bearings, row.sigmas, CONFIG)
    assert {t.places for t in here} == {t.places for t in there}
    by_places = {t.places: t for t in there}
    for track in here:
        other = by_places[track.places]
        assert math.isclose(track.log_odds, other.log_odds, rel_tol=1e-6)
        assert np.allclose(np.array(track.point) @ turn + [30.0, -7.0], other.point, atol=1e-6)


def test_tracks_are_sorted_worth_a_landmark_and_seen_often_enough() -> None:
    row = Row(None, range(0))
    tracks = find_tracks(row.poses, row.bearings, row.sigmas, CONFIG)
    odds = [track.log_odds for track in tracks]
    assert odds == sorted(odds, reverse=True)
    assert min(odds) > LEAST
    for track in tracks:
        scans = [scan for scan, _ in track.places]
        assert len(scans) >= SEEN
        assert scans == sorted(set(scans)), "one detection of a scan at most"


@pytest.mark.parametrize("counts", [[], [0], [3], [0, 0, 0], [0, 2, 0, 2], [1, 1]])
def test_few_scans_or_detections_have_no_tracks(counts: Sequence[int]) -> None:
    rng = np.random.default_rng(0)
    poses = np.column_stack([np.arange(len(counts)), np.zeros((len(counts), 2))]).astype(float)
    bearings = [rng.uniform(-3.0, 3.0, n) for n in counts]
    sigmas = [np.full(n, SIGMA) for n in counts]
    assert find_tracks(poses.reshape(-1, 3), bearings, sigmas, CONFIG) == []


def test_a_robot_that_stands_still_draws_nothing() -> None:
    poses, bearings = np.zeros((5, 3)), [np.array([0.1, 1.0, 2.0])] * 5
    assert find_tracks(poses, bearings, [np.full(3, SIGMA)] * 5, CONFIG) == []


def test_a_sure_detector_may_still_miss() -> None:
    """P_D = 1 must not make a scan that misses infinitely unlikely."""
    row = Row(None, range(0))
    row.bearings[5] = row.bearings[5][1:]
    config = SlamConfig(model=replace(CONFIG.model, detection_probability=1.0), motion="odometry")
    tracks = find_tracks(row.poses, row.bearings, row.sigmas, config)
    assert tracks
    assert all(math.isfinite(track.log_odds) for track in tracks)


def test_a_detection_has_one_owner_the_likeliest_first() -> None:
    first, rival, other = (
        Track(odds, (0.0, 0.0), places)
        for odds, places in [
            (9.0, ((0, 1), (1, 0), (2, 2))),
            (8.0, ((0, 0), (1, 0), (2, 1))),
            (7.0, ((0, 0), (1, 1), (2, 0))),
        ]
    )
    chosen = disjoint([first, rival, other])
    assert chosen == [first, other]
    owners = owners_of(chosen, [2, 2, 3, 1], 40)
    assert [owner.tolist() for owner in owners] == [[41, 40], [40, 41], [41, -1, 40], [-1]]
