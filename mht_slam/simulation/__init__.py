"""Worlds, trajectories and sensors: scenes whose true association is known."""

from mht_slam.simulation.drives import OdometryNoise as OdometryNoise
from mht_slam.simulation.drives import simulate_drive as simulate_drive
from mht_slam.simulation.paper_scene import paper_scene as paper_scene
from mht_slam.simulation.scenes import Scene as Scene
from mht_slam.simulation.scenes import observe_scene as observe_scene
from mht_slam.simulation.scenes import simulate_free as simulate_free
from mht_slam.simulation.scenes import simulate_pair as simulate_pair
from mht_slam.simulation.scenes import simulate_scene as simulate_scene
from mht_slam.simulation.sensors import Observation as Observation
from mht_slam.simulation.sensors import Sensor as Sensor
