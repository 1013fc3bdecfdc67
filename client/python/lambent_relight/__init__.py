"""Relight a bundle in Python: numpy and onnxruntime, no torch.

`load_bundle`, `load_environment`, `load_cameras` or `turntable`, then `render`, then `write_png` or
`write_picture_exr`. Conventions: docs/reference/conventions.md.
"""

from lambent_relight.bundle.bundle import Bundle, load_bundle
from lambent_relight.cameras import Camera, cameras_json, load_cameras, look_at, turntable
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.maps import (
    Cleaning,
    Environment,
    environment_from_array,
    load_environment,
    write_environment,
)
from lambent_relight.errors import (
    BundleError,
    CameraError,
    EnvironmentFileError,
    RelightError,
    SettingError,
    UnsupportedQuality,
)
from lambent_relight.images import write_picture_exr, write_png
from lambent_relight.picture import RelitPicture
from lambent_relight.renderer import Renderer, render

__all__ = [
    "Bundle",
    "BundleError",
    "Camera",
    "CameraError",
    "Cleaning",
    "Environment",
    "EnvironmentFileError",
    "MaterialEdit",
    "RelightError",
    "RelitPicture",
    "Renderer",
    "SettingError",
    "UnsupportedQuality",
    "cameras_json",
    "environment_from_array",
    "load_bundle",
    "load_cameras",
    "load_environment",
    "look_at",
    "render",
    "turntable",
    "write_environment",
    "write_picture_exr",
    "write_png",
]
