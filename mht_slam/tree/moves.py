"""Exchange, merge and split: small changes of an association that the scans' order hid."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.association import MISSED
from mht_slam.measurements import wrap_angle
from mht_slam.tree.branch import Branch, LostError, anew, triangulated
from mht_slam.tree.clusters import cluster_log_weights
from mht_slam.tree.effort import Effort
from mht_slam.tree.grow import pruned
from mht_slam.tree.pattern import single_weights
from mht_slam.tree.setting import Setting

CLOSE = np.deg2rad(6.0)
"""Bearings this far apart in one scan are not exchanged there."""
Row = tuple[int, ...]


@dataclass(frozen=True)
class Move:
    """Rows of the table that go, and rows that come; what is in no row is single."""

    gone: tuple[int, ...]
    new: tuple[Row, ...]


def improved(setting: Setting, branches: Sequence[Branch], effort: Effort) -> list[Branch]:
    """Return the branches and their better or nearly as good neighbours, best first.

    The first `effort.finalists` branches are changed in every way that `moves_of` knows; the
    `effort.moves` changes worth most at the branch's own poses are solved. Repeated from what
    is new among the first, until nothing is.
    """
    pool = {_key(branch): branch for branch in branches}
    tried: set[object] = set()
    for _ in range(effort.rounds):
        best = pruned(list(pool.values()), effort)[: effort.finalists]
        fresh = [branch for branch in best if _key(branch) not in tried]
        if not fresh:
            break
        for branch in fresh:
            tried.add(_key(branch))
            for neighbour in _neighbours(setting, branch, effort, pool):
                pool[_key(neighbour)] = neighbour
    return pruned(list(pool.values()), effort)


def moves_of(setting: Setting, branch: Branch) -> Iterator[Move]:
    """Every move of a branch.

    - exchange: two landmarks change places from one scan on, or in one scan only, where their
      bearings are close;
    - merge: two landmarks that no scan sees both of become one;
    - split: a landmark becomes two at a scan, or loses one detection;
    - adopt: a single detection joins a landmark that its scan misses, takes the place of the
      landmark's detection there, or makes a landmark with another single one.
    """
    rows = [tuple(row) for row in branch.table.tolist()]
    bearings = [scan.bearings for scan in setting.problem.scans]
    k = len(branch.poses)
    for a, b in combinations(range(len(rows)), 2):
        one, other = rows[a], rows[b]
        if all(i == MISSED or j == MISSED for i, j in zip(one, other, strict=True)):
            both = tuple(j if i == MISSED else i for i, j in zip(one, other, strict=True))
            yield Move((a, b), (both,))
        for scan in range(k):
            i, j = one[scan], other[scan]
            if i == j:
                continue
            if i != MISSED and j != MISSED:
                if abs(wrap_angle(float(bearings[scan][i] - bearings[scan][j]))) > CLOSE:
                    continue
                yield Move((a, b), (_with(one, scan, j), _with(other, scan, i)))
            if scan > 0:
                yield Move((a, b), (one[:scan] + other[scan:], other[:scan] + one[scan:]))
    for a, row in enumerate(rows):
        seen = [scan for scan in range(k) if row[scan] != MISSED]
        for scan in seen:
            yield Move((a,), (_with(row, scan, MISSED),))
        for scan in seen[1:]:
            head = row[:scan] + (MISSED,) * (k - scan)
            yield Move((a,), (head, (MISSED,) * scan + row[scan:]))
        for scan, detection in branch.singles.tolist():
            held = row[scan]
            if held == MISSED or (
                abs(wrap_angle(float(bearings[scan][held] - bearings[scan][detection]))) <= CLOSE
            ):
                yield Move((a,), (_with(row, scan, detection),))
    for (s, i), (t, j) in combinations(map(tuple, branch.singles.tolist()), 2):
        if s != t:
            yield Move((), (_with(_with((MISSED,) * k, s, i), t, j),))


def _neighbours(
    setting: Setting, branch: Branch, effort: Effort, known: dict[object, Branch]
) -> Iterator[Branch]:
    moves = [move for move in moves_of(setting, branch) if _keeps_labels(setting, branch, move)]
    with np.errstate(all="ignore"):  # what is beyond floats is no gain
        gains = _gains(setting, branch, moves)
    gains = np.where(np.isfinite(gains), gains, -np.inf)
    for index in np.argsort(-gains, kind="stable")[: effort.moves].tolist():
        if gains[index] < -effort.drop:
            return
        neighbour = _moved(setting, branch, moves[index])
        if neighbour is not None and _key(neighbour) not in known:
            yield neighbour


def _keeps_labels(setting: Setting, branch: Branch, move: Move) -> bool:
    """Whether equal labels stay one landmark and different ones two."""
    scans = setting.problem.scans[: len(branch.poses)]
    if not setting.problem.labelled:
        return True
    rows = [row for i, row in enumerate(map(tuple, branch.table.tolist())) if i not in move.gone]
    rows += [row for row in move.new if _sightings(row) >= 2]
    group = {(s, d): i for i, row in enumerate(rows) for s, d in enumerate(row) if d != MISSED}
    home: dict[str, object] = {}
    name: dict[object, str] = {}
    for s, scan in enumerate(scans):
        for d, label in enumerate(scan.labels or ()):
            own = group.get((s, d), (s, d))
            if label is not None and (
                home.setdefault(label, own) != own or name.setdefault(own, label) != label
            ):
                return False
    return True


def _gains(setting: Setting, branch: Branch, moves: Sequence[Move]) -> FloatArray:
    """(len(moves),) gain of each move at the branch's poses, in nats."""
    if not moves:
        return np.empty(0)
    old = [tuple(row) for row in branch.table.tolist()]
    distinct = dict.fromkeys(
        row for move in moves for row in move.new if _sightings(row) >= 2 and row not in old
    )
    rows = [*old, *distinct]
    points = np.array(
        [*branch.points, *(_start(setting, branch, row) for row in distinct)]
    ).reshape(-1, 2)
    k = len(branch.poses)
    weights = cluster_log_weights(
        setting, branch.poses, np.array(rows, dtype=np.int64).reshape(-1, k), points
    )
    weight_of = dict(zip(rows, weights.tolist(), strict=True))
    detections = np.array(
        [(s, d) for s in range(k) for d in range(len(setting.problem.scans[s]))], dtype=np.int64
    ).reshape(-1, 2)
    alone = dict(
        zip(
            map(tuple, detections.tolist()),
            single_weights(setting, branch.poses, detections).tolist(),
            strict=True,
        )
    )

    def worth(rows_: Sequence[Row]) -> float:
        total = 0.0
        for row in rows_:
            if _sightings(row) >= 2:
                # A landmark takes its detections out of the single ones.
                total += weight_of[row] - sum(alone[s, d] for s, d in enumerate(row) if d != MISSED)
        return total

    return np.array([worth(move.new) - worth([old[a] for a in move.gone]) for move in moves])


