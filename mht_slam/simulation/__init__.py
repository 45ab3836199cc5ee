"""Worlds, trajectories and sensors: scenes whose true association is known."""
