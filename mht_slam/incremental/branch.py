"""One hypothesis: what it says about the scans of the window, its estimate and its score."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED
from mht_slam.incremental.past import Committed, places_of, points_of
from mht_slam.incremental.smoother import inverse_root, smooth_window

DETECTION_BITS = 20
"""Of a landmark's number: which detection of its scan was the first; the rest is the scan."""
NO_OPTIMUM = -1e6
"""Log evidence of a branch that could not be solved: finite, so that such ones still compare."""


@dataclass(frozen=True, eq=False)
class Window:
    """What all branches share at a time: the open scans, and the past as they see it.

    Attributes
    ----------
    first : number of the oldest open scan; `first` - 1 is the newest committed pose.
    bearings, sigmas : one (d,) array for each of w scans.
    kinds, motion : (w,) and (w, 12) steps before each of them.
    prior_mean, prior_information : of the two committed poses and the active settled landmarks.
    settled : (s,) numbers of those landmarks.
    centres : (s, 2).
    """

    first: int
    bearings: tuple[FloatArray, ...]
    sigmas: tuple[FloatArray, ...]
    kinds: IntArray
    motion: FloatArray
    prior_mean: FloatArray
    prior_information: FloatArray
    settled: IntArray
    centres: FloatArray

    @property
    def places(self) -> FloatArray:
        """(s, 2) the active settled landmarks as the past sees them."""
        return self.prior_mean[6:].reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class Branch:
    """A hypothesis over the open scans, solved given the committed past.

    Landmarks come in the order of the window's settled ones, then its own tentative ones.

    Attributes
    ----------
    owners : for each open scan the (d,) landmark of each detection, -1 for one on its own.
    ids : (n,) numbers of the landmarks.
    centres, places : (n, 2) as in `mht_slam.incremental.smoother`.
    visible : (n,) chance that each landmark is in view of the last scan.
    sightings : (o, 2) pose, counted from the older committed one, and landmark.
    bearings, sigmas : (o,) of the sightings.
    poses : (w + 2, 3), the two committed ones first.
    log_pattern : log weight of what was detected, missed and left alone.
    log_evidence : of the geometry, as `smooth_window` has it.
    root : as `smooth_window` has it.
    """

    owners: tuple[IntArray, ...]
    ids: IntArray
    centres: FloatArray
    places: FloatArray
    visible: FloatArray
    sightings: IntArray
    bearings: FloatArray
    sigmas: FloatArray
    poses: FloatArray
    log_pattern: float
    log_evidence: float
    root: FloatArray

    @property
    def log_score(self) -> float:
        """Log weight among the branches of one window."""
        return self.log_pattern + self.log_evidence

    @property
    def last_root(self) -> FloatArray:
        """The block of `root` that belongs to the landmarks and the last pose."""
        size = 2 * len(self.ids) + 3
        return self.root[-size:, -size:]

    @property
    def log_range_deviations(self) -> FloatArray:
        """(n,) standard deviations of the landmarks' log ranges."""
        spread = inverse_root(self.last_root)
        return np.asarray(np.sqrt((spread[1 : 2 * len(self.ids) : 2] ** 2).sum(axis=1)))

    @cached_property
    def key(self) -> bytes:
        """The same for branches that say the same about the open scans."""
        return b"".join(owner.tobytes() for owner in self.owners)


