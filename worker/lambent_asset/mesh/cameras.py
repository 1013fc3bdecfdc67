"""Cameras of a capture as clients read them."""

import dataclasses

from lambent_core.scene import Camera
from lambent_relight import cameras as relight_cameras


def relight_camera(name: str, camera: Camera) -> relight_cameras.Camera:
    """Return a camera as clients read it."""
    values = {field.name: getattr(camera, field.name) for field in dataclasses.fields(camera)}
    return relight_cameras.Camera(name=name, **values)
