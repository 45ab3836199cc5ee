"""One experiment of the paper's scene: ranked, refined, and measured in F_L against the truth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import shapely
from scipy.stats import chi2

import mht_slam as ms
from mht_slam.arrays import FloatArray
from mht_slam.plotting.frames import between, estimate_in_landmark_frame
from mht_slam.plotting.style import ELLIPSE_COVERAGE
from mht_slam.polygon.cones import cells
from mht_slam.simulation import Scene, paper_scene, trajectories
from mht_slam.simulation.paper_scene import (
    BASE,
    LANDMARKS,
    METRES_PER_BASELINE,
    OBSERVATION_POINTS,
    SEEN,
    SENSOR_RANGE,
)
from mht_slam.simulation.scenes import observe_scene
from mht_slam.simulation.sensors import Sensor

ITEMS = ("O1", "O2", "O3", "Ld")
UNIT = math.dist(LANDMARKS[BASE[0]], LANDMARKS[BASE[1]])
"""Metres of the unit of F_L, |Lc Le|."""

PAPER, LONG_STEP, NEAR, BENT = "paper", "long last step", "ten metres back", "not straight"
TRACKS = MappingProxyType(
    {
        PAPER: tuple(OBSERVATION_POINTS[:, 0].tolist()),
        LONG_STEP: (-7.5, 4.5, 16.5),
        NEAR: (-10.0, 2.0, 6.5),
        BENT: tuple(OBSERVATION_POINTS[:, 0].tolist()),
    }
)
"""Metres of O1, O2 and O3 along the line. O3 is where it was but its step is as long as the first
one; or all three lie ten metres back, which brings O3 beside the landmarks."""
DEVIATION = 1.0
"""Metres that O3 lies beside the line where the track is not straight, left and right in turn."""
NOISE_OF_BENT_DEG = 1.0
"""The noise there, whatever epsilon the method assumes."""

POLYGON, WITH_THIRD_PAIR, VERTICES = "polygon", "polygon, with (O1, O3)", "polygon, vertices"
OVERLAP, NEAR_POLYGON = "polygon, overlap", "polygon, max_range 5"
GRAPH, QUADRATURE = "graph", "quadrature"
NEAR_PRIOR = "quadrature, prior of the sensor's range"
POLYGONS: MappingProxyType[str, dict[str, Any]] = MappingProxyType(
    {
        POLYGON: {},
        WITH_THIRD_PAIR: {"refine_pair": (0, 2)},
        OVERLAP: {"ratio": "overlap"},
        VERTICES: {"region": "vertices"},
        NEAR_POLYGON: {"max_range": 5.0},
        "polygon, max_range 30": {"max_range": 30.0},
        "polygon, max_range 300": {"max_range": 300.0},
    }
)
"""Readings of the polygon method, as options of `rank`. Five baselines are about the sensor's range
in the shorter pair's unit."""
PRIORS = MappingProxyType(
    {GRAPH: 30.0, QUADRATURE: 30.0, NEAR_PRIOR: SENSOR_RANGE / METRES_PER_BASELINE}
)
"""Standard deviation of the landmark prior, baselines, of the methods that weigh evidence."""
MAPPED = (POLYGON, WITH_THIRD_PAIR, VERTICES, GRAPH)
"""Methods whose maps are measured."""
FIRST, TRUE = "first", "true"
"""Whose map is measured: the first hypothesis's, or that of the true association."""

ROUNDING = 1e-9
NOTHING = (math.nan, math.nan, math.nan, False)
_REACH = math.sqrt(float(chi2.ppf(ELLIPSE_COVERAGE, df=2)))


@dataclass(frozen=True)
class Experiment:
    """One run past the landmarks; all randomness follows from these."""

    track: str
    epsilon_deg: float
    number: int
    seed: int

    @property
    def epsilon(self) -> float:
        """The vision error that methods assume, radians."""
        return math.radians(self.epsilon_deg)


class Ranked(NamedTuple):
    """How one method ranks the hypotheses of one experiment; scores are ratios or probabilities."""

    track: str
    epsilon_deg: float
    experiment: int
    method: str
    n_hypotheses: int
    truth_rank: int | None
    truth_score: float
    best_wrong_score: float
    n_cells: int
    swaps: bool


