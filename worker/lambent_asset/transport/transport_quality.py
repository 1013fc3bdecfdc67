"""Compares pictures from baked transport with refined ones, for the manifest."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from lambent_core.colour import srgb_from_linear
from lambent_core.directions import pixel_directions
from lambent_core.pictures import Quality
from lambent_proto.v1 import bundle_pb2
from lambent_relight.bundle.archive import open_source
from lambent_relight.bundle.bundle import Bundle
from lambent_relight.cameras import Camera
from lambent_relight.environment.maps import Environment, environment_from_array
from lambent_relight.picture import RelitPicture
from lambent_relight.renderer import Renderer
from numpy import ndarray

SIDE = 128
"""Pixels along the longer side of the compared pictures."""


def judge_qualities(
    folder: Path,
    manifest: bundle_pb2.BundleManifest,
    cameras: Sequence[Camera],
    trained: Mapping[str, Float[ndarray, "rows columns 3"]],
    *,
    num_samples: int,
    seed: int,
    networks: bool = True,
) -> dict[str, float]:
    """Return PSNR [dB] and the largest difference of `baked` and `preview` from `refined`, per light.

    Pictures of `cameras`, sRGB over white, refined ones with `num_samples` light directions per pixel. The
    bundle lies in `folder`; its manifest may still lack its files. Without `networks`, baked pictures are
    those of a bundle from which they will have been taken.
    """
    renderer = Renderer(opened(folder, manifest))
    shipped = renderer if networks else Renderer(opened(folder, manifest, networks=False))
    figures: dict[str, float] = {}
    small = [_reduced(camera) for camera in cameras]
    for name, light in judging_lights(trained).items():
        compared: dict[Quality, list[tuple[float, float]]] = {"baked": [], "preview": []}
        for camera in small:
            refined = renderer.render(camera, light, spp=num_samples, seed=seed)
            for quality, values in compared.items():
                values.append(difference(shipped.render(camera, light, quality=quality), refined))
        for quality, values in compared.items():
            error, worst = np.mean([value[0] for value in values]), max(value[1] for value in values)
            figures[f"{quality}_psnr_refined_{name}"] = float(-10.0 * np.log10(error + 1e-12))
            figures[f"{quality}_worst_refined_{name}"] = worst
    return figures


def opened(folder: Path, manifest: bundle_pb2.BundleManifest, *, networks: bool = True) -> Bundle:
    """Return the unchecked bundle in `folder`, whose manifest may still lack its files.

    Without `networks` it is the bundle from which these will have been taken.
    """
    listed = bundle_pb2.BundleManifest()
    listed.CopyFrom(manifest)
    del listed.files[:]
    for path in folder.rglob("*"):
        if path.is_file():
            name = path.relative_to(folder).as_posix()
            listed.files.add(path=name, role="cameras" if name == "cameras.json" else "")
    if not networks:
        del listed.graphs[:]
    return Bundle(path=folder, manifest=listed, source=open_source(folder))


def judging_lights(trained: Mapping[str, Float[ndarray, "rows columns 3"]]) -> dict[str, Environment]:
    """Return the lights of the comparison: the recovered ones, three soft boxes, and a low sun."""
    directions = pixel_directions(32, 64)

    def spot(azimuth_deg: float, elevation_deg: float, radius_deg: float) -> Float[ndarray, "rows columns 1"]:
        azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
        level = np.cos(elevation)
        axis = np.array([np.cos(azimuth) * level, np.sin(azimuth) * level, np.sin(elevation)])
        return (directions @ axis > np.cos(np.radians(radius_deg)))[..., None].astype(np.float64)

    boxes = 0.05 + 8.0 * spot(30, 40, 20) + 3.0 * spot(160, 20, 25) + 5.0 * spot(270, 60, 15)
    sky = (0.3 + 0.3 * np.maximum(directions[..., 2:], 0.0)) * np.array([0.7, 0.9, 1.2])
    sun = 120.0 * spot(200, 25, 4) * np.array([1.0, 0.8, 0.5])
    lights = {name: environment_from_array(image) for name, image in trained.items()}
    lights["soft_boxes"] = environment_from_array(boxes * np.array([1.0, 0.95, 0.9]))
    lights["low_sun"] = environment_from_array(sky + sun)
    return lights


def difference(a: RelitPicture, b: RelitPicture) -> tuple[float, float]:
    """Return the mean squared and the largest difference of two pictures, sRGB over white."""
    shown = [srgb_from_linear(p.rgb) * p.opacity + 1.0 - p.opacity for p in (a, b)]
    apart = np.abs(shown[0] - shown[1]).astype(np.float64)
    return float(np.mean(apart**2)), float(apart.max())


def _reduced(camera: Camera) -> Camera:
    factor = min(1.0, SIDE / max(camera.width, camera.height))
    return camera.resized(max(1, round(camera.width * factor)), max(1, round(camera.height * factor)))
