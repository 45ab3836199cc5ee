"""How far a landmark is what it seems, against laws that are drawn from and sums written out."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

import mht_slam as ms
from mht_slam.arrays import IntArray
from mht_slam.incremental import doubts
from mht_slam.incremental.doubts import chance_seen_again, lives, share_mistaken, trusted
from mht_slam.incremental.live import marginal_owners

from .drives import config_for, fed, ordinary

LONG = ordinary("loop", 40, n_scans=40)


@pytest.fixture(scope="module")
def slam() -> ms.MultiHypothesisSlam:
    return fed(config_for("loop", lag=6), LONG.scans)


def _trusted(
    slam: ms.MultiHypothesisSlam, owners: list[dict[int, float]]
) -> list[dict[int, float]]:
    return trusted(owners, slam._history, slam.committed, slam._branches[0], slam.config)


def _record(*scans: list[int]) -> list[IntArray]:
    return [np.array(scan, np.int64) for scan in scans]


def test_a_life_counts_the_sightings_after_the_second_until_it_ends() -> None:
    nothing = [[-1]] * doubts.AGAIN
    assert lives(_record([7], [7], [-1, 7], [7])) == [(2, False)]
    assert lives(_record([7], [7], [7], *nothing[1:])) == [(1, False)]
    assert lives(_record([7], [7], [7], *nothing)) == [(1, True)]
    # Back after it has been given up for gone: the first part was its life.
    assert lives(_record([7], [7], [7], *nothing, [7], [7])) == [(1, True)]
    # The gap before the second detection is no part of it, and one detection is no landmark.
    assert lives(_record([7], *nothing, [7], [7], [3])) == [(1, False)]
    assert lives([]) == []


def _drawn(
    share: float, again: float, count: int, rng: np.random.Generator
) -> list[tuple[int, bool]]:
    found = []
    for _ in range(count):
        chance = again * doubts.BY_ACCIDENT if rng.random() < share else again
        open_for = int(rng.integers(1, 40))
        times = int(rng.geometric(1.0 - chance)) - 1
        found.append((min(times, open_for), times < open_for))
    return found


@pytest.mark.parametrize("share", [0.02, 0.3, 0.8])
def test_the_share_of_mistakes_is_found_in_lives_drawn_with_it(share: float) -> None:
    found = _drawn(share, 0.97, 4000, np.random.default_rng(3))
    assert share_mistaken(found, 0.97) == pytest.approx(share, abs=0.05)


def test_the_share_of_mistakes_is_the_mean_of_its_posterior() -> None:
    again = 0.9
    rare = again * doubts.BY_ACCIDENT
    found = _drawn(0.4, again, 12, np.random.default_rng(8))

    def weight(share: float) -> float:
        total = (1.0 - share) ** (doubts.FEWER - 1.0)
        for k, ended in found:
            real = again**k * (1.0 - again if ended else 1.0)
            mistaken = rare**k * (1.0 - rare if ended else 1.0)
            total *= (1.0 - share) * real + share * mistaken
        return float(total)

    mass = quad(weight, 0.0, 1.0, epsabs=0.0)[0]
    mean = quad(lambda share: share * weight(share), 0.0, 1.0, epsabs=0.0)[0] / mass
    assert share_mistaken(found, again) == pytest.approx(mean, rel=1e-3)
    assert share_mistaken([], again) == pytest.approx(1.0 / (doubts.FEWER + 1.0), rel=1e-3)


def test_a_landmark_is_seen_again_as_often_as_its_chain_says() -> None:
    config = config_for("loop")
    model, rng = config.observation_model, np.random.default_rng(1)
    chance = model.detection_probability
    assert chance is not None
    seen, n = 0, 40_000
    visible = np.ones(n, np.bool_)
    yet = np.zeros(n, np.bool_)
    for _ in range(doubts.AGAIN):
        stays = np.where(visible, model.stay_probability, config.return_probability)
        visible = rng.random(n) < stays
        yet |= visible & (rng.random(n) < chance)
    seen = int(yet.sum())
    assert chance_seen_again(config) == pytest.approx(seen / n, abs=4.0 * math.sqrt(0.25 / n))
    sure = replace(model, detection_probability=1.0, stay_probability=1.0)
    assert chance_seen_again(ms.SlamConfig(model=sure)) < 1.0


def test_odds_of_a_mistake_fall_with_every_detection(slam: ms.MultiHypothesisSlam) -> None:
    best = slam._branches[0]
    open_scans = [number for owner in best.owners[:-1] for number in owner.tolist()]
    committed = dict(
        zip(slam.committed.ids.tolist(), slam.committed.sightings.tolist(), strict=True)
    )
    record = [np.array([slam._history.name(n) for n in o.tolist()]) for o in slam._history.owners]
    share = share_mistaken(lives([*record, *best.owners[:-1]]), chance_seen_again(slam.config))
    unheard_of = 1 << 40
    numbers = [-1, unheard_of, *committed]
    found = _trusted(slam, [{number: 0.5} for number in numbers])
    for number, marginal in zip(numbers, found, strict=True):
        n = committed.get(number, 0) + open_scans.count(number)
        odds = share / (1.0 - share) * doubts.BY_ACCIDENT ** max(n - 1, 0)
        if number == -1:
            odds = doubts.LEFT * share / (1.0 - share)
        assert marginal == {number: pytest.approx(0.5 / (1.0 + odds), rel=1e-9)}
    assert len(committed) > 5


def test_marginal_associations_leave_room_for_mistakes(slam: ms.MultiHypothesisSlam) -> None:
    newest = len(slam._window.bearings) - 1
    raw = marginal_owners(slam._branches, newest)
    assert slam.marginal_associations == _trusted(slam, raw)
    for stated, sure in zip(slam.marginal_associations, raw, strict=True):
        assert stated.keys() == sure.keys()
        assert all(0.0 < stated[number] < sure[number] for number in sure)


def test_before_anything_is_seen_there_is_nothing_to_be_mistaken_about() -> None:
    scan = ms.BearingScan([0.3, -1.0])
    for before in ([], [ms.BearingScan([])] * 4):
        slam = fed(config_for("smooth"), [*before, scan])
        assert slam.marginal_associations == [{-1: pytest.approx(1.0, abs=1e-9)}] * 2
    slam = fed(config_for("smooth"), [scan, ms.BearingScan([2.0])])
    assert sum(slam.marginal_associations[0].values()) < 0.99


def test_a_landmark_that_a_loop_has_renamed_has_one_life(slam: ms.MultiHypothesisSlam) -> None:
    old, new = 1 << 40, 1 << 41
    history = replace(slam._history, owners=_record([old], [old], [-1], [new], [new]))
    best = replace(slam._branches[0], owners=(np.empty(0, np.int64),) * 12)
    one_life = replace(history, renamed={new: old})
    two = trusted([{old: 1.0}], history, slam.committed, best, slam.config)
    one = trusted([{old: 1.0}], one_life, slam.committed, best, slam.config)
    again = chance_seen_again(slam.config)
    assert one[0][old] / two[0][old] == pytest.approx(
        (1.0 + _odds([(0, True), (0, True)], again)) / (1.0 + _odds([(2, True)], again)), rel=1e-9
    )


def _odds(found: list[tuple[int, bool]], again: float) -> float:
    share = share_mistaken(found, again)
    return share / (1.0 - share)


def test_maps_made_up_of_false_alarms_are_doubted_more_than_true_ones(
    slam: ms.MultiHypothesisSlam,
) -> None:
    rng = np.random.default_rng(2)
    scans = [
        ms.BearingScan(rng.uniform(-math.pi, math.pi, len(scan)), odometry=scan.odometry)
        for scan in LONG.scans
    ]
    made_up = fed(slam.config, scans)
    one = [{-1: 1.0}]
    assert _trusted(made_up, one)[0][-1] < 0.5
    assert _trusted(slam, one)[0][-1] > 0.8