class Located(NamedTuple):
    """Where one method says that one thing is, in metres of F_L; nan where it says nothing.

    The uncertainty is the radius of the smallest circle round the region, the error the distance
    from its centroid to the truth.
    """

    track: str
    epsilon_deg: float
    experiment: int
    method: str
    hypothesis: str
    item: str
    uncertainty: float
    area: float
    error: float
    holds_truth: bool


def measure(experiment: Experiment) -> tuple[list[Ranked], list[Located]]:
    """Let all methods answer one experiment."""
    scene = experiment_scene(experiment)
    ranked: list[Ranked] = []
    located: list[Located] = []
    facts = (_cells_of_both_pairs(scene, experiment.epsilon), _ld_and_le_swap(scene))
    label = (experiment.track, experiment.epsilon_deg, experiment.number)
    for method, hypotheses in _answers(experiment, scene):
        scores = [
            h.score if isinstance(h, ms.RankedAssociation) else h.probability for h in hypotheses
        ]
        is_true = [h.association.exact(scene.truth) for h in hypotheses]
        place = is_true.index(True) if True in is_true else None
        wrong = [score for score, true in zip(scores, is_true, strict=True) if not true]
        ranked.append(
            Ranked(
                *label,
                method,
                len(hypotheses),
                None if place is None else place + 1,
                0.0 if place is None else scores[place],
                max(wrong, default=0.0),
                *facts,
            )
        )
        if method not in MAPPED:
            continue
        for reading, index in ((FIRST, 0), (TRUE, place)):
            chosen = hypotheses[index : index + 1] if index is not None else ()
            figures = _figures(chosen[0], scene) if chosen else {}
            located += [
                Located(*label, method, reading, item, *figures.get(item, NOTHING))
                for item in ITEMS
            ]
    return ranked, located


def model_of(method: str, epsilon: float) -> ms.ObservationModel:
    """What a method that weighs evidence assumes: the variance of noise uniform inside epsilon."""
    return ms.ObservationModel(sigma=epsilon / math.sqrt(3.0), landmark_sigma=PRIORS[method])


def experiment_scene(experiment: Experiment) -> Scene:
    """Simulate the scans of an experiment: the paper's scene, or one of its variations."""
    rng = np.random.default_rng(
        [
            experiment.seed,
            list(TRACKS).index(experiment.track),
            round(1000 * experiment.epsilon_deg),
            experiment.number,
        ]
    )
    if experiment.track == PAPER:
        return paper_scene(rng, experiment.epsilon)
    if experiment.track == BENT:
        side = DEVIATION if experiment.number % 2 == 0 else -DEVIATION
        return paper_scene(rng, math.radians(NOISE_OF_BENT_DEG), deviation=side)
    along = np.array(TRACKS[experiment.track])
    poses = trajectories.straight([(along[2] - along[1]) / (along[1] - along[0])])
    landmarks = np.array([LANDMARKS[name] for name in SEEN]) - [along[0], 0.0]
    sensor = Sensor(spread=experiment.epsilon, noise="uniform")
    return observe_scene(PAPER, "straight", poses, landmarks / METRES_PER_BASELINE, sensor, rng)


def landmark_rows(scene: Scene) -> dict[str, int]:
    """Row of the truth's table of each landmark in view: they keep their order along the run."""
    return dict(zip(SEEN, np.argsort(scene.landmarks[:, 0]).tolist(), strict=True))


def base_detections(scene: Scene) -> tuple[int, int]:
    """Detections of O2 that are Lc and Le: the paper's frame, which the method is told."""
    rows = landmark_rows(scene)
    first, second = (int(scene.truth.table[rows[name], 1]) for name in BASE)
    return first, second


def true_places(scene: Scene) -> dict[str, FloatArray]:
    """(2,) true places of observation points and Ld in F_L."""
    rows = landmark_rows(scene)
    points = np.vstack([scene.poses[:, :2], scene.landmarks[rows["Ld"]]])
    places = between(points, *(scene.landmarks[rows[name]] for name in BASE))
    return dict(zip(ITEMS, places, strict=True))