def _moved(setting: Setting, branch: Branch, move: Move) -> Branch | None:
    rows = [tuple(row) for i, row in enumerate(branch.table.tolist()) if i not in move.gone]
    points = [p for i, p in enumerate(branch.points) if i not in move.gone]
    for row in move.new:
        if _sightings(row) >= 2:
            rows.append(row)
            points.append(_start(setting, branch, row))
    k = len(branch.poses)
    table = np.array(rows, dtype=np.int64).reshape(-1, k)
    used = {(s, d) for row in rows for s, d in enumerate(row) if d != MISSED}
    singles = [
        (s, d) for s in range(k) for d in range(len(setting.problem.scans[s])) if (s, d) not in used
    ]
    try:
        return anew(
            setting,
            table,
            np.array(singles, dtype=np.int64).reshape(-1, 2),
            branch.poses,
            np.array(points).reshape(-1, 2),
        )
    except LostError:
        return None


def _start(setting: Setting, branch: Branch, row: Row) -> FloatArray:
    """Where the first and the last ray of a row meet."""
    seen = [scan for scan, detection in enumerate(row) if detection != MISSED]
    first, last = seen[0], seen[-1]
    return triangulated(setting, branch.poses, (first, row[first]), (last, row[last]))


def _with(row: Row, scan: int, detection: int) -> Row:
    return (*row[:scan], detection, *row[scan + 1 :])


def _sightings(row: Row) -> int:
    return sum(detection != MISSED for detection in row)


def _key(branch: Branch) -> object:
    return branch.table.shape, branch.table.tobytes()
