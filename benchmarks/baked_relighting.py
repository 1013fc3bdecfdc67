"""Time baked relighting under a changed or rotated light, and compare it with refined pictures.

    OMP_NUM_THREADS=1 python -m benchmarks baked_relighting BUNDLE [--environments DIR] [--views 2]

Prints Markdown tables for docs/benchmarks/relighting.md. A camera is seen once before the clock runs: the
times are those of another light on a known view, in processor time of one thread.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from lambent_core.colour import srgb_from_linear
from lambent_relight import (
    MaterialEdit,
    Renderer,
    environment_from_array,
    load_bundle,
    load_environment,
    turntable,
)
from lambent_relight.baked.light import coarse_bounce, lit_texels, prepare_light, texel_irradiance

QUICK = "{bundle} --size 96 --environments {maps} --views 1 --samples 8"

REPEATS = 7


def milliseconds(function: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the shortest time of several calls; on a shared machine longer ones include other programs."""
    times = []
    for _ in range(repeats):
        began = time.process_time()
        function()
        times.append(time.process_time() - began)
    return 1e3 * min(times)


def speed(renderer: Renderer, size: int) -> None:
    """Print the times of the parts of a picture at `size` x `size` pixels."""
    known = renderer.bundle.cameras()[0]
    bounds = renderer.bundle.manifest.bounds
    target = (np.array(bounds.minimum) + np.array(bounds.maximum)) / 2.0
    extent = float(np.linalg.norm(np.array(bounds.maximum) - np.array(bounds.minimum)))
    radius = float(np.linalg.norm(known.camera_to_world[:3, 3] - target))
    # As close as makes the object fill the picture.
    view_deg = 2.0 * np.degrees(np.arctan(0.42 * extent / radius))
    camera = turntable(
        1,
        radius=radius,
        elevation_deg=30.0,
        target=target.tolist(),
        width=size,
        height=size,
        field_of_view_deg=view_deg,
    )[0]
    baked = renderer.baked()
    environment = environment_from_array(np.random.default_rng(0).uniform(0.0, 1.0, (512, 1024, 3)))
    arguments = {"preview": False, "antialias": 1, "indirect": True, "edit": MaterialEdit()}
    began = time.process_time()
    picture = baked.render(camera, environment, **arguments)
    first = time.process_time() - began
    light = baked.light(environment, 4)
    covered = float((picture.coverage > 0.5).mean())
    bands = round(len(baked.scene.transport.direct) ** 0.5)
    lit = lit_texels(baked.scene, baked.view(camera, 1, soft_edges=True).used)
    turned = iter(range(1, 1000))
    rows = {
        "transport product (direct and indirect, the texels in view)": milliseconds(
            lambda: (texel_irradiance(lit, light, bands), coarse_bounce(lit, light))
        ),
        "whole picture, turned light": milliseconds(
            lambda: baked.render(camera, environment.rotated(next(turned)), **arguments)
        ),
        "a new 1k map: harmonics, lights, prefiltered levels": milliseconds(
            lambda: prepare_light(environment, bands, 4), 3
        ),
        "a new camera and everything after it, once": 1e3 * first,
    }
    print(
        f"{size} x {size} pixels, {100 * covered:.0f} % covered, {baked.scene.transport.num_texels} texels\n"
    )
    print("| | ms |\n| --- | --- |")
    for name, value in rows.items():
        print(f"| {name} | {value:.1f} |")
    began = time.process_time()
    renderer.render(camera.resized(size // 4, size // 4), environment, spp=64, antialias=1)
    print(f"\nrefined, 64 directions, at a quarter of the side: {time.process_time() - began:.2f} s\n")


def likeness(renderer: Renderer, folder: Path, num_views: int, num_samples: int) -> None:
    """Print PSNR of `preview` and `baked` against `refined` under every map of `folder`.

    Half the squared difference of two refined pictures with other random numbers is the noise of one; the
    last column takes it off the squared difference of the baked picture.
    """
    other_numbers = {"spp": num_samples, "seed": 1}
    ways = {
        "preview": {"quality": "preview"},
        "baked": {"quality": "baked"},
        "baked, direct only": {"quality": "baked", "indirect": False},
        "refined, one bounce": {**other_numbers, "bounces": "one"},
        "refined": other_numbers,
    }
    columns = (*list(ways)[:-1], "noise", "baked without noise")
    print("| light | " + " | ".join(f"{name} [dB]" for name in columns) + " |")
    print("| --- |" + " --- |" * len(columns))
    cameras = renderer.bundle.cameras()[:num_views]
    for path in sorted([*folder.glob("*.hdr"), *folder.glob("*.exr")]):
        light = load_environment(path)
        errors = dict.fromkeys(ways, 0.0)
        for camera in cameras:
            truth = renderer.render(camera, light, spp=num_samples)
            for name, way in ways.items():
                shown = [
                    srgb_from_linear(p.rgb) * p.opacity + 1.0 - p.opacity
                    for p in (truth, renderer.render(camera, light, **way))
                ]
                errors[name] += np.mean((shown[0] - shown[1]) ** 2) / len(cameras)
        errors["noise"] = 0.5 * errors["refined"]
        errors["baked without noise"] = errors["baked"] - errors["noise"]
        row = (f"{-10 * np.log10(errors[name]):.1f}" for name in columns)
        print(f"| {path.stem} | " + " | ".join(row) + " |", flush=True)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--environments", type=Path)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--samples", type=int, default=256)


def main(chosen: argparse.Namespace) -> None:
    """Run the benchmark."""
    renderer = Renderer(load_bundle(chosen.bundle))
    speed(renderer, chosen.size)
    if chosen.environments is not None:
        likeness(renderer, chosen.environments, chosen.views, chosen.samples)
