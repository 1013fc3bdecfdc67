"""Photographs of a bundle's object and the cameras they were taken with, for comparison."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from lambent_core.colour import linear_from_srgb
from lambent_relight import Bundle, Camera, load_cameras
from numpy.typing import NDArray
from PIL import Image

from lambent.errors import UsageProblemError
from lambent.truth import read_camera

_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff")
_SAME_PLACE = 1e-3
"""Largest distance of two records of one camera, as a share of its distance from the origin."""


@dataclass(frozen=True, kw_only=True)
class Photograph:
    """A picture of the object, its camera in the bundle's world, and the training light it was taken in."""

    name: str
    path: Path
    camera: Camera
    light: str

    def pixels(self) -> NDArray[np.float32]:
        """Return linear colours with straight alpha, [height, width, 4]."""
        with Image.open(self.path) as image:
            encoded = np.asarray(image.convert("RGBA"), np.float32) / np.float32(255.0)
        return np.concatenate(
            [linear_from_srgb(encoded[..., :3]), encoded[..., 3:]], axis=-1, dtype=np.float32
        )


def find_photographs(bundle: Bundle, folder: Path) -> list[Photograph]:
    """Return the photographs in `folder` whose cameras are known, in the order of their names.

    Cameras are those of the bundle, of FOLDER/cameras.json (in the bundle's world), and of view folders with
    a metadata.json, as in TensoIR's scenes. The photograph of the camera N is N.png (or .jpg and others), or
    N/rgba_LIGHT.png with a training light. Raises UsageProblemError `view.no_photographs` when there is none,
    and `view.other_world` when the folder's cameras stand elsewhere than the bundle says.
    """
    lights = list(bundle.manifest.train_lights)
    known = {camera.name: camera for camera in bundle.cameras()}
    cameras = dict(known)
    if (folder / "cameras.json").is_file():
        cameras.update((camera.name, camera) for camera in load_cameras(folder / "cameras.json"))
    for metadata in sorted(folder.glob("*/metadata.json")):
        if any((metadata.parent / f"rgba_{light}.png").is_file() for light in lights):
            cameras[metadata.parent.name] = _read(metadata.parent)
    photographs = []
    for name, camera in sorted(cameras.items()):
        _check_same_world(known.get(name), camera)
        plain = next((path for s in _SUFFIXES if (path := folder / f"{name}{s}").is_file()), None)
        paths = [(lights[0] if lights else "", plain)] if plain else []
        paths += [(light, folder / name / f"rgba_{light}.png") for light in lights]
        photographs += [
            Photograph(name=name, path=path, camera=camera, light=light)
            for light, path in paths
            if path.is_file()
        ]
    if not photographs:
        raise UsageProblemError(
            "view.no_photographs",
            f"{folder} has no photograph of a camera that is known ({', '.join(sorted(cameras)[:4])}, ...)",
            "give the scene's folder, or one with N.png for every camera N of the bundle's cameras.json",
        )
    return photographs


def _read(folder: Path) -> Camera:
    try:
        return read_camera(folder)
    except (ValueError, KeyError, TypeError) as error:
        raise UsageProblemError(
            "view.bad_camera", f"{folder / 'metadata.json'} describes no camera: {error}", "fix it"
        ) from error


def _check_same_world(known: Camera | None, camera: Camera) -> None:
    if known is None or known is camera:
        return
    places = (known.camera_to_world[:3, 3], camera.camera_to_world[:3, 3])
    if np.linalg.norm(places[0] - places[1]) > _SAME_PLACE * max(float(np.linalg.norm(places[0])), 1e-6):
        raise UsageProblemError(
            "view.other_world",
            f"the camera {camera.name!r} stands elsewhere in the bundle than in the photographs' folder",
            "give a folder with N.png for every camera N of the bundle's cameras.json",
        )


def fitted(camera: Camera, width: int, height: int) -> tuple[Camera, tuple[slice, slice]]:
    """Return `camera` in the middle of a picture of `width` x `height` pixels, as large as fits.

    The second value is where its own picture lies, as rows and columns; pixels around it continue the view.
    """
    scale = min(width / camera.width, height / camera.height)
    inner = (max(round(camera.width * scale), 1), max(round(camera.height * scale), 1))
    left, top = (width - inner[0]) // 2, (height - inner[1]) // 2
    small = camera.resized(*inner)
    shifted = replace(
        small, width=width, height=height, centre_x=small.centre_x + left, centre_y=small.centre_y + top
    )
    return shifted, (slice(top, top + inner[1]), slice(left, left + inner[0]))


def resampled(pixels: NDArray[np.float32], width: int, height: int) -> NDArray[np.float32]:
    """Return linear pixels [h, w, 4] in another size: means when smaller, bilinear when larger.

    Colours are weighted with alpha, so that none comes from where there is nothing.
    """
    weighted = np.concatenate([pixels[..., :3] * pixels[..., 3:], pixels[..., 3:]], axis=-1)
    planes = [
        Image.fromarray(weighted[..., channel]).resize((width, height), Image.Resampling.BILINEAR)
        for channel in range(4)
    ]
    result = np.stack([np.asarray(plane) for plane in planes], axis=-1)
    result[..., :3] /= np.maximum(result[..., 3:], 1e-6)
    return result


def photograph_index(photographs: list[Photograph], name: str) -> int:
    """Return the number of the photograph called `name`; raises UsageProblemError `view.no_photograph`."""
    names = [photograph.name for photograph in photographs]
    if name not in names:
        raise UsageProblemError(
            "view.no_photograph", f"there is no photograph {name!r}", f"there are {', '.join(names[:6])}, ..."
        )
    return names.index(name)
