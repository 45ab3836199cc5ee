"""How far a landmark of the map is what it seems, by what became of the run's other landmarks."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from mht_slam.arrays import IntArray
from mht_slam.association import MISSED
from mht_slam.incremental.associate import log_seen_again
from mht_slam.incremental.branch import Branch
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.history import History
from mht_slam.incremental.past import Committed

RECORD = 100
"""Scans that are looked back on."""
AGAIN = 5
"""Scans within which a landmark is seen again, or its life has ended."""
BY_ACCIDENT = 0.82
"""How much less often a mistaken landmark is seen again than a real one. With `FEWER` and `LEFT`
chosen on the tuning halves of the two recordings and the three kinds of simulated drives."""
FEWER = 15.0
"""Before anything is seen, one landmark in `FEWER` + 1 is mistaken: a Beta(1, `FEWER`) prior."""
LEFT = 2.0
"""Detections that a mistaken landmark leaves alone: it has taken the mates of two others."""
SUREST = 0.99
"""The greatest chance of being seen again: what hides landmarks is not in the model."""
SHARES = (np.arange(200) + 0.5) / 200.0
"""Shares of mistaken landmarks over which their posterior is summed."""


def trusted(
    owners: Sequence[dict[int, float]],
    history: History,
    past: Committed,
    best: Branch,
    config: SlamConfig,
) -> list[dict[int, float]]:
    """Return probabilities of owners that allow for mistakes in what is settled.

    A landmark may have been put together from detections of several things. A detection then
    belongs to it in the books only. Let e be the share of such landmarks, at their second
    detection, g the chance that the model gives a real one to be seen again, and h = .82 g that of
    a mistaken one, by accident. After n detections the odds of a mistake are, by Bayes' rule,

        e / (1 - e) (h / g)^(n - 1),

    this scan's included, and those of a detection left alone that belongs to one of the map
    2 e / (1 - e). Each probability is multiplied by that of no mistake. What is then missing to 1
    is the chance that the detection belongs to something that is not listed.

    Nobody states e: it is read off the run's own record (`share_mistaken`). Where the hypotheses
    kept are all wrong, the landmarks that they make up do not live.

    Parameters
    ----------
    owners : for each detection of the newest scan the probability of each landmark, -1 for none.
    best : the best hypothesis, which reads the record's open scans.

    Source: docs/incremental.md; an empirical prior in the sense of H. Robbins, "An Empirical Bayes
    Approach to Statistics", 1956.
    """
    record = [
        np.array([history.name(number) for number in owner.tolist()], np.int64)
        for owner in history.owners[-RECORD:]
    ]
    record += best.owners[:-1]
    if not any(map(len, record)):  # nothing was seen that the detections could belong to
        return list(owners)
    again = chance_seen_again(config)
    share = share_mistaken(lives(record), again)
    odds = share / (1.0 - share)
    counts = Counter(number for owner in best.owners[:-1] for number in owner.tolist())
    counts.update(dict(zip(past.ids.tolist(), past.sightings.tolist(), strict=True)))

    def right(number: int) -> float:
        if number == MISSED:
            return 1.0 / (1.0 + LEFT * odds)
        return 1.0 / (1.0 + odds * BY_ACCIDENT ** max(counts[number] - 1, 0))

    return [{number: p * right(number) for number, p in some.items()} for some in owners]


def chance_seen_again(config: SlamConfig) -> float:
    """Chance that a landmark just seen is seen again within `AGAIN` scans, by the model."""
    model = config.observation_model
    chance = model.detection_probability
    assert chance is not None  # noqa: S101 - checked by the configuration
    gaps = [
        math.exp(log_seen_again(chance, model.stay_probability, config.return_probability, gap))
        for gap in range(1, AGAIN + 1)
    ]
    return min(sum(gaps), SUREST)


def lives(record: Sequence[IntArray]) -> list[tuple[int, bool]]:
    """Return, for each landmark of two detections or more, how it went on after the second.

    How often it was seen again, each time within `AGAIN` scans, and whether it then was not: the
    last ones of the record may go on.

    Parameters
    ----------
    record : the landmark of each detection, -1 for none, scan by scan.
    """
    seen: dict[int, list[int]] = {}
    for scan, owner in enumerate(record):
        for number in owner.tolist():
            if number != MISSED:
                seen.setdefault(number, []).append(scan)
    found = []
    for scans in seen.values():
        if len(scans) < 2:
            continue
        gaps = np.diff(scans[1:])
        long = np.flatnonzero(gaps > AGAIN)
        ended = len(long) > 0 or scans[-1] + AGAIN < len(record)
        found.append((int(long[0]) if len(long) else len(gaps), ended))
    return found


def share_mistaken(found: Sequence[tuple[int, bool]], again: float) -> float:
    """Return the mean of the posterior of the share e of mistaken landmarks, given their lives.

        p(e) ~ (1 - e)^14 prod [(1 - e) g^k (1 - g)^d + e h^k (1 - h)^d],

    k and d (0 or 1) of `lives`, g = `again`, h = `BY_ACCIDENT` g.
    """
    log_posterior = (FEWER - 1.0) * np.log1p(-SHARES)
    if found:
        times, ended = np.array(found, np.float64).T
        ratio = BY_ACCIDENT**times * ((1.0 - BY_ACCIDENT * again) / (1.0 - again)) ** ended
        # Divided by the likelihood of a real one, which does not depend on e.
        log_posterior += np.log1p(SHARES * (ratio[:, None] - 1.0)).sum(axis=0)
    weights = np.exp(log_posterior - log_posterior.max())
    return float((weights * SHARES).sum() / weights.sum())
