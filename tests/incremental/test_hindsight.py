"""A run read in hindsight: evidence that only rises, and landmarks that are whole again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import mht_slam as ms
from mht_slam.arrays import IntArray
from mht_slam.incremental.config import SlamConfig
from mht_slam.incremental.hindsight import drawn_anew, in_hindsight
from mht_slam.incremental.history import association_of
from mht_slam.incremental.run_evidence import log_run_evidence
from mht_slam.incremental.whole_run import WholeRun
from mht_slam.simulation import OdometryNoise, simulate_drive

from .drives import config_for, fed, ordinary
from .rows import CONFIG, SIGMA, Row, renamed


def read(row: Row) -> WholeRun:
    return in_hindsight(row.smoothed(), row.smoothed, row.bearings, row.sigmas, CONFIG)


def misread() -> Row:
    """A landmark in three pieces, an exchange and two detections left alone."""
    row = renamed(Row(None, range(0)), 1, range(3))
    row.owners = [np.where((owner == 1) & (k > 7), 77, owner) for k, owner in enumerate(row.owners)]
    row.owners[5][[0, 4]] = row.owners[5][[4, 0]]
    row.owners[9][2] = row.owners[10][3] = -1
    return row


def test_several_mistakes_are_mended_together() -> None:
    found = association_of(read(misread()).owners)[0]
    assert (found.table == np.arange(5)[:, None]).all()


def test_a_run_read_well_stays_as_it_is() -> None:
    row = Row(None, range(0))
    whole = row.smoothed()
    assert in_hindsight(whole, row.smoothed, row.bearings, row.sigmas, CONFIG) is whole


def test_what_cannot_be_smoothed_is_taken_back() -> None:
    row = misread()
    whole = row.smoothed()

    def fails(*_: object) -> WholeRun:
        raise RuntimeError("indeterminate linear system")

    assert in_hindsight(whole, fails, row.bearings, row.sigmas, CONFIG) is whole


def test_what_lowers_the_evidence_is_taken_back() -> None:
    row = misread()
    whole, tried = row.smoothed(), []

    def worse(owners: Sequence[IntArray], _: WholeRun) -> WholeRun:
        tried.append(owners)
        return row.smoothed([np.full_like(owner, -1) for owner in owners])

    assert in_hindsight(whole, worse, row.bearings, row.sigmas, CONFIG) is whole
    assert tried


@pytest.mark.parametrize("kind", ["loop", "smooth"])
@pytest.mark.parametrize("seed", range(3))
def test_the_evidence_of_a_drive_does_not_fall(kind: str, seed: int) -> None:
    slam = fed(config_for(kind), ordinary(kind, seed).scans)  # type: ignore[arg-type]
    history, read_again = slam._history, slam.whole_run
    evidence = log_run_evidence(read_again, history.bearings, history.sigmas, slam.config)
    start = slam._smoothed_from(slam._owners(), read_again)
    assert evidence >= log_run_evidence(start, history.bearings, history.sigmas, slam.config) - 1e-3


def test_a_loop_that_begins_with_mistakes_ends_with_its_landmarks_whole() -> None:
    """Association, map and trajectory are those of the run read again; the past stays as it is."""
    drive = simulate_drive(
        "loop", 20, 100, np.random.default_rng([0, 20, 100]), sigma=SIGMA, odometry=OdometryNoise()
    )
    slam = ms.MultiHypothesisSlam(SlamConfig(motion="odometry", hypotheses=2, start_hypotheses=10))
    for scan in drive.scans:
        slam.update(scan)
    online, _ = association_of(slam._owners())
    found, truth = slam.association, drive.truth()
    assert found.n_landmarks < online.n_landmarks
    assert found.f1(truth) > online.f1(truth)
    assert len(slam.map) == found.n_landmarks
    assert slam.map.sightings.tolist() == (found.table >= 0).sum(axis=1).tolist()


def anew(row: Row, whole: WholeRun, remaps: int = 2) -> WholeRun:
    config = replace(CONFIG, remaps=remaps)
    return drawn_anew(whole, row.smoothed, row.steps, row.bearings, row.sigmas, config)


def shuffled() -> Row:
    """Every scan read at random: a map without one true landmark."""
    row, rng = Row(None, range(0)), np.random.default_rng(1)
    row.owners = [rng.permutation(owner) for owner in row.owners]
    return row


def test_a_map_that_is_wrong_throughout_is_drawn_anew() -> None:
    row = shuffled()
    found = association_of(anew(row, row.smoothed()).owners)[0]
    assert (found.table == np.arange(5)[:, None]).all()


def test_a_map_that_is_right_is_not_replaced() -> None:
    row = Row(None, range(0))
    whole = row.smoothed()
    assert anew(row, whole) is whole


def test_numbers_of_the_map_that_was_there_are_not_used_again() -> None:
    row = shuffled()
    before = {int(number) for owner in row.owners for number in owner}
    assert before.isdisjoint(anew(row, row.smoothed()).numbers.tolist())


@pytest.mark.parametrize("failure", ["smoothing", "evidence"])
def test_maps_that_fail_or_are_worse_leave_the_run(failure: str) -> None:
    row = Row(None, range(0))
    whole, calls = row.smoothed(), []

    def bad(owners: Sequence[IntArray], _: WholeRun) -> WholeRun:
        calls.append(owners)
        if failure == "smoothing":
            raise RuntimeError("indeterminate linear system")
        return row.smoothed([np.full_like(owner, -1) for owner in owners])

    config = replace(CONFIG, remaps=2)
    assert drawn_anew(whole, bad, row.steps, row.bearings, row.sigmas, config) is whole
    assert calls


def test_a_dense_yard_is_drawn_anew_to_more_evidence_and_a_better_map() -> None:
    """Maps drawn anew are asked for, and then never less likely than the run without them."""
    drive = simulate_drive(
        "loop", 20, 30, np.random.default_rng([16, 20, 30]), sigma=SIGMA, odometry=OdometryNoise()
    )
    config = SlamConfig(motion="odometry", hypotheses=2, start_hypotheses=10)
    slam, again = (fed(replace(config, remaps=remaps), drive.scans) for remaps in (0, 3))
    assert again.log_evidence > slam.log_evidence + 10.0
    assert again.association.f1(drive.truth()) > slam.association.f1(drive.truth()) + 0.05
    assert len(again.map) == again.association.n_landmarks
    assert np.isfinite(again.trajectory).all()


@pytest.mark.parametrize("kind", ["loop", "straight", "smooth"])
def test_maps_drawn_anew_never_lower_the_evidence(kind: str) -> None:
    scans = ordinary(kind, 1).scans  # type: ignore[arg-type]
    config = config_for(kind, hypotheses=3)  # type: ignore[arg-type]
    slam, again = (fed(replace(config, remaps=remaps), scans) for remaps in (0, 2))
    assert again.log_evidence >= slam.log_evidence
