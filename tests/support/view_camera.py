"""Cameras for the web viewer."""

import numpy as np
from lambent_relight.cameras import Camera


def view_camera(camera: Camera) -> dict[str, object]:
    """Return a camera as the viewer names its parts: a `ViewCamera` of client/web/src/render."""
    return {
        "width": camera.width,
        "height": camera.height,
        "focalX": camera.focal_x,
        "focalY": camera.focal_y,
        "centreX": camera.centre_x,
        "centreY": camera.centre_y,
        "cameraToWorld": np.asarray(camera.camera_to_world).ravel().tolist(),
    }
