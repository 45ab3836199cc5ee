"""What bearings can tell of a run: equations less unknowns, and what is left to the prior."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import FloatArray, IntArray
from mht_slam.association import MISSED, Association
from mht_slam.errors import AssociationError, OptionError, UnobservableError
from mht_slam.graph.free_directions import free_directions
from mht_slam.graph.initial import starting_points
from mht_slam.graph.problem import Problem, make_problem
from mht_slam.graph.solve import UnsolvedError, solve_association
from mht_slam.measurements import RunPair, StraightRun, scan_selection
from mht_slam.models import ObservationModel


@dataclass(frozen=True)
class Observability:
    """How much the bearings of one association say, and of what they say nothing.

    Attributes
    ----------
    n_measurements : bearings of landmarks that at least two scans see. A landmark seen once brings
        as many unknowns as it takes away.
    n_unknowns : two for each of those landmarks, and the poses of the scans that see them, in the
        unit of the first baseline.
    n_priors : those unknowns of the poses whose prior is proper; each counts as one measurement.
    free_directions : names of the directions that the prior decides, the freest first.
    """

    n_measurements: int
    n_unknowns: int
    n_priors: int
    free_directions: tuple[str, ...]

    @property
    def redundancy_of_bearings(self) -> int:
        """Equations less unknowns of the bearings alone."""
        return self.n_measurements - self.n_unknowns

    @property
    def redundancy(self) -> int:
        """Equations less unknowns, with the proper priors on poses as equations."""
        return self.redundancy_of_bearings + self.n_priors

    @property
    def ranks_by_priors(self) -> bool:
        """Whether the bearings alone fit every association, so that priors and sides decide."""
        return self.redundancy_of_bearings <= 0

    def describe(self) -> str:
        """Return one line that a result can be printed with."""
        line = (
            f"{self.n_measurements} bearings and {self.n_priors} priors for {self.n_unknowns} "
            f"unknowns: redundancy {self.redundancy}, of bearings alone "
            f"{self.redundancy_of_bearings}"
        )
        if self.ranks_by_priors:
            line += "; priors and sides rank associations, bearings alone do not"
        if self.free_directions:
            line += f"; left to the prior: {', '.join(self.free_directions)}"
        return line


def observability(
    run: StraightRun | RunPair,
    association: Association,
    model: ObservationModel,
    *,
    scans: Sequence[int] | None = None,
) -> Observability:
    """Count equations and unknowns of an association, and name what only the prior decides.

    Bearings never tell the scale: everything is in the unit of the first baseline. A direction of
    the remaining unknowns is *free* where it is the prior that decides: where the bearings alone
    give a standard deviation of more than half the prior's. That is taken at the association's
    estimate, or, where it has none, at the starting point of the optimiser. What the model holds
    fixed is no unknown.

    Each free direction is named by what moves most along it: "distance of landmark 2", "step from
    scan 1 to scan 2", "heading of scan 0", "common heading", "scale after the first step".
    Landmarks are rows of the association's table, scans indices of the run.

    Parameters
    ----------
    run : the scans.
    association : over `scans`.
    model : everything assumed.
    scans : indices in order of travel; None means all of the run.

    Raises `OptionError` for a run or model that is none; `AssociationError` for an association of
    other scans; `MeasurementError` for `scans` that do not exist. Source: docs/method.md,
    section 2.

    >>> from mht_slam import BearingScan
    >>> run = StraightRun(BearingScan(b) for b in ([0.5, 0.0], [0.7, 0.0], [1.2, 0.0]))
    >>> seen = observability(run, Association([[0, 0, 0], [1, 1, 1]], (2, 2, 2)),
    ...                      ObservationModel(sigma=0.01))
    >>> seen.redundancy_of_bearings, seen.free_directions
    (1, ('distance of landmark 1',))
    """
    if not isinstance(run, StraightRun | RunPair):
        raise OptionError(f"run is {type(run).__name__}: give a StraightRun or a RunPair")
    if not isinstance(model, ObservationModel):
        raise OptionError(f"model is {type(model).__name__}: give an ObservationModel")
    if isinstance(run, RunPair) and scans is not None and len(scans) != len(run):
        raise OptionError(f"scans is {scans!r}: a RunPair is used whole, leave scans out")
    chosen = scan_selection(range(len(run)) if scans is None else scans, len(run))
    expected = tuple(run.n_detections[i] for i in chosen)
    if not isinstance(association, Association) or association.n_detections != expected:
        raise AssociationError(
            f"association is {association!r}: give an Association over {expected} detections"
        )
    two_runs = isinstance(run, RunPair)
    n_measurements, n_unknowns, n_priors = _counts(association.table, model, two_runs)
    problem = make_problem(run, chosen, model)
    poses, landmarks = _linearisation_point(problem, association.table)
    return Observability(
        n_measurements=n_measurements,
        n_unknowns=n_unknowns,
        n_priors=n_priors,
        free_directions=free_directions(problem, association.table, poses, landmarks, chosen),
    )


def require_observable(
    run: StraightRun | RunPair, associations: Iterable[Association], model: ObservationModel
) -> None:
    """Refuse to rank associations of which not one can be contradicted by its bearings.

    The rule: of two or more associations, at least one has a redundancy, with proper priors on the
    poses as equations, above zero. One association alone is not ranked, and passes.

    Raises `UnobservableError` with the count and the remedy. Source: docs/method.md, section 2.
    """
    best: tuple[int, int, int] | None = None
    number = 0
    for association in associations:
        counted = _counts(association.table, model, isinstance(run, RunPair))
        if counted[0] - counted[1] + counted[2] > 0:
            return
        best = max(best or counted, counted, key=lambda c: c[0] - c[1] + c[2])
        number += 1
    if number < 2 or best is None:
        return
    n_measurements, n_unknowns, n_priors = best
    raise UnobservableError(
        f"nothing can tell the {number} associations apart: at best they have {n_measurements} "
        f"bearings of landmarks seen twice or more and {n_priors} priors on poses for {n_unknowns} "
        "unknowns, so each fits its bearings perfectly; give scans that see more landmarks, or "
        "more scans of the same ones"
    )


def _counts(table: IntArray, model: ObservationModel, two_runs: bool) -> tuple[int, int, int]:
    """Bearings, unknowns, and proper priors among the unknowns of the poses."""
    seen = table != MISSED
    shared = seen[seen.sum(axis=1) >= 2]
    n_bearings, n_landmarks = int(shared.sum()), len(shared)
    m = int(shared.any(axis=0).sum())
    if not n_landmarks:
        return 0, 0, 0
    wandering = m if model.heading_sigma > 0.0 else 0
    if two_runs:  # place, direction and length of the second run; only the length has a prior
        n_poses, n_priors = 4 + wandering, 1 + wandering
    elif model.motion == "straight":
        beside = m - 2 if model.lateral_sigma > 0.0 else 0
        n_poses = n_priors = m - 2 + wandering + beside
    else:
        n_poses = 3 * m - (3 if model.motion == "odometry" else 4)
        n_priors = m - 2 if model.motion == "free" else n_poses
    return n_bearings, 2 * n_landmarks + n_poses, n_priors


def _linearisation_point(problem: Problem, table: IntArray) -> tuple[FloatArray, FloatArray]:
    """(m, 3) poses and (n, 2) landmarks: the estimate, else where the optimiser starts."""
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        try:
            estimate = solve_association(problem, table, "laplace")
        except (UnsolvedError, OverflowError):
            return starting_points(problem, problem.sightings(table))[0]
    return estimate.poses, estimate.landmarks
