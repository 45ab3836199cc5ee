"""How exact evidence by quadrature is: against a dense integration, and in time. A table.

    python benchmarks/evidence/quadrature_accuracy.py --scenes 2 --seed 0

For every scene the associations of largest evidence are listed; of those within 15 nats of the
first, the first, the last and some between are integrated again, slowly: each landmark over a
dense polar grid in bearing and log range about the second observation point, where nothing but
the grid's density is adapted, and ln r by an equidistant sum. Cells that such a grid cannot
resolve, landmarks much closer to another observation point than to the second, are told by
halving the grid: they are counted, and left out.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Sequence
from typing import get_args

import numpy as np
from scipy.special import logsumexp

from mht_slam import Association, BearingScan, ObservationModel, rank_by_evidence
from mht_slam.arrays import FloatArray
from mht_slam.simulation import Scene, simulate_scene
from mht_slam.simulation.scenes import SceneKind

WITHIN = 15.0
TOLERANCE = 0.005
LISTED = 40
NEGLIGIBLE = 25.0
RESOLVED = 1e-3
KINDS: tuple[SceneKind, ...] = ("annulus", "one_sided", "corridor", "model")
SIGMAS_DEG = (0.1, 1.0, 3.0, 7.0)
N_LANDMARKS = (3, 5, 8)
BEARINGS, RANGES, RATIOS = 97, 800, 25
ZOOMS = 4


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one row per kind, number and sigma; progress goes to stderr."""
    options = _parse(arguments)
    print(
        f"{options.scenes} scenes a row, seed {options.seed}; {options.checked} associations each"
    )
    print(f"model: {ObservationModel(sigma=math.radians(1.0)).describe()}; sigma as in the row")
    print(f"{'kind':<10} {'n':>2} {'sigma':>6} {'checked':>7} {'unresolved':>10}", end="")
    print(f" {'max error':>9} {'median s':>8} {'proven':>6}")
    worst = 0.0
    for kind in options.kinds:
        for n in options.landmarks:
            for sigma_deg in options.sigmas_deg:
                worst = max(worst, _row(kind, n, sigma_deg, options))
    print(f"largest error {worst:.5f} nats, to be below {TOLERANCE}")


def _row(kind: SceneKind, n: int, sigma_deg: float, options: argparse.Namespace) -> float:
    model = ObservationModel(sigma=math.radians(sigma_deg))
    errors: list[float] = []
    times, proven, unresolved = [], 0, 0
    for number in range(options.scenes):
        print(f"\r{kind} {n} {sigma_deg} {number} ", end="", file=sys.stderr, flush=True)
        rng = np.random.default_rng([options.seed, number, n, int(10 * sigma_deg)])
        scene = _simulate(kind, n, model, rng)
        start = time.perf_counter()
        posterior = rank_by_evidence(scene.run, model=model, top_k=LISTED)
        times.append(time.perf_counter() - start)
        proven += bool(posterior.complete)
        near = [h for h in posterior if h.log_evidence > posterior[0].log_evidence - WITHIN]
        places = np.unique(np.linspace(0, len(near) - 1, options.checked).astype(int))
        for place in places.tolist():
            h = near[place]
            dense, uncertain = dense_evidence(scene.scans, h.association, model)
            if uncertain > RESOLVED:
                unresolved += 1
            else:
                errors.append(abs(h.log_evidence - dense))
    print("\r", end="", file=sys.stderr)
    largest = max(errors, default=0.0)
    print(
        f"{kind:<10} {n:>2} {sigma_deg:>6g} {len(errors):>7} {unresolved:>10} {largest:>9.5f} "
        f"{np.median(times):>8.2f} {proven:>3}/{options.scenes}",
        flush=True,
    )
    return largest


