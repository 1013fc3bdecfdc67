"""The matrices by which an EXR file says from where it was rendered, for compositing in three dimensions.

Frames are those of OpenEXR's standard attributes, which are Renderman's: points are row vectors before
a matrix; camera space is left-handed, x right, y up, z forward; NDC is (0, 0) in the upper left corner of the
picture and (1, 1) in the lower right one. Source: OpenEXR, standard attributes worldToCamera and worldToNDC.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from lambent_relight.cameras import Camera


def camera_attributes(camera: Camera) -> Mapping[str, NDArray[np.float32]]:
    """Return `worldToCamera` and `worldToNDC` [4, 4] of a camera, as attributes of an EXR file.

    A world point (x, y, z, 1) times worldToNDC, divided by its last number, begins with the place in the
    picture: times width and height it is in pixels. The last number is the depth along the axis.
    """
    forward = np.diag([1.0, 1.0, -1.0, 1.0])
    to_camera = forward @ np.linalg.inv(camera.camera_to_world)
    # Rows of the picture go down. The third row keeps the matrix invertible: depth 1 becomes 0, infinity 1.
    to_ndc = np.array(
        [
            [camera.focal_x / camera.width, 0.0, camera.centre_x / camera.width, 0.0],
            [0.0, -camera.focal_y / camera.height, camera.centre_y / camera.height, 0.0],
            [0.0, 0.0, 1.0, -1.0],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )
    return {
        "worldToCamera": np.ascontiguousarray(to_camera.T, np.float32),
        "worldToNDC": np.ascontiguousarray((to_ndc @ to_camera).T, np.float32),
    }
