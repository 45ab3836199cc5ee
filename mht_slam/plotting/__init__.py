"""Matplotlib figures of cells, maps and comparisons.

Every function takes data and returns a `matplotlib.figure.Figure`; none touches pyplot, a display
or a file. The caller saves: ``figure.savefig("cells.png")``.
"""

from mht_slam.plotting.frames import TrueLayout as TrueLayout
from mht_slam.plotting.landmark_map import landmark_map_figure as landmark_map_figure
from mht_slam.plotting.pair_cells import cells_figure as cells_figure
from mht_slam.plotting.run_map import run_map_figure as run_map_figure
from mht_slam.plotting.score_comparison import comparison_figure as comparison_figure
from mht_slam.plotting.slam_animation import slam_animation as slam_animation
from mht_slam.plotting.slam_frames import FrameRecorder as FrameRecorder
from mht_slam.plotting.slam_map import slam_map_figure as slam_map_figure
from mht_slam.plotting.slam_rerun import RerunView as RerunView
from mht_slam.plotting.tracks import tracks_figure as tracks_figure
from mht_slam.plotting.zones import order_changes_figure as order_changes_figure
from mht_slam.plotting.zones import zones_figure as zones_figure
