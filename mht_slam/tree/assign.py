"""The best matchings of a scan's detections, over all proposed motions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mht_slam.arrays import FloatArray
from mht_slam.matchings import Matches, best_matching, ranked_matchings


@dataclass(frozen=True)
class Candidate:
    """A matching, the proposal at which it does best, and its log score there.

    Rows of the matches count landmarks, then earlier single detections; columns are detections.
    """

    matches: Matches
    proposal: int
    log_gain: float


def best_matchings(
    gains: FloatArray, offsets: FloatArray, *, drop: float, n_ranked: int, depth: int
) -> list[Candidate]:
    """Return matchings worth solving, the best first.

    Parameters
    ----------
    gains : (G, r, d) log gains of a match over no match, for each proposal; not finite: no match.
    offsets : (G,) log score of each proposal without any match; not finite: no proposal.
    drop : matchings this many nats below the best are left out.
    n_ranked, depth : at so many of the best proposals the best `depth` matchings are found; at the
        others the best one.

    Given the pose, matches are independent but for sharing, so a proposal's best matching is a
    linear assignment (docs/method.md, section 5). A matching found at several proposals counts
    once, where it does best.
    """
    usable = np.isfinite(offsets)
    gains, offsets = gains[usable], offsets[usable]
    places = np.flatnonzero(usable)
    positive = np.where(np.isfinite(gains), np.maximum(gains, 0.0), 0.0)
    ceiling = offsets + positive.max(axis=1, initial=0.0).sum(axis=1)
    found: dict[Matches, Candidate] = {}
    best = -np.inf
    tops: list[tuple[float, int]] = []
    for g in np.argsort(-ceiling, kind="stable").tolist():
        if ceiling[g] < best - drop:
            break
        matches, gain = best_matching(positive[g])
        total = float(offsets[g]) + gain
        best = max(best, total)
        tops.append((-total, g))
        _keep(found, Candidate(matches, int(places[g]), total))
    for _, g in sorted(tops)[:n_ranked]:
        for count, (matches, gain) in enumerate(ranked_matchings(positive[g]), start=1):
            total = float(offsets[g]) + gain
            if count > depth or total < best - drop:
                break
            _keep(found, Candidate(matches, int(places[g]), total))
    ordered = sorted(found.values(), key=lambda c: (-c.log_gain, c.matches))
    return [c for c in ordered if c.log_gain >= best - drop]


def _keep(found: dict[Matches, Candidate], candidate: Candidate) -> None:
    known = found.get(candidate.matches)
    if known is None or candidate.log_gain > known.log_gain:
        found[candidate.matches] = candidate
