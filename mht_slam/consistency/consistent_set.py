"""`consistent_associations`: every association that one straight path explains within epsilon."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mht_slam.arrays import FloatArray, finite_number, freeze, whole_number
from mht_slam.association import Association, refuse_unequal
from mht_slam.consistency.more_scans import Problem, consistent_tables
from mht_slam.consistency.work import Work
from mht_slam.errors import OptionError
from mht_slam.measurements import BearingScan, StraightRun, scan_selection
from mht_slam.progress import Progress

MAX_DETECTIONS = 100
"""The most detections of one scan: three scans have a row for every three of their detections."""

MAX_NODES = 2_000_000
"""Default for how many nodes of the search are gone through."""

RIGHT_ANGLE = np.pi / 2.0


@dataclass(frozen=True, eq=False)
class ConsistentSet:
    """Associations that one straight path and one set of landmarks explain within epsilon.

    Attributes
    ----------
    associations : in the order of `Association.sort_key`.
    complete : whether there are no others. An empty complete set certifies that nothing explains
        the scans, a complete set of one that nothing else does.
    ratio_intervals : (len, m - 2, 2) for each association the smallest and largest |O_k O_k+1|,
        k >= 2, in first baselines, over everything that explains it; 0 and inf where unbounded.
    scans : indices of the run's scans that the associations' columns stand for.
    epsilon : the vision error, radians.
    n_nodes : nodes of the search.
    """

    associations: tuple[Association, ...]
    complete: bool
    ratio_intervals: FloatArray = field(repr=False)
    scans: tuple[int, ...]
    epsilon: float
    n_nodes: int

    def __len__(self) -> int:
        return len(self.associations)


def consistent_associations(
    run: StraightRun,
    *,
    epsilon: float,
    limit: int = 10_000,
    scans: Sequence[int] | None = None,
    max_missed: int = 0,
    max_false: int = 0,
    max_nodes: int = MAX_NODES,
    progress: Progress | None = None,
) -> ConsistentSet:
    """List every association that one straight path explains with errors of at most epsilon.

    Consistent means: there are positive steps along the run's line and a landmark for every row,
    none of them on an observation point that sees it, such that all its bearings are within
    epsilon. Headings are common to all scans and known.

    Parameters
    ----------
    run : what was seen. Forward is the direction of travel.
    epsilon : the vision error, radians, in (0, pi/2): half the opening of every cone.
    limit : stop as soon as so many are found. Two are enough to tell whether one is the only one.
    scans : indices of at least three scans, in order of travel; None means all.
    max_missed : the most -1 entries of a table. 0 lists full tables only.
    max_false : the most detections that belong to no landmark.
    max_nodes : stop after so many nodes of the search, which is exponential in the worst case.
    progress : called with the nodes gone through and `max_nodes`, now and then.

    Returns a `ConsistentSet`; `complete` is false where `limit` or `max_nodes` ended the search.
    Any number of landmarks will do, also fewer than three: none of them carries a frame. A landmark
    seen in two scans restricts the order of its bearings only, one seen once nothing.

    Labels of the scans are hard constraints: an association that contradicts them is not listed.
    Rounding is outward: bearings count as within epsilon up to 4e-15 radians, and for more than
    three scans steps may violate the bounds that landmarks set them by 1e-8 of the shortest step,
    so that no consistent association is lost to floating point.

    Raises `OptionError` for options outside these or a `RunPair`, two runs of which share no step;
    `UnequalScansError` where scans differ in length more than `max_missed` and `max_false` allow;
    `MeasurementError` for `scans` that do not exist. Source: docs/method.md, section 2.

    >>> import numpy as np
    >>> from mht_slam.measurements import BearingScan, StraightRun
    >>> landmarks = np.array([[1.0, 3.0], [2.0, -2.0], [3.5, 1.5]])
    >>> run = StraightRun(
    ...     BearingScan(np.arctan2(landmarks[:, 1], landmarks[:, 0] - x)) for x in (0.0, 1.0, 2.2)
    ... )
    >>> consistent = consistent_associations(run, epsilon=np.deg2rad(1))
    >>> consistent.complete, [a.table.tolist() for a in consistent.associations]
    (True, [[[0, 0, 0], [1, 1, 1], [2, 2, 2]]])
    >>> consistent.ratio_intervals.round(2).tolist()
    [[[1.01, 1.44]]]
    """
    finite_number(epsilon, "epsilon", above=0.0, below=RIGHT_ANGLE)
    whole_number(limit, "limit", at_least=1)
    whole_number(max_missed, "max_missed", at_least=0)
    whole_number(max_false, "max_false", at_least=0)
    whole_number(max_nodes, "max_nodes", at_least=1)
    chosen, members = selected_scans(run, scans)
    counts = [len(scan) for scan in members]
    refuse_unequal(counts, max_missed, max_false)
    problem = Problem(members, float(epsilon), max_missed, max_false)
    work = Work(max_nodes, progress)
    found = []
    complete = True
    for rows, bounds in consistent_tables(problem, work):
        found.append((Association(rows, counts), bounds))
        if len(found) == limit:
            complete = False
            break
    found.sort(key=lambda pair: pair[0].sort_key())
    intervals = np.array([bounds.step_intervals() for _, bounds in found])
    return ConsistentSet(
        associations=tuple(association for association, _ in found),
        complete=complete and not work.exhausted,
        ratio_intervals=freeze(intervals.reshape(len(found), len(members) - 2, 2)),
        scans=chosen,
        epsilon=float(epsilon),
        n_nodes=work.n_nodes,
    )


def selected_scans(
    run: StraightRun, scans: Sequence[int] | None
) -> tuple[tuple[int, ...], tuple[BearingScan, ...]]:
    """Indices of the scans to use, and those scans.

    Raises `OptionError` for anything but a straight run, or scans with too many detections, and
    `MeasurementError` for fewer than three scans or such that do not exist.
    """
    if not isinstance(run, StraightRun):
        raise OptionError(
            f"run is {type(run).__name__}: give a StraightRun. Two runs of two scans have no step "
            "in common, so every ratio of steps explains them"
        )
    chosen = scan_selection(range(len(run)) if scans is None else scans, len(run))
    members = run.select(chosen).scans
    counts = [len(scan) for scan in members]
    if max(counts) > MAX_DETECTIONS:
        raise OptionError(
            f"the scans have {counts} detections: at most {MAX_DETECTIONS} a scan can be searched, "
            "give fewer"
        )
    return chosen, members
