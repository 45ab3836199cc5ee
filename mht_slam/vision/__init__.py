"""From panoramas to bearings: unwrapping, colour threshold, components, sub-pixel centroids.

Source: the paper's section 4; docs/method.md, section 7. Reading and colours need scikit-image,
``pip install 'mht-slam[vision]'``; it is imported when first used.
"""

from mht_slam.vision.camera import PanoramaCamera as PanoramaCamera
from mht_slam.vision.camera import Ring as Ring
