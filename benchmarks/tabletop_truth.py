"""Reads the truth of a tabletop capture, and writes the capture with its true cameras and masks.

`examples/tabletop/truth.py` describes the files.
"""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from lambent.truth import read_camera
from lambent_capture.pictures.exr_pictures import exr_pixels
from lambent_relight import Camera, Environment, load_environment
from numpy import ndarray
from PIL import Image, ImageOps

QUARTER_TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])
_TURNS = {1: 0, 6: 1, 8: 3}
"""Quarter turns to the left that take an upright picture to the stored one, by EXIF orientation."""


@dataclass(frozen=True, kw_only=True, slots=True)
class HeldOut:
    """A view that was not photographed."""

    name: str
    camera: Camera
    """In the world of the truth."""
    relit: dict[str, Float[ndarray, "height width 4"]]
    """By light: linear radiance of the object alone, premultiplied, and its coverage."""
    albedo: Float[ndarray, "height width 3"]
    """Linear, times coverage."""


def true_cameras(capture: Path) -> dict[str, dict[str, Any]]:
    """Return the entries of cameras.json by photograph's name without suffix."""
    record = json.loads((capture / "truth" / "cameras.json").read_text(encoding="utf-8"))
    return {name.partition(".")[0]: entry for name, entry in record["cameras"].items()}


def pose(entry: dict[str, Any]) -> Float[ndarray, "4 4"]:
    """Return the camera-to-world matrix of an entry."""
    return np.array(entry["camera_to_world"], np.float64)


def stored_pose(entry: dict[str, Any]) -> Float[ndarray, "4 4"]:
    """Return the camera-to-world matrix of the picture as its file stores it, which may be lying down."""
    turned = np.eye(4)
    turned[:2, :2] = np.linalg.matrix_power(QUARTER_TURN, _TURNS[entry["orientation"]])
    return pose(entry) @ turned


def as_stored(upright: Float[ndarray, "h w"], orientation: int) -> Float[ndarray, "stored_h stored_w"]:
    """Return an upright picture as a file of that EXIF orientation stores it."""
    return np.rot90(upright, _TURNS[orientation])


def read_coverage(path: Path) -> Float[ndarray, "height width"]:
    """Return a mask's values in [0, 1]; of a picture with colours, the mean of them."""
    with Image.open(path) as image:
        return np.asarray(image.convert("L"), np.float64) / 255.0


def unseen_lights(capture: Path) -> dict[str, Environment]:
    """Return the lights that the capture was not photographed in."""
    scene = json.loads((capture / "truth" / "scene.json").read_text(encoding="utf-8"))
    folder = capture / "truth" / "envmaps"
    return {name: load_environment(next(folder.glob(f"{name}.*"))) for name in scene["test_envs"]}


def held_out_views(capture: Path, lights: list[str], shrink: int) -> list[HeldOut]:
    """Return the held-out views with `shrink` times fewer pixels along each side; means of linear values."""
    views = []
    for folder in sorted((capture / "truth").glob("test_*")):
        camera = read_camera(folder)
        relit = {light: shrunk(premultiplied(folder / f"rgba_{light}.exr"), shrink) for light in lights}
        albedo = premultiplied(folder / "albedo.png")[..., :3]
        size = (camera.width // shrink, camera.height // shrink)
        views.append(
            HeldOut(
                name=folder.name,
                camera=camera.resized(*size),
                relit=relit,
                albedo=shrunk(albedo, shrink),
            )
        )
    return views


def premultiplied(path: Path) -> Float[ndarray, "height width 4"]:
    """Return straight RGBA of a file, linear as stored, with its colours times alpha."""
    if path.suffix == ".png":
        with Image.open(path) as image:
            rgba = np.asarray(image.convert("RGBA"), np.float64) / 255.0
    else:
        colours, alpha, *_ = exr_pixels(path)
        assert alpha is not None
        rgba = np.concatenate([colours, alpha[..., None]], axis=-1).astype(np.float64)
    return np.concatenate([rgba[..., :3] * rgba[..., 3:], rgba[..., 3:]], axis=-1)


def shrunk(values: Float[ndarray, "height width c"], times: int) -> Float[ndarray, "h w c"]:
    """Return means over `times` x `times` pixels; what is left over at the right and below is dropped."""
    height, width = values.shape[0] // times, values.shape[1] // times
    cut = values[: height * times, : width * times]
    return cut.reshape(height, times, width, times, -1).mean(axis=(1, 3))


def write_known(capture: Path, photographs: str, target: Path) -> None:
    """Write the capture with true cameras and masks as a transforms.json, as nerfstudio has it.

    Photographs that lie on their side are stored upright, without loss (PNG). Exposures are stated as
    EXIF states them.
    """
    known = true_cameras(capture)
    shutil.rmtree(target, ignore_errors=True)
    for sub in ("images", "masks"):
        (target / sub).mkdir(parents=True)
    frames = []
    for file in sorted((capture / photographs).iterdir()):
        entry, mask = known[file.stem], f"masks/{file.stem}.png"
        name = file.name if entry["orientation"] == 1 else f"{file.stem}.png"
        if entry["orientation"] == 1:
            shutil.copyfile(file, target / "images" / name)
        else:
            with Image.open(file) as image:
                ImageOps.exif_transpose(image).save(target / "images" / name)
        shutil.copyfile(capture / "truth" / mask, target / mask)
        (cx, cy), focal = entry["centre"], entry["focal"]
        lens = {"w": entry["width"], "h": entry["height"], "fl_x": focal, "fl_y": focal, "cx": cx, "cy": cy}
        exposed = {"exposure_time": entry["exposure_s"], "iso": entry["iso"], "f_number": 1.8}
        distortion = {"k1": entry["k1"], "k2": entry["k2"]}
        named = {"file_path": f"images/{name}", "mask_path": mask}
        placed = {"transform_matrix": entry["camera_to_world"]}
        frames.append({**named, **lens, **distortion, **exposed, **placed})
    record = {"camera_model": "OPENCV", "frames": frames}
    (target / "transforms.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
