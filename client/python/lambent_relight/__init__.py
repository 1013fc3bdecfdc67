"""Relight a bundle in Python: numpy and onnxruntime, no torch.

`load_bundle`, `load_environment`, `load_cameras` or `turntable`, then `render`, then `write_png` or
`write_picture_exr`. Conventions: docs/reference/conventions.md.

Nothing is imported before it is used, so that a program that only reads an environment map, such as the
check of a capture, needs no package for rendering.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lambent_core.errors import (
        BundleError,
        CameraError,
        EnvironmentFileError,
        RelightError,
        SettingError,
        UnsupportedQuality,
    )

    from lambent_relight.bundle.bundle import Bundle, load_bundle
    from lambent_relight.cameras import (
        Camera,
        cameras_from_arrays,
        cameras_json,
        load_cameras,
        look_at,
        turntable,
    )
    from lambent_relight.edits import MaterialEdit
    from lambent_relight.environment.maps import (
        Cleaning,
        Environment,
        environment_from_array,
        load_environment,
        write_environment,
    )
    from lambent_relight.images import write_picture_exr, write_png
    from lambent_relight.picture import RelitPicture
    from lambent_relight.renderer import Renderer, render

_HOMES = {
    "Bundle": "lambent_relight.bundle.bundle",
    "BundleError": "lambent_core.errors",
    "Camera": "lambent_relight.cameras",
    "CameraError": "lambent_core.errors",
    "Cleaning": "lambent_relight.environment.maps",
    "Environment": "lambent_relight.environment.maps",
    "EnvironmentFileError": "lambent_core.errors",
    "MaterialEdit": "lambent_relight.edits",
    "RelightError": "lambent_core.errors",
    "RelitPicture": "lambent_relight.picture",
    "Renderer": "lambent_relight.renderer",
    "SettingError": "lambent_core.errors",
    "UnsupportedQuality": "lambent_core.errors",
    "cameras_from_arrays": "lambent_relight.cameras",
    "cameras_json": "lambent_relight.cameras",
    "environment_from_array": "lambent_relight.environment.maps",
    "load_bundle": "lambent_relight.bundle.bundle",
    "load_cameras": "lambent_relight.cameras",
    "load_environment": "lambent_relight.environment.maps",
    "look_at": "lambent_relight.cameras",
    "render": "lambent_relight.renderer",
    "turntable": "lambent_relight.cameras",
    "write_environment": "lambent_relight.environment.maps",
    "write_picture_exr": "lambent_relight.images",
    "write_png": "lambent_relight.images",
}

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
    "cameras_from_arrays",
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


def __getattr__(name: str) -> object:
    """Return a public name, importing its module on first use.

    Raises ModuleNotFoundError, which says what to install, where a package of the extra `client` is missing.
    """
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return getattr(importlib.import_module(_HOMES[name]), name)
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("lambent"):
            raise
        from lambent_core.errors import pip_install

        advice = f"{__name__} needs the package {error.name!r}: {pip_install('client')}"
        raise ModuleNotFoundError(advice, name=error.name) from error


def __dir__() -> list[str]:
    """Return the public names, imported or not."""
    return sorted(__all__)