def _answers(
    experiment: Experiment, scene: Scene
) -> Iterator[tuple[str, ms.Ranking | ms.Posterior]]:
    """What every method says; off the paper's own track only the polygon method is asked."""
    is_paper, epsilon, base = experiment.track == PAPER, experiment.epsilon, base_detections(scene)
    rankings = {
        method: ms.rank(
            scene.run, epsilon=epsilon, method="exhaustive", top_k=None, base=base, **options
        )
        for method, options in POLYGONS.items()
        if is_paper or method == POLYGON
    }
    yield from rankings.items()
    for method in PRIORS if is_paper else ():
        model = model_of(method, epsilon)
        if method == GRAPH:
            yield method, ms.refine(scene.run, rankings[POLYGON], model=model)
        else:
            candidates = [h.association for h in rankings[POLYGON]]
            yield method, ms.evidence_by_quadrature(scene.run, candidates, model=model)


def _figures(
    hypothesis: ms.RankedAssociation | ms.Hypothesis, scene: Scene
) -> dict[str, tuple[float, float, float, bool]]:
    """The last four columns of `Located` for each thing that a hypothesis places somewhere."""
    rows = landmark_rows(scene)
    # The middle scan names the landmarks, whatever a hypothesis makes of the other two.
    seen = hypothesis.association.table[:, 1].tolist()
    own = {name: seen.index(int(scene.truth.table[row, 1])) for name, row in rows.items()}
    places = true_places(scene)
    if isinstance(hypothesis, ms.RankedAssociation):
        regions = _regions(hypothesis, own["Ld"])
        return {item: _of_polygon(region, places[item]) for item, region in regions}
    if hypothesis.failure is not None:
        return {}
    estimate = estimate_in_landmark_frame(hypothesis, (own[BASE[0]], own[BASE[1]]))
    centres = (*estimate.points, estimate.landmarks[own["Ld"]])
    covariances = (*estimate.point_covariances, estimate.landmark_covariances[own["Ld"]])
    return {
        item: _of_ellipse(centre, covariance, places[item])
        for item, centre, covariance in zip(ITEMS, centres, covariances, strict=True)
    }


def _regions(hypothesis: ms.RankedAssociation, row_of_ld: int) -> Iterator[tuple[str, Any]]:
    """What the pairs' regions share, where that is anything."""
    drawn = hypothesis.map_in_landmark_frame
    if drawn is None:
        return
    for region in (*drawn.observation_points, *drawn.landmarks):
        name = "Ld" if region.name == f"landmark {row_of_ld}" else region.name
        if name in ITEMS and shapely.area(region.intersection) > 0.0:
            yield name, region.intersection


def _of_polygon(region: Any, truth: FloatArray) -> tuple[float, float, float, bool]:
    radius, area = shapely.minimum_bounding_radius(region), shapely.area(region)
    centre = shapely.get_coordinates(shapely.centroid(region))[0]
    holds = shapely.distance(region, shapely.Point(truth)) <= ROUNDING
    return UNIT * float(radius), UNIT**2 * float(area), UNIT * math.dist(centre, truth), bool(holds)


def _of_ellipse(
    centre: FloatArray, covariance: FloatArray, truth: FloatArray
) -> tuple[float, float, float, bool]:
    variances, away = np.linalg.eigvalsh(covariance), truth - centre
    radius = UNIT * _REACH * math.sqrt(float(variances[-1]))
    area = math.pi * (UNIT * _REACH) ** 2 * math.sqrt(float(variances.prod()))
    holds = float(away @ np.linalg.solve(covariance, away)) <= _REACH**2
    return radius, area, UNIT * math.dist(centre, truth), holds


def _cells_of_both_pairs(scene: Scene, epsilon: float) -> int:
    """The larger number of cells of the two pairs of scans."""
    first, second, third = (scan.bearings for scan in scene.scans)
    return max(
        int(cells(*pair, epsilon=epsilon, max_range=100.0).filled.sum())
        for pair in ((first, second), (second, third))
    )


def _ld_and_le_swap(scene: Scene) -> bool:
    """Whether the scans of O1 and O2 see Ld and Le in different order."""
    rows = landmark_rows(scene)
    signs = []
    for scan in (0, 1):
        ld, le = (
            scene.scans[scan].bearings[scene.truth.table[rows[name], scan]] for name in ("Ld", "Le")
        )
        signs.append(bool(ld < le))
    return signs[0] != signs[1]
