"""Readers of public recordings and of our own scan files."""

from mht_slam.datasets.dlr import DlrRecording as DlrRecording
from mht_slam.datasets.dlr import read_dlr as read_dlr
from mht_slam.datasets.dlr import read_map_circles as read_map_circles
from mht_slam.datasets.dlr import read_observations as read_observations
from mht_slam.datasets.dlr import read_reference_landmarks as read_reference_landmarks
from mht_slam.datasets.dlr import read_reference_poses as read_reference_poses
from mht_slam.datasets.dlr_runs import all_scan_runs as all_scan_runs
from mht_slam.datasets.dlr_runs import labelled_run as labelled_run
from mht_slam.datasets.dlr_runs import relaxed_runs as relaxed_runs
from mht_slam.datasets.dlr_runs import three_scan_runs as three_scan_runs
from mht_slam.datasets.dlr_segments import Segment as Segment
from mht_slam.datasets.drive import Drive as Drive
from mht_slam.datasets.drive import windows as windows
from mht_slam.datasets.drive_car_park import car_park_drive as car_park_drive
from mht_slam.datasets.drive_dlr import dlr_drive as dlr_drive
from mht_slam.datasets.drive_mrclam import mrclam_drive as mrclam_drive
from mht_slam.datasets.drive_victoria_park import victoria_park_drive as victoria_park_drive
from mht_slam.datasets.drive_victoria_park import victoria_park_windows as victoria_park_windows
from mht_slam.datasets.labelled_runs import LabelledRun as LabelledRun
from mht_slam.datasets.location import data_folder as data_folder
from mht_slam.datasets.scan_files import ScanFile as ScanFile
from mht_slam.datasets.scan_files import read_scans as read_scans
from mht_slam.datasets.scan_files import write_scans as write_scans
from mht_slam.datasets.victoria_park import VictoriaParkRecording as VictoriaParkRecording
from mht_slam.datasets.victoria_park import read_victoria_park as read_victoria_park
from mht_slam.datasets.victoria_park_runs import straight_window_runs as straight_window_runs
