"""Errors at edges where the samples of a pixel reflect differently: one lobe for all, and a lobe for each.

    python -m benchmarks edge_samples BUNDLE --environments FOLDER [--size 96] [--views 2]

Baked pictures with the mesh's edges (`soft_edges=False`) and 2 x 2 samples to a pixel, against the mean
radiance of 8 x 8 samples that are each a pixel of their own. Errors are root mean squares over the pixels
that `apart` shades sample by sample, of radiance over black, clipped to 1 and sRGB-encoded. Nothing is
random.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from lambent_core.colour import srgb_from_linear
from lambent_relight import MaterialEdit, Renderer, load_bundle, load_environment, turntable
from lambent_relight.baked.light import MAX_DOMINANT, lit_texels
from lambent_relight.baked.renderer import BakedRenderer
from lambent_relight.baked.shading import lobes_of, shade
from lambent_relight.baked.shadow_maps import shadow_map
from lambent_relight.baked.view import BakedView, look_at_surface
from lambent_relight.cameras import Camera
from lambent_relight.environment.maps import Environment

QUICK = "{bundle} --environments {maps} --size 24 --views 1"
FINER = 8


def drawn(
    baked: BakedRenderer, camera: Camera, light: Environment, antialias: int, *, apart: bool
) -> tuple[BakedView, np.ndarray]:
    """Return the view of `camera`, and the linear radiance that it shows over black, [height, width, 3]."""
    view, edit = look_at_surface(baked.scene, camera, antialias, apart=apart), MaterialEdit()
    prepared = baked.light(light, MAX_DOMINANT)
    towards = zip(prepared.directions, prepared.radii_rad, strict=True)
    shown = shade(
        view,
        lit_texels(baked.scene, view.used),
        lobes_of(view, edit, preview=False),
        prepared,
        [shadow_map(baked.scene.mesh, *each) for each in towards],
        preview=False,
        indirect=True,
        bounce_gain=edit.bounce_gain(baked.scene.mean_albedo),
    )
    return view, shown["rgb"] * view.image(view.coverage)


def measure(baked: BakedRenderer, camera: Camera, light: Environment) -> dict[str, Any]:
    """Return the number of pixels that are shaded sample by sample, and both errors there."""
    height, width = camera.height, camera.width
    fine = drawn(baked, camera.resized(FINER * width, FINER * height), light, 1, apart=False)[1]
    truth = fine.reshape(height, FINER, width, FINER, 3).mean(axis=(1, 3))
    view, apart = drawn(baked, camera, light, 2, apart=True)
    mean = drawn(baked, camera, light, 2, apart=False)[1]
    edges = np.unique(view.pixel[view.within < 1.0])

    def error(picture: np.ndarray) -> float:
        encoded, true = (srgb_from_linear(np.clip(each, 0.0, 1.0)) for each in (picture, truth))
        return float(np.sqrt(np.mean((encoded - true).reshape(-1, 3)[edges] ** 2)))

    return {"pixels": len(edges), "one_lobe": error(mean), "a_lobe_each": error(apart)}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--environments", type=Path, required=True, help="folder of .hdr and .exr maps")
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--views", type=int, default=2)


def main(options: argparse.Namespace) -> dict[str, list[dict[str, Any]]]:
    """Measure, print the table, and return what was found."""
    bundle = load_bundle(options.bundle)
    bounds = bundle.manifest.bounds
    low, high = np.array(bounds.minimum), np.array(bounds.maximum)
    cameras = turntable(
        options.views,
        target=tuple((low + high) / 2.0),
        radius=1.5 * float(np.linalg.norm(high - low)),
        elevation_deg=30.0,
        width=options.size,
        height=options.size,
    )
    baked, record = Renderer(bundle).baked(), {}
    print("| light | such pixels | one lobe | a lobe for each |\n| --- | --- | --- | --- |")
    for path in sorted(each for each in options.environments.iterdir() if each.suffix in (".hdr", ".exr")):
        found = [measure(baked, camera, load_environment(path)) for camera in cameras]
        record[path.stem] = found
        columns = (
            ", ".join(f"{each[name]:.{digits}f}" for each in found)
            for name, digits in (("pixels", 0), ("one_lobe", 3), ("a_lobe_each", 3))
        )
        print(f"| {path.stem} | {' | '.join(columns)} |", flush=True)
    return record
