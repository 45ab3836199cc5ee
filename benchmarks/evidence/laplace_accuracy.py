"""How far plain Laplace evidence is from the integral, per kind of scene: a table.

    python benchmarks/evidence/laplace_accuracy.py --scenes 20 --seed 0

For every scene all (n!)^2 full associations are refined twice, with the default evidence, which
tests hold to a dense integration of the same model, and with plain Laplace. Compared are the
hypotheses within eight nats of the best, each relative to the best.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from collections.abc import Sequence
from typing import get_args

import numpy as np

from mht_slam import Association, ObservationModel, refine
from mht_slam.simulation import Scene, simulate_scene
from mht_slam.simulation.scenes import SceneKind

WITHIN = 8.0
TOLERANCE = 0.05
KINDS: tuple[SceneKind, ...] = ("annulus", "one_sided", "corridor", "model")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one row per kind of scene; progress goes to stderr."""
    options = _parse(arguments)
    model = ObservationModel(
        sigma=math.radians(options.sigma_deg), heading_sigma=math.radians(options.heading_sigma_deg)
    )
    print(f"n = {options.landmarks}, {options.scenes} scenes a kind, seed {options.seed}")
    print(f"model: {model.describe()}")
    print("relative to the best hypothesis, nats; total variation of the two posteriors")
    print(f"{'kind':<10} {'pairs':>6} {'median':>7} {'90 %':>7} {'max':>7} {'<=.05':>6}", end="")
    print(f" {'same best':>9} {'mean TV':>8}")
    for kind in options.kinds:
        errors: list[float] = []
        same_best, variation = 0, 0.0
        for number in range(options.scenes):
            print(f"\r{kind} {number + 1}/{options.scenes} ", end="", file=sys.stderr, flush=True)
            rng = np.random.default_rng([options.seed, number])
            scene = _simulate(kind, options.landmarks, model, rng)
            scene_errors, agrees, distance = _compare(scene, model)
            errors += scene_errors
            same_best += agrees
            variation += distance / options.scenes
        print("\r", end="", file=sys.stderr)
        sizes = np.array(errors) if errors else np.array([math.nan])
        print(
            f"{kind:<10} {len(errors):>6} {np.median(sizes):>7.3f} {np.quantile(sizes, 0.9):>7.3f} "
            f"{sizes.max():>7.3f} {(sizes <= TOLERANCE).mean():>6.2f} "
            f"{same_best / options.scenes:>9.2f} {variation:>8.4f}",
            flush=True,
        )


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--scenes", type=int, default=20, help="scenes of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--landmarks", type=int, default=3, help="n; (n!)^2 associations a scene")
    parser.add_argument("--sigma-deg", type=float, default=1.0)
    parser.add_argument("--heading-sigma-deg", type=float, default=0.0)
    parser.add_argument("--kinds", nargs="+", choices=get_args(SceneKind), default=KINDS)
    return parser.parse_args(arguments)


def _simulate(kind: SceneKind, n: int, model: ObservationModel, rng: np.random.Generator) -> Scene:
    if kind == "model":
        return simulate_scene(kind, n, rng, model=model)
    return simulate_scene(kind, n, rng, sigma=model.sigma, heading_sigma=model.heading_sigma)


def _compare(scene: Scene, model: ObservationModel) -> tuple[list[float], bool, float]:
    """Errors of Laplace, whether it has the same best, and total variation."""
    n = scene.truth.n_landmarks
    orders = list(itertools.permutations(range(n)))
    candidates = [
        Association(np.column_stack([np.arange(n), second, third]), (n, n, n))
        for second, third in itertools.product(orders, orders)
    ]
    marginal = refine(scene.run, candidates, model=model)
    laplace = {
        h.association: h for h in refine(scene.run, candidates, model=model, evidence="laplace")
    }
    best = marginal[0]
    offset = laplace[best.association].log_evidence - best.log_evidence
    errors = [
        abs(laplace[h.association].log_evidence - h.log_evidence - offset)
        for h in marginal[1:]
        if h.log_evidence > best.log_evidence - WITHIN
    ]
    distance = 0.5 * sum(abs(h.probability - laplace[h.association].probability) for h in marginal)
    top = max(laplace.values(), key=lambda h: h.log_evidence).association
    return errors, top == best.association, distance


if __name__ == "__main__":
    main()
