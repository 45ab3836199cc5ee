"""Peer: hypothesis maps compared by graph matching, in the manner of Spero.

Written from the description of the idea, not from their code: a map is a graph of landmarks with
their distances on its edges, and two maps show the same place when their graphs match. The measure
of a match below is ours.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, permutations

import numpy as np
from peer_registry import peer

from mht_slam import Association, StraightRun
from mht_slam.arrays import FloatArray
from mht_slam.evaluation.bench.case import Assumptions
from mht_slam.measurements import wrap_angle

GATE = 3.0
"""Standard deviations by which two rays of one landmark may diverge."""


@peer('map graphs, "in the manner of Spero"')
def map_graphs(run: StraightRun, assumptions: Assumptions) -> Iterator[tuple[Association, float]]:
    """Score each pair of maps, from (O1, O2) and from (O2, O3), by how well their graphs match.

    Vertices are the landmarks, named by their detections at O2, and O2 itself; edges carry the
    logarithms of their distances. Each map has a unit of its own, the step between its two scans,
    so that the edges of a match differ by one constant: the score is minus the standard deviation
    of the differences. Rays that noise may have made diverge meet far out, where their parallax
    would be one sigma; pairings whose rays diverge more, or lie on different sides of the path,
    make no map and are left out.
    """
    first, second, third = (scan.bearings for scan in run.scans)
    sigma = assumptions.model.sigma
    before = _maps(first, second, sigma)
    # Seen in a mirror, O3 comes before O2.
    after = _maps(wrap_angle(np.pi - third), wrap_angle(np.pi - second), sigma)
    for first_order, edges in before:
        for third_order, later_edges in after:
            table = np.column_stack([first_order, np.arange(len(second)), third_order])
            yield Association(table, run.n_detections), -float(np.std(edges - later_edges))


def _maps(start: FloatArray, end: FloatArray, sigma: float) -> list[tuple[list[int], FloatArray]]:
    """Pairings of two scans that make a map: start detection of each end detection, and edges.

    The start is at the origin and the end at (1, 0), where the graph has a vertex, too.
    """
    maps = []
    for order in permutations(range(len(start))):
        a, b = start[list(order)], end
        side = np.sign(a)
        parallax = side * (b - a)
        if (side == np.sign(b)).all() and (parallax > -GATE * np.sqrt(2.0) * sigma).all():
            along = side * np.sin(b) / np.sin(np.maximum(parallax, sigma))
            places = (along * np.exp(1j * a)).tolist()
            edges = [abs(p - q) for p, q in combinations([1.0 + 0.0j, *places], 2)]
            maps.append((list(order), np.log(edges)))
    return maps
