"""Remapping: landmarks drawn anew from all scans at once, given no more than the trajectory."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.incremental.associate import CERTAIN
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.sightings import Place
from mht_slam.measurements import wrap_angle

APART = 4
"""Scans between the two sightings that a track starts from, at most."""
REACH = 10
"""Scans before the first of them and after the second in which a track is looked for."""
LEAST = 3.0
"""Nats for which a track is worth a landmark."""
SEEN = 3
"""Detections of a track, at least: any two bearings meet."""
CROSSING = 0.01
"""Sine of the angle at which the two bearings meet, at least."""
NEAREST = 0.05
"""Range at which they meet, in steps of the robot, at least."""
ROUNDS = 3
"""Times that a track is looked for, its place triangulated anew in between."""
TURN = 2.0
"""Drift of the heading from scan to scan, in deviations of a bearing."""
SHARE = 0.03
"""Drift of the place from scan to scan, as a share of a step."""
CELLS = 2_000_000
"""Places times scans times detections compared at once: what bounds the memory."""


@dataclass(frozen=True)
class Track:
    """Detections that together look like one landmark.

    Attributes
    ----------
    log_odds : nats for it, against detections of others that happen to lie there.
    point : (x, y).
    places : scans and detections, in order.
    """

    log_odds: float
    point: tuple[float, float]
    places: tuple[Place, ...]


@dataclass(frozen=True, eq=False)
class Support:
    """What p places are seen by in s scans: see `support`; arrays (p, s) but `log_odds`, (p,)."""

    log_odds: FloatArray
    nearest: IntArray
    used: BoolArray
    variances: FloatArray


@dataclass(frozen=True, eq=False)
class Panorama:
    """Scans side by side.

    Attributes
    ----------
    poses : (m, 3).
    bearings, sigmas : (m, d), nan where a scan has fewer detections.
    log_density : (m,) detections per radian.
    chance : of detection.
    turn, side : how heading (radians) and place drift from one scan to the next.
    """

    poses: FloatArray
    bearings: FloatArray
    sigmas: FloatArray
    log_density: FloatArray
    chance: float
    turn: float
    side: float


def find_tracks(
    poses: FloatArray,
    bearings: Sequence[FloatArray],
    sigmas: Sequence[FloatArray],
    config: SlamConfig,
    slack: float = 1.0,
) -> list[Track]:
    """Return tracks over a few scans, the likeliest first; they compete for detections.

    Any two bearings of scans at most `APART` apart that meet are a place. A scan k in which the
    nearest detection is off by e is worth

        max( ln P_D + ln N(e; 0, s_k^2) - ln rho_k,  ln (1 - P_D) )

    nats, rho_k its detections per radian and s_k^2 = sigma^2 + (turn^2 + side^2 / range^2) g_k, for
    g_k scans from the nearer of the two, what poses drift apart: `TURN` deviations of a bearing and
    `SHARE` of a step per scan, times `slack`. A track goes over the scans about the two that are
    worth most together. Its place is triangulated anew from them, and they are looked for again.

    Parameters
    ----------
    poses : (m, 3).
    bearings, sigmas : of each scan.

    Source: docs/incremental.md.
    """
    panorama = _side_by_side(poses, bearings, sigmas, config, slack)
    found: dict[tuple[Place, ...], Track] = {}
    for first in range(len(poses)):
        for second in range(first + 1, min(first + APART + 1, len(poses))):
            scans = np.arange(max(first - REACH, 0), min(second + REACH + 1, len(poses)))
            points = _meetings(
                panorama, first, second, 4.0 * config.observation_model.landmark_sigma
            )
            most = max(CELLS // max(len(scans) * panorama.bearings.shape[1], 1), 1)
            for start in range(0, len(points), most):
                part = points[start : start + most]
                for track in _tracks(panorama, part, scans, first, second):
                    old = found.get(track.places)
                    if old is None or track.log_odds > old.log_odds:
                        found[track.places] = track
    return sorted(found.values(), key=lambda track: (-track.log_odds, track.places))


def disjoint(tracks: Sequence[Track]) -> list[Track]:
    """Return the tracks that share no detection with one before them."""
    taken: set[Place] = set()
    chosen = []
    for track in tracks:
        if taken.isdisjoint(track.places):
            chosen.append(track)
            taken.update(track.places)
    return chosen


def owners_of(tracks: Sequence[Track], counts: Sequence[int], first: int) -> list[IntArray]:
    """Return the landmark of each detection: tracks are numbered on from `first`, -1 for none."""
    owners = [np.full(count, MISSED, np.int64) for count in counts]
    for number, track in enumerate(tracks, first):
        for scan, detection in track.places:
            owners[scan][detection] = number
    return owners


def support(
    panorama: Panorama, points: FloatArray, scans: IntArray, first: int, second: int
) -> Support:
    """Return which detections of which scans see each place, and the nats that these are worth.

    Scans about `first` and `second`, without gaps: on either side up to where the sum is largest.
    """
    away = points[:, None] - panorama.poses[None, scans, :2]
    squared = np.maximum((away**2).sum(axis=2), panorama.side**2 + 1e-12)
    expected = np.arctan2(away[..., 1], away[..., 0]) - panorama.poses[None, scans, 2]
    off = np.abs(wrap_angle(expected[..., None] - panorama.bearings[None, scans]))
    off = np.where(np.isnan(off), math.inf, off)
    nearest = off.argmin(axis=2)
    off = np.take_along_axis(off, nearest[..., None], axis=2)[..., 0]
    apart = np.minimum(np.abs(scans - first), np.abs(scans - second))
    drift = (panorama.turn**2 + panorama.side**2 / squared) * np.maximum(apart, 0.5)
    sigmas = np.nan_to_num(panorama.sigmas[scans, nearest], nan=1.0)  # of scans without detections
    variances = sigmas**2 + drift
    worth = math.log(panorama.chance) - 0.5 * off**2 / variances
    worth -= 0.5 * np.log(2.0 * math.pi * variances) + panorama.log_density[scans]
    missed = math.log1p(-panorama.chance)
    hit, gains = worth > missed, np.maximum(worth, missed)
    a, b = first - int(scans[0]), second - int(scans[0])
    none = np.zeros((len(points), 1))
    before = np.concatenate([none, np.cumsum(gains[:, :a][:, ::-1], axis=1)], axis=1)
    after = np.concatenate([none, np.cumsum(gains[:, b + 1 :], axis=1)], axis=1)
    at = np.arange(len(scans))
    used = hit & (at >= a - before.argmax(axis=1)[:, None])
    used &= at <= b + after.argmax(axis=1)[:, None]
    log_odds = gains[:, a : b + 1].sum(axis=1) + before.max(axis=1) + after.max(axis=1)
    return Support(log_odds, nearest, used, variances)


def _side_by_side(
    poses: FloatArray,
    bearings: Sequence[FloatArray],
    sigmas: Sequence[FloatArray],
    config: SlamConfig,
    slack: float,
) -> Panorama:
    model = config.observation_model
    most = max((len(z) for z in bearings), default=0)
    padded = np.full((2, len(bearings), most), math.nan)
    for k, (z, sigma) in enumerate(zip(bearings, sigmas, strict=True)):
        padded[:, k, : len(z)] = z, sigma
    counts = np.array([max(len(z), 1) for z in bearings])
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    assert model.detection_probability is not None  # noqa: S101 - checked by the configuration
    return Panorama(
        poses=poses,
        bearings=padded[0],
        sigmas=padded[1],
        log_density=np.log(counts / model.field_of_view),
        chance=min(model.detection_probability, CERTAIN),
        turn=slack * TURN * model.sigma,
        side=slack * SHARE * float(steps.mean() if len(steps) else 0.0),
    )


def _meetings(panorama: Panorama, first: int, second: int, farthest: float) -> FloatArray:
    """(p, 2) where the bearings of two scans meet, ahead of both."""
    poses, z = panorama.poses, panorama.bearings
    offset = poses[second, :2] - poses[first, :2]
    nearest = NEAREST * math.hypot(*offset)
    u, v = (
        np.stack([np.cos(angle), np.sin(angle)], axis=1)
        for angle in (z[k][~np.isnan(z[k])] + poses[k, 2] for k in (first, second))
    )
    sine = u[:, None, 0] * v[None, :, 1] - u[:, None, 1] * v[None, :, 0]
    i, j = np.nonzero(np.abs(sine) > CROSSING)
    ranges = (offset[0] * v[j, 1] - offset[1] * v[j, 0]) / sine[i, j]
    others = (offset[0] * u[i, 1] - offset[1] * u[i, 0]) / sine[i, j]
    ahead = (ranges > nearest) & (others > nearest) & (ranges < farthest)
    return np.asarray(poses[first, :2] + ranges[ahead, None] * u[i[ahead]])


def _tracks(
    panorama: Panorama, points: FloatArray, scans: IntArray, first: int, second: int
) -> Iterator[Track]:
    for round_ in range(ROUNDS):
        if not len(points):
            return
        seen = support(panorama, points, scans, first, second)
        good = (seen.log_odds > LEAST) & (seen.used.sum(axis=1) >= SEEN)
        for i in np.flatnonzero(good).tolist():
            at = np.flatnonzero(seen.used[i])
            places = tuple(zip(scans[at].tolist(), seen.nearest[i, at].tolist(), strict=True))
            x, y = points[i].tolist()
            yield Track(float(seen.log_odds[i]), (x, y), places)
        if round_ < ROUNDS - 1:
            points = _triangulated(panorama, points, scans, seen)[good]


def _triangulated(
    panorama: Panorama, points: FloatArray, scans: IntArray, seen: Support
) -> FloatArray:
    """(p, 2) least squares of the distances from the bearing lines, weighted by range."""
    poses = panorama.poses[scans]
    angles = np.where(seen.used, panorama.bearings[scans, seen.nearest], 0.0) + poses[:, 2]
    normals = np.stack([-np.sin(angles), np.cos(angles)], axis=2)
    squared = ((points[:, None] - poses[None, :, :2]) ** 2).sum(axis=2)
    weights = seen.used / (np.maximum(squared, 1e-12) * seen.variances)
    offsets = (normals * poses[None, :, :2]).sum(axis=2)
    information = np.einsum("ps,psi,psj->pij", weights, normals, normals)
    spread = np.trace(information, axis1=1, axis2=2)[:, None, None]
    information += np.where(spread > 0.0, 1e-9 * spread, 1.0) * np.eye(2)
    right = np.einsum("ps,psi->pi", weights * offsets, normals)
    return np.asarray(np.linalg.solve(information, right[..., None])[..., 0])
