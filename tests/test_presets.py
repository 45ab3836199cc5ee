"""A preset states everything that a run with misses and false alarms needs."""

import numpy as np
import pytest

from mht_slam import presets
from mht_slam.simulation import simulate_scene

MODELS = [presets.panoramic_robot(), presets.forward_camera(), presets.laser()]


@pytest.mark.parametrize("model", MODELS, ids=["panoramic_robot", "forward_camera", "laser"])
def test_a_preset_weighs_associations_of_every_size_and_can_be_simulated(model):
    assert model.compares_sizes
    assert model.motion == "smooth"
    assert 0.0 < model.stay_probability < 1.0
    scene = simulate_scene("model", None, np.random.default_rng(0), model=model, n_scans=4)
    assert len(scene.run) == 4


def test_only_the_panoramic_robot_sees_behind_itself():
    views = [np.rad2deg(model.field_of_view) for model in MODELS]
    assert views == pytest.approx([360.0, 110.0, 182.0])
