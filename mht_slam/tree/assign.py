"""The best matchings of a scan's detections, over all proposed motions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from mht_slam.arrays import FloatArray

Matches = tuple[tuple[int, int], ...]
"""(row, detection) pairs, sorted; rows count landmarks, then earlier single detections."""


@dataclass(frozen=True)
class Candidate:
    """A matching, the proposal at which it does best, and its log score there."""

    matches: Matches
    proposal: int
    log_gain: float


def best_matchings(
    gains: FloatArray, offsets: FloatArray, *, drop: float, alternatives: int
) -> list[Candidate]:
    """Return matchings worth solving, the best first.

    Parameters
    ----------
    gains : (G, r, d) log gains of a match over no match, for each proposal.
    offsets : (G,) log score of each proposal without any match.
    drop : matchings this many nats below the best are left out.
    alternatives : at how many of the best proposals each match of the best matching is forbidden
        in turn, which gives the best matching without it.

    Given the pose, matches are independent but for sharing, so each proposal's best matching is a
    linear assignment (docs/method.md, section 5). A matching found at several proposals counts
    once, where it does best.
    """
    positive = np.maximum(gains, 0.0)
    ceiling = offsets + positive.max(axis=1, initial=0.0).sum(axis=1)
    found: dict[Matches, Candidate] = {}
    best = -np.inf
    scored: list[tuple[float, int, Matches]] = []
    for g in np.argsort(-ceiling, kind="stable").tolist():
        if ceiling[g] < best - drop:
            break
        matches, gain = _assign(positive[g])
        total = float(offsets[g]) + gain
        best = max(best, total)
        scored.append((total, g, matches))
        _keep(found, Candidate(matches, g, total))
    scored.sort(key=lambda entry: (-entry[0], entry[1]))
    for total, g, matches in scored[:alternatives]:
        for row, detection in matches:
            if total - gains[g, row, detection] + 0.0 < best - drop - positive[g].max():
                continue
            without = positive[g].copy()
            without[row, detection] = 0.0
            others, gain = _assign(without)
            _keep(found, Candidate(others, g, float(offsets[g]) + gain))
    ordered = sorted(found.values(), key=lambda c: (-c.log_gain, c.matches))
    return [c for c in ordered if c.log_gain >= best - drop]


def _assign(positive: FloatArray) -> tuple[Matches, float]:
    rows, columns = linear_sum_assignment(positive, maximize=True)
    chosen = [
        (r, c) for r, c in zip(rows.tolist(), columns.tolist(), strict=True) if positive[r, c] > 0.0
    ]
    return tuple(sorted(chosen)), float(positive[rows, columns].sum())


def _keep(found: dict[Matches, Candidate], candidate: Candidate) -> None:
    known = found.get(candidate.matches)
    if known is None or candidate.log_gain > known.log_gain:
        found[candidate.matches] = candidate