def dense_evidence(
    scans: tuple[BearingScan, ...], association: Association, model: ObservationModel
) -> tuple[float, float]:
    """Log evidence of a full association by dense sums, and how much halving the grid changes."""
    rays = np.stack([scans[k].bearings[association.table[:, k]] for k in range(3)], axis=1)
    reach = 7.0 * model.log_step_sigma
    low, high = model.log_step_mean - reach, model.log_step_mean + reach
    for _ in range(12):
        grid = np.linspace(low, high, RATIOS)
        terms = np.array([_log_joint(x, rays, model, 1) for x in grid])
        kept = grid[terms > terms.max() - NEGLIGIBLE]
        step = grid[1] - grid[0]
        if (terms > terms.max() - 4.0).sum() >= 6:
            break
        low, high = kept[0] - step, kept[-1] + step
    counted = grid[terms > terms.max() - 12.0]
    fine = np.array([_log_joint(x, rays, model, 2) for x in counted])
    coarse = terms[terms > terms.max() - 12.0]
    constant = math.log(step)
    value = float(logsumexp(fine)) + constant
    return value, abs(value - float(logsumexp(coarse)) - constant)


def _log_joint(log_ratio: float, rays: FloatArray, model: ObservationModel, density: int) -> float:
    along = np.array([0.0, 1.0, 1.0 + math.exp(log_ratio)])
    deviation = (log_ratio - model.log_step_mean) / model.log_step_sigma
    prior = -0.5 * deviation**2 - math.log(model.log_step_sigma * math.sqrt(2.0 * math.pi))
    return prior + sum(_dense_landmark(along, row, model, density) for row in rays)


def _dense_landmark(
    along: FloatArray, rays: FloatArray, model: ObservationModel, density: int
) -> float:
    """Sum one landmark over bearing and log range about the second observation point."""
    t = np.linspace(-9.0, 9.0, density * (BEARINGS - 1) + 1)[:, None]
    theta = rays[1] + model.sigma * t
    low, high = math.log(1e-5), math.log(8.0 * model.landmark_sigma)
    for zoom in range(ZOOMS + 1):
        log_range = np.linspace(low, high, density * RANGES)
        step = log_range[1] - log_range[0]
        x = along[1] + np.exp(log_range) * np.cos(theta)
        y = np.exp(log_range) * np.sin(theta)
        cx, cy = model.landmark_centre
        value = 2.0 * log_range - 0.5 * t**2
        value = value - 0.5 * ((x - cx) ** 2 + (y - cy) ** 2) / model.landmark_sigma**2
        for point, ray in ((along[0], rays[0]), (along[2], rays[2])):
            off = np.arctan2(y, x - point) - ray
            off = (off + np.pi) % (2.0 * np.pi) - np.pi
            value -= 0.5 * (off / model.sigma) ** 2
        if zoom < ZOOMS:
            profile = value.max(axis=0)
            kept = log_range[profile > profile.max() - 30.0]
            low, high = kept[0] - step, kept[-1] + step
    constant = math.log(step * float(t[1, 0] - t[0, 0])) - 2.5 * math.log(2.0 * math.pi)
    constant -= 2.0 * math.log(model.sigma) + 2.0 * math.log(model.landmark_sigma)
    return float(logsumexp(value)) + constant


def _simulate(kind: SceneKind, n: int, model: ObservationModel, rng: np.random.Generator) -> Scene:
    if kind == "model":
        return simulate_scene(kind, n, rng, model=model)
    return simulate_scene(kind, n, rng, sigma=model.sigma)


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenes", type=int, default=2, help="scenes of each row")
    parser.add_argument("--checked", type=int, default=3, help="associations of each scene")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--landmarks", nargs="+", type=int, default=N_LANDMARKS)
    parser.add_argument("--sigmas-deg", nargs="+", type=float, default=SIGMAS_DEG)
    parser.add_argument("--kinds", nargs="+", choices=get_args(SceneKind), default=KINDS)
    return parser.parse_args(arguments)


if __name__ == "__main__":
    main()
