"""The whole chain: pictures of the paper's scene to bearings to the right association."""

from __future__ import annotations

import math

import numpy as np
import pytest

import mht_slam as ms
from mht_slam.measurements import wrap_angle
from mht_slam.simulation.panorama import View, cones_at, render_panorama, render_ring
from mht_slam.simulation.paper_scene import LANDMARKS, OBSERVATION_POINTS, SEEN
from mht_slam.simulation.sensors import bearings_and_ranges
from mht_slam.vision import PanoramaCamera, Ring, detect_cones

CONES = np.array([LANDMARKS[name] for name in SEEN])
RING = Ring(245.0, 250.0, 100.0, 240.0)


@pytest.mark.parametrize(
    "camera",
    [
        PanoramaCamera(),
        PanoramaCamera(mounting_angle=2.0, direction="counter-clockwise"),
        PanoramaCamera(mounting_angle=-1.0, ring=RING),
    ],
    ids=["panorama", "mirrored panorama", "ring"],
)
def test_pictures_of_the_papers_scene_end_in_the_right_association(camera: PanoramaCamera) -> None:
    rng = np.random.default_rng(5)
    scans, labels = [], []
    for x, y in OBSERVATION_POINTS.tolist():
        pose = np.array([x, y, 0.0])
        if camera.ring is None:
            picture = render_panorama(pose, cones_at(CONES), rng, camera=camera)
        else:
            # Through a mirror the horizon has few pixels: look at little above and below it.
            narrow = View(highest=math.radians(5.0), lowest=math.radians(-10.0))
            picture = render_ring(pose, cones_at(CONES), rng, camera=camera, view=narrow)
        scan = detect_cones(picture, camera).scan
        true, _ = bearings_and_ranges(pose, CONES)
        apart = np.abs(wrap_angle(scan.bearings[:, None] - true))
        assert apart.min(axis=1).max() < math.radians(0.25)
        scans.append(scan)
        labels.append(apart.argmin(axis=1).tolist())
    truth = ms.Association.from_labels(labels)
    solution = ms.solve(ms.StraightRun(scans), epsilon=math.radians(1.0), sigma=math.radians(0.5))
    best = solution.posterior[0]
    assert best.association == truth
    assert best.probability > 0.99
    metres = OBSERVATION_POINTS[1, 0]
    assert best.landmarks is not None
    found = metres * best.landmarks
    for place in CONES:
        assert np.hypot(*(found - place).T).min() < 0.3