def empty_branch() -> Branch:
    """Return the branch before the first scan."""
    nothing = np.empty(0)
    return Branch(
        owners=(),
        ids=np.empty(0, np.int64),
        centres=np.empty((0, 2)),
        places=np.empty((0, 2)),
        visible=nothing,
        sightings=np.empty((0, 2), np.int64),
        bearings=nothing,
        sigmas=nothing,
        poses=np.array([[-2.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]),
        log_pattern=0.0,
        log_evidence=0.0,
        root=np.eye(3),
    )


def solved(
    branch: Branch, window: Window, dof: float, landmark_sigma: float, rounds: int
) -> Branch | None:
    """Move a branch to its optimum; None where it has none."""
    poses, places = branch.poses.copy(), branch.places.copy()
    usable, log_evidence, root = smooth_window(
        window.prior_mean,
        window.prior_information,
        window.kinds,
        window.motion,
        branch.sightings,
        branch.bearings,
        branch.sigmas,
        dof,
        landmark_sigma,
        branch.centres,
        len(window.settled),
        poses,
        places,
        rounds,
    )
    if not usable:
        return None
    return replace(branch, poses=poses, places=places, log_evidence=log_evidence, root=root)


def unsolved(branch: Branch) -> Branch:
    """Return a branch that has no optimum as it stands: unsure, and behind any that has one."""
    size = 3 * len(branch.poses) + 2 * len(branch.ids)
    return replace(branch, log_evidence=NO_OPTIMUM, root=np.eye(size))


def extended(
    parent: Branch,
    window: Window,
    motion: FloatArray,
    matches: Sequence[tuple[int, int]],
    pairs: Sequence[tuple[int, int, int, FloatArray]],
    log_pattern: float,
    visible: FloatArray,
    new_visible: Sequence[float],
) -> Branch:
    """Return the branch with the newest scan of the window, not yet solved.

    Parameters
    ----------
    motion : (3,) forward, leftward, turn from the last pose: where the optimiser starts.
    matches : (landmark, detection) pairs, landmarks counted in the parent's order.
    pairs : (open scan, earlier detection, detection, place): each becomes a tentative landmark,
        `place` its first direction and log range.
    log_pattern : of the child.
    visible, new_visible : of the parent's landmarks after the scan, and of the new ones.
    """
    newest = len(window.bearings) - 1
    bearings = window.bearings[newest]
    here = parent.poses[-1]
    c, s = math.cos(here[2]), math.sin(here[2])
    pose = np.array(
        [
            here[0] + c * motion[0] - s * motion[1],
            here[1] + s * motion[0] + c * motion[1],
            here[2] + motion[2],
        ]
    )
    owner = np.full(len(bearings), MISSED, np.int64)
    owners = [*parent.owners, owner]
    rows = [[newest + 2, landmark] for landmark, _ in matches]
    seen = [(newest, detection) for _, detection in matches]
    for landmark, detection in matches:
        owner[detection] = parent.ids[landmark]
    ids, centres, places = [], [], []
    for i, (scan, earlier, detection, place) in enumerate(pairs):
        number = landmark_number(window.first + scan, earlier)
        ids.append(number)
        centres.append(parent.poses[scan + 2, :2])
        places.append(place)
        at = len(parent.ids) + i
        rows += [[scan + 2, at], [newest + 2, at]]
        seen += [(scan, earlier), (newest, detection)]
        owners[scan] = owners[scan].copy()
        owners[scan][earlier] = number
        owner[detection] = number
    many = bool(pairs)
    return Branch(
        owners=tuple(owners),
        ids=np.concatenate([parent.ids, np.array(ids, np.int64)]) if many else parent.ids,
        centres=np.concatenate([parent.centres, centres]) if many else parent.centres,
        places=np.concatenate([parent.places, places]) if many else parent.places,
        visible=np.concatenate([visible, new_visible]) if many else visible,
        sightings=np.concatenate([parent.sightings, np.array(rows, np.int64).reshape(-1, 2)]),
        bearings=np.concatenate([parent.bearings, [window.bearings[k][d] for k, d in seen]]),
        sigmas=np.concatenate([parent.sigmas, [window.sigmas[k][d] for k, d in seen]]),
        poses=np.concatenate([parent.poses, pose[None]]),
        log_pattern=log_pattern,
        log_evidence=0.0,
        root=parent.root,
    )


def landmark_number(scan: int, detection: int) -> int:
    """Return the number of the landmark whose first detection this is."""
    return (scan << DETECTION_BITS) + detection


def first_detection(number: int) -> tuple[int, int]:
    """Return the scan and the detection that a landmark's number stands for."""
    return number >> DETECTION_BITS, number & ((1 << DETECTION_BITS) - 1)


def rearranged(branches: Sequence[Branch], window: Window, past: Committed) -> list[Branch]:
    """Bring branches into the order of a new window, without its oldest scan.

    Tentative landmarks that no open scan sees any more are let go.
    """
    where = {number: i for i, number in enumerate(past.ids.tolist())}
    visible = past.visible[[where[number] for number in window.settled.tolist()]]
    place_of = {number: i for i, number in enumerate(window.settled.tolist())}
    return [_rearranged(branch, window, visible, place_of) for branch in branches]


def _rearranged(
    branch: Branch, window: Window, settled_visible: FloatArray, place_of: dict[int, int]
) -> Branch:
    still_open = branch.sightings[:, 0] > 2
    sightings = branch.sightings[still_open] - np.array([1, 0])
    sighted = set(sightings[:, 1].tolist())
    numbers = branch.ids.tolist()
    own = [i for i, number in enumerate(numbers) if number not in place_of and i in sighted]
    n_settled = len(window.settled)
    places = np.concatenate([window.places, branch.places[own]])
    visible = np.concatenate([settled_visible, branch.visible[own]])
    order = np.full(len(numbers), -1, np.int64)
    # Where a loop has given two landmarks one name, the sighted one knows better where it is.
    kept = [
        i for i in sorted(range(len(numbers)), key=sighted.__contains__) if numbers[i] in place_of
    ]
    new = np.array([place_of[numbers[i]] for i in kept], np.int64)
    order[kept] = new
    points = points_of(branch.places[kept], branch.centres[kept])
    places[new] = places_of(points, window.centres[new])
    visible[new] = branch.visible[kept]
    order[own] = np.arange(n_settled, n_settled + len(own))
    sightings = np.column_stack([sightings[:, 0], order[sightings[:, 1]]])
    return replace(
        branch,
        owners=branch.owners[1:],
        ids=np.concatenate([window.settled, branch.ids[own]]),
        centres=np.concatenate([window.centres, branch.centres[own]]),
        places=places,
        visible=visible,
        sightings=sightings,
        bearings=branch.bearings[still_open],
        sigmas=branch.sigmas[still_open],
        poses=branch.poses[1:],
    )


def carried_along(
    branch: Branch, before: FloatArray, after: FloatArray, renamed: dict[int, int]
) -> Branch:
    """Move a branch rigidly with its newest committed pose, and rename landmarks.

    `before` and `after` (3,) are that pose; a loop that was closed has moved it.
    """
    turn = after[2] - before[2]
    c, s = math.cos(turn), math.sin(turn)
    rotation = np.array([[c, s], [-s, c]])
    poses = branch.poses.copy()
    poses[:, :2] = (poses[:, :2] - before[:2]) @ rotation + after[:2]
    poses[:, 2] += turn
    places = branch.places.copy()
    places[:, 0] += turn
    names = np.vectorize(lambda number: renamed.get(number, number), otypes=[np.int64])
    return replace(
        branch,
        owners=tuple(names(owner) if len(owner) else owner for owner in branch.owners),
        ids=names(branch.ids) if len(branch.ids) else branch.ids,
        centres=(branch.centres - before[:2]) @ rotation + after[:2],
        places=places,
        poses=poses,
    )
