"""Measure the noise of refined pictures over seeds, and what a direction costs.

    OMP_NUM_THREADS=1 python -m benchmarks refined_noise BUNDLE --environments DIR [--samples 64]

Variance is that of a pixel over seeds, averaged over pixels that the object covers by more than 0.9, and over
views: of encoded colours, and relative to the pixel's mean radiance. Run it with two revisions, one after the
other, to compare them.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from lambent_core.colour import srgb_from_linear
from lambent_relight import Camera, Environment, Renderer, load_bundle, load_environment
from lambent_relight.edits import MaterialEdit

QUICK = "{bundle} --environments {maps} --views 1 --samples 8 --seeds 2 --side 16"

_LEAST_RADIANCE = 1e-3


def noise(
    renderer: Renderer, camera: Camera, light: Environment, edit: MaterialEdit, arguments: argparse.Namespace
) -> list[float]:
    """Return variance of encoded colours, relative variance, stated by true variance, seconds per picture."""
    way = {"spp": arguments.samples, "occlusion": arguments.occlusion, "edit": edit}
    renderer.render(camera, light, **way)
    began = time.process_time()
    pictures = [renderer.render(camera, light, seed=1000 + seed, **way) for seed in range(arguments.seeds)]
    seconds = (time.process_time() - began) / arguments.seeds
    inside = pictures[0].coverage[..., 0] > 0.9
    rgb = np.stack([picture.rgb[inside] for picture in pictures])
    variance = rgb.astype(np.float64).var(axis=0, ddof=1)
    encoded = srgb_from_linear(rgb).astype(np.float64).var(axis=0, ddof=1).mean()
    relative = (variance / np.maximum(rgb.mean(axis=0), _LEAST_RADIANCE) ** 2).mean()
    stated = np.mean([(picture.standard_error[inside] ** 2).mean() for picture in pictures])
    return [float(encoded), float(relative), float(stated / variance.mean()), seconds]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--environments", type=Path, required=True)
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--side", type=int, default=48)
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--occlusion", choices=("auto", "mesh", "cache"), default="auto")
    parser.add_argument("--roughness", type=float, default=1.0, help="factor on the perceptual roughness")


def main(arguments: argparse.Namespace) -> None:
    """Measure and print one row of docs/benchmarks/asset.md per environment."""
    bundle = load_bundle(arguments.bundle)
    renderer = Renderer(bundle, num_threads=1)
    edit = MaterialEdit(roughness_scale=arguments.roughness)
    cameras = bundle.cameras()
    chosen = cameras[:: max(1, len(cameras) // arguments.views)][: arguments.views]
    print("| light | encoded variance | relative variance | stated / true | s per picture |")
    print("| --- | --- | --- | --- | --- |")
    for path in sorted(arguments.environments.glob("*.hdr")):
        light = load_environment(path)
        small = [camera.resized(arguments.side, arguments.side) for camera in chosen]
        rows = [noise(renderer, camera, light, edit, arguments) for camera in small]
        encoded, relative, stated, seconds = np.mean(rows, axis=0)
        print(f"| {path.stem} | {encoded:.2e} | {relative:.2e} | {stated:.2f} | {seconds:.3f} |")
