"""Relight a bundle in Python: numpy and onnxruntime, no torch.

`load_bundle`, `load_environment`, `load_cameras` or `turntable`, then `render`, then `write_png` or
`write_picture_exr`. Conventions: docs/reference/conventions.md.

Nothing is imported before it is used, so that a program that only reads an environment map, such as the
check of a capture, needs no package for rendering.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lambent_core.errors import BundleError as BundleError
    from lambent_core.errors import CameraError as CameraError
    from lambent_core.errors import EnvironmentFileError as EnvironmentFileError
    from lambent_core.errors import RelightError as RelightError
    from lambent_core.errors import SettingError as SettingError
    from lambent_core.errors import UnsupportedQuality as UnsupportedQuality

    from lambent_relight.bundle.bundle import Bundle as Bundle
    from lambent_relight.bundle.bundle import load_bundle as load_bundle
    from lambent_relight.cameras import Camera as Camera
    from lambent_relight.cameras import cameras_from_arrays as cameras_from_arrays
    from lambent_relight.cameras import cameras_json as cameras_json
    from lambent_relight.cameras import load_cameras as load_cameras
    from lambent_relight.cameras import look_at as look_at
    from lambent_relight.cameras import turntable as turntable
    from lambent_relight.edits import MaterialEdit as MaterialEdit
    from lambent_relight.environment.maps import Cleaning as Cleaning
    from lambent_relight.environment.maps import Environment as Environment
    from lambent_relight.environment.maps import environment_from_array as environment_from_array
    from lambent_relight.environment.maps import load_environment as load_environment
    from lambent_relight.environment.maps import write_environment as write_environment
    from lambent_relight.images import write_picture_exr as write_picture_exr
    from lambent_relight.images import write_png as write_png
    from lambent_relight.picture import RelitPicture as RelitPicture
    from lambent_relight.renderer import Renderer as Renderer
    from lambent_relight.renderer import render as render

_HOMES = {
    name: home
    for home, names in {
        "lambent_core.errors": "BundleError CameraError EnvironmentFileError "
        "RelightError SettingError UnsupportedQuality",
        "lambent_relight.bundle.bundle": "Bundle load_bundle",
        "lambent_relight.cameras": "Camera cameras_from_arrays cameras_json load_cameras look_at turntable",
        "lambent_relight.edits": "MaterialEdit",
        "lambent_relight.environment.maps": "Cleaning Environment "
        "environment_from_array load_environment write_environment",
        "lambent_relight.images": "write_picture_exr write_png",
        "lambent_relight.picture": "RelitPicture",
        "lambent_relight.renderer": "Renderer render",
    }.items()
    for name in names.split()
}
__all__ = [*_HOMES]


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
