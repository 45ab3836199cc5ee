"""Between its knots a table says what integrating there would."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from mht_slam import ObservationModel
from mht_slam.evidence.cells import Cells
from mht_slam.evidence.cluster_integral import log_cluster_integrals
from mht_slam.evidence.cluster_table import DROP_SCALE, TOLERANCE, ClusterTable, tabulate
from mht_slam.simulation import Scene, simulate_scene

WITHIN = 20.0


def scene_and_table(kind: Any, n: int, sigma_deg: float) -> tuple[Scene, ClusterTable, float]:
    sigma = math.radians(sigma_deg)
    scene = simulate_scene(kind, n, np.random.default_rng([n, int(10 * sigma_deg)]), sigma=sigma)
    entries = np.array(list(itertools.product(range(n), repeat=3)))
    sigmas = tuple(np.full(n, sigma) for _ in range(3))
    return scene, tabulate(scene.scans, sigmas, ObservationModel(sigma=sigma), entries), sigma


@pytest.mark.parametrize("sigma_deg", [0.1, 1.0, 7.0])
@pytest.mark.parametrize("kind", ["annulus", "one_sided"])
def test_a_table_is_its_clusters_integrals(kind: str, sigma_deg: float) -> None:
    scene, table, sigma = scene_and_table(kind, 3, sigma_deg)
    everything = np.arange(table.n_clusters)
    owner = np.repeat(everything, 12)
    # Where each cluster's integral is within `WITHIN` nats of its top, so that bumps are met.
    log_ratios = np.empty((table.n_clusters, 12))
    for c in everything:
        own = slice(table.first_knot[c], table.first_knot[c + 1])
        high = table.knots[own][table.values[own] > table.values[own].max() - WITHIN]
        log_ratios[c] = np.random.default_rng(c).uniform(high[0], high[-1] + 1e-9, 12)
    found = np.array(
        [table.at(np.array([c]), log_ratios[c])[0] for c in everything], dtype=np.float64
    )
    ratio = np.exp(log_ratios.ravel())
    along = np.stack([0.0 * ratio, 1.0 + 0.0 * ratio, 1.0 + ratio], axis=1)
    rays = np.stack([scene.scans[k].bearings[table.entries[owner, k]] for k in range(3)], axis=1)
    cells = Cells(along, rays, np.full(rays.shape, sigma), np.ones(rays.shape, dtype=bool))
    expected = log_cluster_integrals(cells, (0.5, 0.0), 30.0).reshape(found.shape)
    weighed = expected - 0.5 * log_ratios**2  # the step prior is standard normal
    drop = weighed.max() - weighed
    tolerance = TOLERANCE * (1.0 + (drop / DROP_SCALE) ** 2)
    assert (np.abs(found - expected) <= tolerance)[drop < 3.0 * WITHIN].all()


def test_a_hopeless_neighbour_never_lifts_a_cluster_above_its_knots() -> None:
    _, table, _ = scene_and_table("corridor", 4, 1.0)
    grid = np.linspace(-7.9, 7.9, 4001)
    for c in range(table.n_clusters):
        own = slice(table.first_knot[c], table.first_knot[c + 1])
        top = table.values[own].max()
        if top > table.values.max() - 300.0:
            assert table.at(np.array([c]), grid).max() < top + 1.0


def test_every_cluster_has_the_same_reach() -> None:
    _, table, _ = scene_and_table("annulus", 3, 1.0)
    firsts, lasts = table.knots[table.first_knot[:-1]], table.knots[table.first_knot[1:] - 1]
    assert set(firsts) == {table.reach[0]} and set(lasts) == {table.reach[1]}
    assert (np.diff(table.knots)[table.owner[1:] == table.owner[:-1]] > 0.0).all()
