"""One scene of the calibration study: candidates, what each scorer says of them, and the truth."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from calibration_cells import Cell
from scipy.special import softmax

import mht_slam as ms
from mht_slam import Association, Posterior, Ranking, StraightRun
from mht_slam.errors import MhtSlamError
from mht_slam.evaluation.baselines import order_changes, order_keeping

QUADRATURE, LAPLACE, MARGINAL = "quadrature", "graph evidence, laplace", "graph evidence, marginal"
LIKELIHOOD, ORDER = "graph likelihood", "order-keeping"
POLYGON_SPREADS = (2.0, 3.0)
"""Epsilon of the polygon method, in standard deviations of a bearing, jitter included."""
POLYGONS = tuple(f"polygon, {spread:g} sigma" for spread in POLYGON_SPREADS)
SCORERS = (*POLYGONS, ORDER, LIKELIHOOD, LAPLACE, MARGINAL, QUADRATURE)

SEED_SPREADS = (2.0, 3.0, 4.0)
"""Epsilons at which polygon seeds are looked through for the truth."""
MOST_SEEDS = 200
MOST_CANDIDATES = 200
POLYGON_CANDIDATES = 10
"""First ones of each polygon ranking, which join the candidates."""
MAX_MISSED, MAX_FALSE = 4, 3
"""Of tables where the model has misses and clutter."""

_DIGITS = 9
T = TypeVar("T")


@dataclass(frozen=True)
class Row:
    """What was found in one scene.

    Attributes
    ----------
    code : `code_version` of what scored.
    cell, seed : the scene.
    truth : index of the truth among the candidates, None where it is not one of them.
    order_changes : whether the visual order changes between scans.
    unlisted : bound, under the exact evidence, on the probability outside the candidates; None
        where the exact evidence knows no such model.
    probabilities : by scorer, over the candidates; empty where a scorer failed.
    seed_rank : the truth's rank in the polygon ranking at each of `SEED_SPREADS`, from 1, None
        where it is not among the first `MOST_SEEDS`.
    """

    code: str
    cell: str
    seed: int
    truth: int | None
    order_changes: bool
    unlisted: float | None
    probabilities: dict[str, list[float]]
    seed_rank: list[int | None]

    @property
    def key(self) -> tuple[str, int]:
        """What names the scene."""
        return self.cell, self.seed


def score_scene(cell: Cell, seed: int, code: str, *, marginal: bool) -> Row:
    """Draw one scene and let every scorer weigh the same candidates."""
    scene = cell.simulate(seed)
    run, truth = scene.run, scene.truth
    searched = _search(cell, run)
    rankings = {spread: _ranked(cell, run, spread) for spread in SEED_SPREADS}
    ordered = _attempt(lambda: order_keeping(run))
    candidates = _candidates(searched, [rankings[each] for each in POLYGON_SPREADS], ordered)
    solved = _attempt(lambda: ms.refine(run, candidates, model=cell.model, evidence="laplace"))
    said: dict[str, list[float]] = {
        name: _polygon_shares(candidates, rankings[spread])
        for name, spread in zip(POLYGONS, POLYGON_SPREADS, strict=True)
    }
    said[ORDER] = [] if ordered is None else [float(each == ordered) for each in candidates]
    said[LIKELIHOOD] = _likelihood_shares(candidates, solved)
    said[LAPLACE] = _probabilities(candidates, solved)
    if marginal:
        exact = _attempt(lambda: ms.refine(run, candidates, model=cell.model))
        said[MARGINAL] = _probabilities(candidates, exact)
    if cell.model.heading_sigma == 0.0:
        said[QUADRATURE] = _probabilities(candidates, searched)
    return Row(
        code=code,
        cell=cell.name,
        seed=seed,
        truth=candidates.index(truth) if truth in candidates else None,
        order_changes=order_changes(run, truth),
        unlisted=searched.covered if cell.model.heading_sigma == 0.0 else None,
        probabilities={name: [_rounded(p) for p in values] for name, values in said.items()},
        seed_rank=[_rank(rankings[spread], truth) for spread in SEED_SPREADS],
    )


def code_version(root: Path) -> str:
    """Digest of all sources that scores rest on; rows of other versions are not used."""
    digest = hashlib.sha256()
    study = root / "benchmarks" / "calibration"
    paths = [study / "calibration_cells.py", study / "calibration_scores.py"]
    for package in ("evidence", "graph", "polygon", "simulation"):
        paths += sorted((root / "mht_slam" / package).glob("*.py"))
    paths += sorted((root / "mht_slam").glob("*.py")) + sorted((root / "factors").glob("*.py"))
    for path in paths:
        digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def _search(cell: Cell, run: StraightRun) -> Posterior:
    """All associations within e^-40 of the largest exact evidence, at most `MOST_CANDIDATES`.

    Quadrature has no heading jitter; there bearings as uncertain as jitter makes them generate
    candidates, and nothing else is taken from it.
    """
    model = replace(cell.model, sigma=cell.spread, heading_sigma=0.0)
    max_missed, max_false = _allowed(cell)
    return ms.rank_by_evidence(
        run, model=model, top_k=MOST_CANDIDATES, max_missed=max_missed, max_false=max_false
    )


def _ranked(cell: Cell, run: StraightRun, spread: float) -> Ranking | None:
    max_missed, max_false = _allowed(cell)
    return _attempt(
        lambda: ms.rank(
            run,
            epsilon=spread * cell.spread,
            top_k=MOST_SEEDS,
            max_missed=max_missed,
            max_false=max_false,
        )
    )


def _allowed(cell: Cell) -> tuple[int, int]:
    return (MAX_MISSED, MAX_FALSE) if cell.detections else (0, 0)


def _candidates(
    searched: Posterior, rankings: Iterable[Ranking | None], ordered: Association | None
) -> list[Association]:
    """What the evidence lists, and what the others think best; ordered by the table.

    Where the evidence's list is cut, it stands alone: it then says nothing of the others.
    """
    found = {h.association for h in searched}
    if len(searched) < MOST_CANDIDATES:
        for ranking in rankings:
            found |= {h.association for h in (ranking or ())[:POLYGON_CANDIDATES]}
        if ordered is not None:
            found.add(ordered)
    return sorted(found, key=Association.sort_key)


def _polygon_shares(candidates: list[Association], ranking: Ranking | None) -> list[float]:
    """Scores made to sum to one over the candidates; equal shares where all are zero."""
    if not candidates:
        return []
    known = {h.association: h.score for h in ranking or ()}
    scores = np.array([known.get(each, 0.0) for each in candidates])
    total = float(scores.sum())
    shares = scores / total if total > 0.0 else np.full(len(scores), 1.0 / len(scores))
    return shares.tolist()


def _likelihood_shares(candidates: list[Association], solved: Posterior | None) -> list[float]:
    """Softmax of the log likelihoods at the estimates; a failed estimate gets nothing."""
    if solved is None:
        return []
    known = {h.association: h.log_likelihood for h in solved}
    logs = np.array([-np.inf if (v := known[each]) is None else v for each in candidates])
    return softmax(logs).tolist() if np.isfinite(logs).any() else []


def _probabilities(candidates: list[Association], posterior: Posterior | None) -> list[float]:
    """Probabilities in the order of the candidates; those not listed have none."""
    known = {h.association: h.probability for h in posterior or ()}
    return [known.get(each, 0.0) for each in candidates] if known else []


def _rank(ranking: Ranking | None, truth: Association) -> int | None:
    listed = [h.association for h in ranking or ()]
    return listed.index(truth) + 1 if truth in listed else None


def _attempt(call: Callable[[], T]) -> T | None:
    """None where the library refuses the scene: a scorer that gives nothing has failed it."""
    try:
        return call()
    except MhtSlamError:
        return None


def _rounded(p: float) -> float:
    return float(f"{p:.{_DIGITS}g}")
