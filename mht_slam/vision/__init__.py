"""From panoramas to bearings: unwrapping, colour threshold, components, sub-pixel centroids.

Source: the paper's section 4; docs/method.md, section 7. Reading and colours need scikit-image,
``pip install 'mht-slam[vision]'``; it is imported when first used.
"""

from mht_slam.vision.camera import PanoramaCamera as PanoramaCamera
from mht_slam.vision.camera import Ring as Ring
from mht_slam.vision.detection import DetectionOptions as DetectionOptions
from mht_slam.vision.detection import PanoramaDetections as PanoramaDetections
from mht_slam.vision.detection import detect_cones as detect_cones
from mht_slam.vision.images import read_image as read_image
from mht_slam.vision.unwrapping import unwrap as unwrap
