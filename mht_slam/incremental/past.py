"""The committed past that all branches share: one Gaussian over two poses and the settled map."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.incremental.motion_terms import SHORTEST, motion_terms, wrapped

GAUGE = 1e-4
"""Deviation of the first pose, which carries the frame: lengths and radians."""
WIDE_DIRECTION, WIDE_LOG_RANGE = 0.5, 1.0
"""Deviations of a new landmark about its smoothed estimate before its first bearing is taken in."""
ANYWHERE = 1e6
"""Deviation of a pose of which nothing is known."""
JITTER = 1e-12
"""Least share of a variance that nothing else explains."""
FAR_CENTRE = 1e4
"""How far behind a well-known landmark its centre lies."""


@dataclass(frozen=True, eq=False)
class Committed:
    """Gaussian over the two newest committed poses and all settled landmarks.

    Each landmark is kept as direction and log range from a centre that never moves, so that the
    Gaussian fits along the bearing (`mht_slam.incremental.smoother`).

    Attributes
    ----------
    mean : (6 + 2 n,) two poses x, y, theta, older one first; landmarks phi, rho.
    covariance : its square.
    ids : (n,) numbers of the landmarks, in the order in which they were settled.
    centres : (n, 2).
    visible : (n,) chance that a landmark out of the window is in view.
    first_seen, last_seen : (n,) committed scans: the one that settled it, the last that saw it.
    sightings : (n,) how many committed scans saw it.
    """

    mean: FloatArray
    covariance: FloatArray
    ids: IntArray
    centres: FloatArray
    visible: FloatArray
    first_seen: IntArray
    last_seen: IntArray
    sightings: IntArray

    @property
    def places(self) -> FloatArray:
        """(n, 2) directions and log ranges of the landmarks."""
        return self.mean[6:].reshape(-1, 2)

    @property
    def points(self) -> FloatArray:
        """(n, 2) landmarks."""
        return points_of(self.places, self.centres)

    def deviations_from_robot(self) -> FloatArray:
        """(n,) greatest deviation of each landmark's place in the frame of the newest pose."""
        n = len(self.ids)
        away = self.points - self.mean[3:5]
        jacobian = np.zeros((n, 2, 5))
        jacobian[:, :, :2] = point_jacobians(self.places)
        jacobian[:, 0, 2] = jacobian[:, 1, 3] = -1.0
        # Turning the robot turns what it sees the other way; the frame's axes do not matter here.
        jacobian[:, 0, 4], jacobian[:, 1, 4] = away[:, 1], -away[:, 0]
        at = np.concatenate(
            [6 + 2 * np.arange(n)[:, None] + np.arange(2), np.tile([3, 4, 5], (n, 1))], axis=1
        )
        joint = self.covariance[at[:, :, None], at[:, None, :]]
        relative = jacobian @ joint @ jacobian.transpose(0, 2, 1)
        half, product = 0.5 * np.trace(relative, axis1=1, axis2=2), np.linalg.det(relative)
        return np.asarray(np.sqrt(half + np.sqrt(np.maximum(half**2 - product, 0.0))))

    def marginal(self, chosen: IntArray) -> tuple[FloatArray, FloatArray]:
        """Mean and information of the poses and the landmarks at these indices."""
        at = np.concatenate([np.arange(6), (6 + 2 * chosen[:, None] + np.arange(2)).ravel()])
        covariance = self.covariance[np.ix_(at, at)]
        # Rounding may leave nothing of what is surer than doubles can hold.
        deviations = np.sqrt(np.maximum(np.diag(covariance), SHORTEST**2))
        scale = deviations[:, None] * deviations
        # Poses far off that hang together by a sure step are one pose, as far as doubles can tell.
        information = np.linalg.inv(covariance / scale + JITTER * np.eye(len(at))) / scale
        return self.mean[at], 0.5 * (information + information.T)


@dataclass(frozen=True, eq=False)
class Sighted:
    """Bearings of the scan to commit, with the estimates at which they are linearised.

    `ids`, `bearings`, `sigmas` (m,); `places` and `centres` (m, 2) of the landmarks.
    """

    ids: IntArray
    bearings: FloatArray
    sigmas: FloatArray
    places: FloatArray
    centres: FloatArray


def nothing_committed() -> Committed:
    """Return the past before the first scan: two made-up poses a unit apart, before the origin."""
    return Committed(
        mean=np.array([-2.0, 0.0, 0.0, -1.0, 0.0, 0.0]),
        covariance=np.eye(6) * GAUGE**2,
        ids=np.empty(0, np.int64),
        centres=np.empty((0, 2)),
        visible=np.empty(0),
        first_seen=np.empty(0, np.int64),
        last_seen=np.empty(0, np.int64),
        sightings=np.empty(0, np.int64),
    )


def points_of(places: FloatArray, centres: FloatArray) -> FloatArray:
    """(n, 2) points from directions and log ranges about centres."""
    reach = np.exp(places[:, 1])
    arm = np.stack([reach * np.cos(places[:, 0]), reach * np.sin(places[:, 0])], axis=1)
    return np.asarray(centres + arm)


