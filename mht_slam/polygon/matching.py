"""All matchings of high value: every landmark takes one pick, no detection is in two of them.

Depth first, the landmark with the fewest free picks next. Finding the best of them is the axial
assignment problem in three or more dimensions, hard in the worst case; the bounds are exact, so
nothing is lost, whatever it takes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mht_slam.arrays import BoolArray, FloatArray, IntArray
from mht_slam.compiled import compiled

DONE, FULL, PAUSE = 0, 1, 2
"""Why a search returns: nothing is left, no room for more matchings, or a pause."""


class Matching(NamedTuple):
    """Where a search for matchings stands; all arrays change as it goes on.

    Attributes
    ----------
    place : (3,) level, matchings found, partial matchings extended so far.
    landmark, pick : (T,) landmark branched on at each level, -1 before that, and its pick now.
    value_before : (T + 1,) sum of the values picked above each level.
    others : (T,) at each level, that and the best free picks of the other open landmarks.
    is_open : (T,) landmarks without a pick.
    used : (D,) detections taken.
    found : (F, T) picks of the matchings found.
    """

    place: IntArray
    landmark: IntArray
    pick: IntArray
    value_before: FloatArray
    others: FloatArray
    is_open: BoolArray
    used: BoolArray
    found: IntArray


def new_matching(n_landmarks: int, n_detections: int, n_found: int) -> Matching:
    """A search with room for `n_found` matchings."""
    return Matching(
        place=np.zeros(3, dtype=np.int64),
        landmark=np.full(n_landmarks, -1),
        pick=np.zeros(n_landmarks, dtype=np.int64),
        value_before=np.zeros(n_landmarks + 1),
        others=np.zeros(n_landmarks),
        is_open=np.ones(n_landmarks, dtype=np.bool_),
        used=np.zeros(n_detections, dtype=np.bool_),
        found=np.zeros((n_found, n_landmarks), dtype=np.int64),
    )


def start_anew(matching: Matching) -> None:
    """Start anew, with other picks."""
    matching.place[:2] = 0
    matching.landmark[:] = -1
    matching.is_open[:] = True
    matching.used[:] = False


@compiled
def find_matchings(
    begin: IntArray,
    end: IntArray,
    value: FloatArray,
    detections: IntArray,
    matching: Matching,
    needed: float,
    steps: int,
) -> int:
    """Go on until all matchings with a sum of values of at least `needed` are found.

    The picks of landmark m are ``begin[m]`` to ``end[m]``, best value first; `detections` (N, C)
    names each pick's. Returns `FULL` when there is no room for another matching, `PAUSE`
    after a total of `steps` partial matchings, else `DONE`. It can go on from either.
    """
    place = matching.place
    n_landmarks = len(matching.landmark)
    while place[0] >= 0:
        level = place[0]
        if level == n_landmarks:
            if place[1] == len(matching.found):
                return FULL
            for above in range(n_landmarks):
                matching.found[place[1], matching.landmark[above]] = matching.pick[above]
            place[1] += 1
            _give_back(detections, matching)
            continue
        if matching.landmark[level] < 0:
            if place[2] >= steps:
                return PAUSE
            place[2] += 1
            if not _choose_landmark(begin, end, value, detections, matching, needed):
                _give_back(detections, matching)
                continue
        if not _take_next(end, value, detections, matching, needed):
            matching.is_open[matching.landmark[level]] = True
            matching.landmark[level] = -1
            _give_back(detections, matching)
    return DONE


@compiled
def _choose_landmark(
    begin: IntArray,
    end: IntArray,
    value: FloatArray,
    detections: IntArray,
    matching: Matching,
    needed: float,
) -> bool:
    """Branch on the open landmark with the fewest free picks; False where no sum is enough."""
    level = matching.place[0]
    total = matching.value_before[level]
    fewest = len(value) + 1
    chosen, best = -1, 0.0
    for landmark in range(len(matching.is_open)):
        if not matching.is_open[landmark]:
            continue
        count, highest = 0, 0.0
        for pick in range(begin[landmark], end[landmark]):
            if _is_free(detections[pick], matching):
                if count == 0:
                    highest = value[pick]
                count += 1
                if count >= fewest:
                    break
        if count == 0:
            return False
        total += highest
        if count < fewest:
            fewest, chosen, best = count, landmark, highest
    if total < needed:
        return False
    matching.others[level] = total - best
    matching.landmark[level] = chosen
    matching.is_open[chosen] = False
    matching.pick[level] = begin[chosen] - 1
    return True


@compiled
def _take_next(
    end: IntArray,
    value: FloatArray,
    detections: IntArray,
    matching: Matching,
    needed: float,
) -> bool:
    """Take the next free pick of the level's landmark and go down; False after the last one."""
    level = matching.place[0]
    landmark = matching.landmark[level]
    for pick in range(matching.pick[level] + 1, end[landmark]):
        if matching.others[level] + value[pick] < needed:
            return False
        if _is_free(detections[pick], matching):
            matching.pick[level] = pick
            matching.value_before[level + 1] = matching.value_before[level] + value[pick]
            for detection in detections[pick]:
                matching.used[detection] = True
            matching.place[0] = level + 1
            return True
    return False


@compiled
def _is_free(detections: IntArray, matching: Matching) -> bool:
    taken = False
    for detection in detections:
        taken |= matching.used[detection]
    return not taken


@compiled
def _give_back(detections: IntArray, matching: Matching) -> None:
    """Go up a level and free the detections of its pick."""
    matching.place[0] -= 1
    if matching.place[0] >= 0:
        for detection in detections[matching.pick[matching.place[0]]]:
            matching.used[detection] = False
