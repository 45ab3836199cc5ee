"""The whole run as one graph says the same as a window that holds the whole run."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import mht_slam as ms
from mht_slam.incremental.past import points_of
from mht_slam.incremental.slam_map import CONFIRMED
from mht_slam.measurements import wrap_angle

from .drives import config_for, fed, ordinary, passing


@pytest.mark.parametrize("dof", [None, 4.0])
def test_while_all_scans_are_open_the_graph_is_the_window(dof: float | None) -> None:
    """They differ by the landmark prior and its coordinates: where ranges are known, by little."""
    rng = np.random.default_rng(0)
    scans = [
        ms.BearingScan(
            scan.bearings + math.radians(0.5) * rng.normal(size=len(scan)), odometry=scan.odometry
        )
        for scan in passing("loop", 16)[0]
    ]
    config = config_for("loop", lag=50, hypotheses=3)
    config = replace(config, model=replace(config.model, bearing_dof=dof))
    slam = fed(config, scans)
    best = slam._branches[0]
    deviations = np.sqrt(
        [np.diag(covariance) for covariance in slam.posterior[0].pose_covariances]  # type: ignore[union-attr]
    )
    off = slam.trajectory - best.poses[2:]
    off[:, 2] = wrap_angle(off[:, 2])
    assert (np.abs(off) <= 0.2 * deviations + 1e-3).all()
    whole = slam.whole_run
    points = dict(zip(best.ids.tolist(), points_of(best.places, best.centres), strict=True))
    seen = {n: sum(n in owner.tolist() for owner in best.owners) for n in points}
    assert dict(zip(whole.numbers.tolist(), whole.counts.tolist(), strict=True)) == seen
    covariances = slam.map.covariances
    for number, point, covariance in zip(
        slam.map.numbers.tolist(), slam.map.points, covariances, strict=True
    ):
        difference = point - points[number]
        assert difference @ np.linalg.solve(covariance, difference) < 0.3**2


def test_the_map_has_the_rows_of_the_association() -> None:
    slam = fed(config_for("loop", lag=4), ordinary("loop", 32).scans)
    found, association = slam.map, slam.association
    assert len(found) == association.n_landmarks
    np.testing.assert_array_equal(found.sightings, (association.table >= 0).sum(axis=1))
    np.testing.assert_array_equal(found.confirmed, found.sightings >= CONFIRMED)
    np.testing.assert_array_equal(np.asarray(found), found.points)
    assert len(set(found.numbers.tolist())) == len(found)
    assert found.covariances.shape == (len(found), 2, 2)
    assert (np.linalg.eigvalsh(found.covariances) > 0.0).all()
    # A row's bearings point at its landmark, from the smoothed trajectory.
    scans = slam._history.bearings
    for row, point in zip(association.table, found.points, strict=True):
        for scan in np.flatnonzero(row >= 0):
            x, y, theta = slam.trajectory[scan]
            seen = np.arctan2(point[1] - y, point[0] - x) - theta - scans[scan][row[scan]]
            assert abs(np.angle(np.exp(1j * seen))) < 0.1