def places_of(points: FloatArray, centres: FloatArray) -> FloatArray:
    """(n, 2) directions and log ranges of points about centres."""
    arm = points - centres
    # A landmark may come so near its centre that doubles do not tell them apart.
    reach = np.maximum(np.hypot(arm[:, 0], arm[:, 1]), SHORTEST)
    return np.stack([np.arctan2(arm[:, 1], arm[:, 0]), np.log(reach)], 1)


def point_jacobians(places: FloatArray) -> FloatArray:
    """(n, 2, 2) derivatives of points by direction and log range."""
    reach = np.exp(places[:, 1])
    x, y = reach * np.cos(places[:, 0]), reach * np.sin(places[:, 0])
    return np.stack([np.stack([-y, x], axis=1), np.stack([x, y], axis=1)], axis=1)


def recentred(past: Committed, certain: float) -> Committed:
    """Move the centres of landmarks far away whose log range is known to `certain`.

    About a centre that is far behind a landmark, direction and log range are Cartesian coordinates
    up to scale: what corrects the map from then on moves the landmark along straight lines.
    """
    deviations = np.sqrt(np.diag(past.covariance)[7::2])
    reach = np.exp(past.places[:, 1])
    chosen = np.flatnonzero((deviations < certain) & (reach < 0.5 * FAR_CENTRE))
    if not len(chosen):
        return past
    points = past.points[chosen]
    centres = past.centres.copy()
    centres[chosen] = points - np.array([FAR_CENTRE, 0.0])
    places = past.places.copy()
    old = point_jacobians(places[chosen])
    places[chosen] = places_of(points, centres[chosen])
    change = np.linalg.solve(point_jacobians(places[chosen]), old)
    covariance = past.covariance.copy()
    for block, i in zip(change, chosen.tolist(), strict=True):
        at = slice(6 + 2 * i, 8 + 2 * i)
        covariance[at] = block @ covariance[at]
        covariance[:, at] = covariance[:, at] @ block.T
    return replace(
        past,
        mean=np.concatenate([past.mean[:6], places.ravel()]),
        covariance=covariance,
        centres=centres,
    )


def merged(past: Committed, new: IntArray, old: IntArray, sigma: float) -> Committed:
    """Take the landmarks at indices `new` to be those at `old`, up to `sigma`, and drop them.

    A Kalman update with the measurement that both are in one place.
    """
    points, jacobians = past.points, point_jacobians(past.places)
    p, size = len(new), len(past.mean)
    rows = np.zeros((2 * p, size))
    for k, (i, j) in enumerate(zip(new.tolist(), old.tolist(), strict=True)):
        rows[2 * k : 2 * k + 2, 6 + 2 * i : 8 + 2 * i] = jacobians[i]
        rows[2 * k : 2 * k + 2, 6 + 2 * j : 8 + 2 * j] = -jacobians[j]
    off = (points[old] - points[new]).ravel()
    cross = past.covariance @ rows.T
    total = rows @ cross + sigma**2 * np.eye(2 * p)
    gain = np.linalg.solve(total, cross.T).T
    mean = past.mean + gain @ off
    covariance = past.covariance - gain @ cross.T
    covariance = 0.5 * (covariance + covariance.T)
    last_seen, visible = past.last_seen.copy(), past.visible.copy()
    last_seen[old] = np.maximum(last_seen[old], last_seen[new])
    visible[old] = visible[new]
    sightings = past.sightings.copy()
    sightings[old] += sightings[new]
    together = replace(
        past,
        mean=mean,
        covariance=covariance,
        last_seen=last_seen,
        visible=visible,
        sightings=sightings,
    )
    return without(together, new)


def without(past: Committed, gone: IntArray) -> Committed:
    """Let go of the landmarks at these indices; what they taught about the others stays."""
    kept = np.ones(len(past.ids), np.bool_)
    kept[gone] = False
    at = np.concatenate([np.ones(6, np.bool_), np.repeat(kept, 2)])
    return Committed(
        mean=past.mean[at],
        covariance=past.covariance[np.ix_(at, at)],
        ids=past.ids[kept],
        centres=past.centres[kept],
        visible=past.visible[kept],
        first_seen=past.first_seen[kept],
        last_seen=past.last_seen[kept],
        sightings=past.sightings[kept],
    )


def commit(
    past: Committed,
    kind: int,
    parameters: FloatArray,
    poses: FloatArray,
    sighted: Sighted,
    dof: float,
    scan: int,
) -> Committed:
    """Take the oldest scan of the window into the past.

    One step of an extended Kalman filter, linearised at estimates that the whole window has
    smoothed: (3, 3) `poses`, the two committed ones and the new one, and those of `sighted`.
    Landmarks that the past does not know begin wide about their smoothed estimate. Bearings count
    with the weight that Student's t gives to their smoothed residual.
    """
    known = {number: i for i, number in enumerate(past.ids.tolist())}
    new = [i for i, number in enumerate(sighted.ids.tolist()) if number not in known]
    mean, covariance = _moved(past, kind, parameters, poses)
    size = len(mean)
    mean = np.concatenate([mean, sighted.places[new].ravel()])
    wide = np.zeros((len(mean), len(mean)))
    wide[:size, :size] = covariance
    fresh = np.arange(size, len(mean))
    wide[fresh, fresh] = np.tile([WIDE_DIRECTION**2, WIDE_LOG_RANGE**2], len(new))
    ids = np.concatenate([past.ids, sighted.ids[new]])
    known = {number: i for i, number in enumerate(ids.tolist())}
    rows = np.array([known[number] for number in sighted.ids.tolist()], np.int64)
    mean, covariance = _updated(mean, wide, rows, poses[2], sighted, dof)
    last_seen = np.concatenate([past.last_seen, np.full(len(new), scan)])
    last_seen[rows] = scan
    sightings = np.concatenate([past.sightings, np.zeros(len(new), np.int64)])
    sightings[rows] += 1
    return Committed(
        mean=mean,
        covariance=covariance,
        ids=ids,
        centres=np.concatenate([past.centres, sighted.centres[new]]),
        visible=np.concatenate([past.visible, np.ones(len(new))]),
        first_seen=np.concatenate([past.first_seen, np.full(len(new), scan)]),
        last_seen=last_seen,
        sightings=sightings,
    )


def _moved(
    past: Committed, kind: int, parameters: FloatArray, poses: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Put the next pose in the place of the older one.

    With the residual e + A (x - x0) + B (p - p0) a unit Gaussian, p is Gaussian too.
    """
    residual, jacobian = np.empty(3), np.empty((3, 9))
    motion_terms(kind, parameters, poses[0], poses[1], poses[2], residual, jacobian)
    # A step of no length says nothing of where it leads to: then the pose is anywhere.
    inverse = np.linalg.pinv(np.concatenate([jacobian[:, 6:], np.eye(3) / ANYWHERE]))
    gain = -inverse[:, :3] @ jacobian[:, :6]
    off = past.mean[:6] - poses[:2].ravel()
    off[[2, 5]] = [wrapped(off[2]), wrapped(off[5])]
    pose = poses[2] - inverse[:, :3] @ residual + gain @ off
    n = len(past.mean)
    transfer = np.zeros((6, n))
    transfer[:3, 3:6] = np.eye(3)
    transfer[3:, :6] = gain
    mean = past.mean.copy()
    mean[:3], mean[3:6] = past.mean[3:6], pose
    covariance = past.covariance.copy()
    across = transfer[:, :6] @ past.covariance[:6]  # (6, n)
    covariance[:6, 6:] = across[:, 6:]
    covariance[6:, :6] = across[:, 6:].T
    covariance[:6, :6] = across[:, :6] @ transfer[:, :6].T
    covariance[3:6, 3:6] += inverse @ inverse.T
    return mean, covariance


def _updated(
    mean: FloatArray,
    covariance: FloatArray,
    rows: IntArray,
    pose: FloatArray,
    sighted: Sighted,
    dof: float,
) -> tuple[FloatArray, FloatArray]:
    m = len(rows)
    if not m:
        return mean, covariance
    points = points_of(sighted.places, sighted.centres)
    arm, away = points - sighted.centres, points - pose[:2]
    squared = np.maximum((away**2).sum(axis=1), 1e-18)
    slope = np.stack([-away[:, 1], away[:, 0]], axis=1) / squared[:, None]
    expected = np.arctan2(away[:, 1], away[:, 0]) - pose[2]
    innovation = np.array([wrapped(b) for b in (sighted.bearings - expected).tolist()])
    local = np.stack(
        [
            -slope[:, 0],
            -slope[:, 1],
            -np.ones(m),
            -slope[:, 0] * arm[:, 1] + slope[:, 1] * arm[:, 0],
            (slope * arm).sum(axis=1),
        ],
        axis=1,
    )
    at = np.concatenate([np.tile([3, 4, 5], (m, 1)), 6 + 2 * rows[:, None] + np.arange(2)], axis=1)
    variances = sighted.sigmas**2
    if math.isfinite(dof):
        variances = variances * (dof + innovation**2 / sighted.sigmas**2) / (dof + 1.0)
    linearised = np.concatenate([np.tile(pose, (m, 1)), sighted.places], axis=1)
    off = mean[at] - linearised
    for column in (2, 3):
        off[:, column] = [wrapped(angle) for angle in off[:, column].tolist()]
    residual = innovation - (local * off).sum(axis=1)
    cross = np.einsum("nmi,mi->nm", covariance[:, at], local)
    total = np.einsum("mi,mik->mk", local, cross[at]) + np.diag(variances)
    deviations = np.sqrt(np.diag(total))
    correlation = total / (deviations[:, None] * deviations) + JITTER * np.eye(m)
    gain = np.linalg.solve(correlation, (cross / deviations).T).T / deviations
    covariance = covariance - gain @ cross.T
    return mean + gain @ residual, 0.5 * (covariance + covariance.T)
