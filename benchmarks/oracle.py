"""Measure the score of a perfect reconstruction: true surfaces under our reflection model.

    python -m benchmarks oracle SUITE/cowcrate SUITE/goldbowl --environments SUITE/envmaps/high_res -o OUT

Every test view is shaded from its true distance, normals, albedo, perceptual roughness and metalness under
the true environment: without shadows, with shadows, with one bounce and with three. Light that comes from the
object itself is that of a closed surface fused from the true maps (`oracle_geometry.py`), which also shades
pixels that see more than one surface, at several points. Albedo goes the other way: it is what each kind of
transport makes of all training photographs together, all else being true. Figures are those of
`tests/references/evaluate.py`. Needs the extra `dev` and an LLVM library for ray casting; see
`make_sample_scene.py`.
"""

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from flashcache.evaluation.relighting import MapLight
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.load import load_scene
from lambent_core.scene import Scene
from lambent_relight.environment.maps import load_environment
from lambent_run.report.predictions import encoded, save_array
from lambent_run.report.request import evenly_spaced

from benchmarks.oracle_albedo import AlbedoFit, albedo_map
from benchmarks.oracle_geometry import fuse
from benchmarks.oracle_light import ProxySurface
from benchmarks.oracle_views import TrueSurface
from benchmarks.reference_scores import reference_scores

QUICK = "{sample} --environments {maps} --directions 32 --albedo-directions 8 --resolution 64 --views 1"

GRID = 4


@dataclass(frozen=True, slots=True)
class Oracle:
    """Settings of the light transport and of the sampling of pixels."""

    bounces: int | None
    """Reflections on the object before the one that is seen; None leaves shadows out as well."""
    grid: int = GRID
    """Points along the side of a pixel that sees several surfaces."""
    share: float = 1.0
    """Share of the directions per pixel."""


ORACLES = {
    "direct, no shadows": Oracle(None),
    "direct, shadows": Oracle(0),
    "one bounce": Oracle(1),
    "three bounces": Oracle(3),
    "one bounce, 64 directions, a point per pixel": Oracle(1, grid=1, share=0.5),
}
COLUMNS = {
    "novel views [dB]": "nvs/psnr",
    "relit [dB]": "relight/psnr",
    "relit [SSIM]": "relight/ssim",
    "albedo [dB]": "albedo_rgb_ratio/psnr_gamma",
    "albedo, interior [dB]": "albedo_interior/psnr_gamma",
}


def read_truth(folder: Path) -> Scene:
    """Return a scene with truth at its own size, under its first training light."""
    manifest = describe_scene(folder)
    return load_scene(folder, manifest, max_side=1 << 30, lights=(manifest.lights[0],))


def map_lights(scene: Scene, environments: Path) -> dict[str, MapLight]:
    """Return the true environments by the names of the lights; a training light ends with its rotation."""
    lights = {}
    for light in (*scene.lights, *scene.relight_lights):
        name, _, turn = light.rpartition("_")
        stem, degrees = (name, float(turn)) if name and turn.isdigit() and len(turn) == 3 else (light, 0.0)
        if degrees:
            raise SystemExit(
                f"the first training light of {scene.name} is turned by {degrees} degrees; not done"
            )
        image = load_environment(environments / f"{stem}.hdr").radiance
        lights[light] = MapLight.from_image(np.ascontiguousarray(image), torch.device("cpu"))
    return lights


def predict(
    scene: Scene,
    surface: ProxySurface,
    lights: dict[str, MapLight],
    oracle: Oracle,
    directions: int,
    out: Path,
) -> None:
    """Write the missing pictures of all test views."""
    count = round(directions * oracle.share)
    for number, view in enumerate(scene.test):
        paths = {light: out / view.name / f"rgba_{light}.npy" for light in lights}
        if all(path.is_file() for path in paths.values()):
            continue
        true = TrueSurface(view, surface, oracle.grid)
        for light, path in paths.items():
            radiance = true.radiance(lights[light], oracle.bounces, count, number)
            save_array(path, encoded(true.as_map(radiance), view.truth["albedo"][..., 3:]))


def fit_albedo(
    scene: Scene, surface: ProxySurface, light: MapLight, oracle: Oracle, directions: int, out: Path
) -> None:
    """Write the albedo that best explains all training photographs, unless it exists."""
    paths = [out / view.name / "albedo.npy" for view in scene.test]
    if all(path.is_file() for path in paths):
        return
    fit = AlbedoFit(surface)
    for number, view in enumerate(scene.train):
        fit.observe(
            view, scene.lights[0], light, bounces=oracle.bounces, num_directions=directions, seed=number
        )
    albedo = fit.solve()
    for view, path in zip(scene.test, paths, strict=True):
        save_array(path, albedo_map(surface, albedo, view, GRID))


def measure(folder: Path, arguments: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Return the figures of one scene by kind of transport."""
    scene = read_truth(folder)
    lights = map_lights(scene, arguments.environments)
    started = time.perf_counter()
    silhouettes = scene.test + scene.train
    proxy = fuse(scene.test, silhouettes, scene.bounds_min, scene.bounds_max, arguments.resolution)
    print(
        f"{scene.name}: {len(proxy.faces)} triangles in {time.perf_counter() - started:.0f} s, "
        f"{100 * proxy.seen_share:.0f} % of the vertices seen by a test view",
        flush=True,
    )
    surface = ProxySurface(proxy)
    chosen = replace(scene, test=evenly_spaced(scene.test, arguments.views))
    table = {}
    for name, oracle in ORACLES.items():
        out = arguments.out / scene.name / name.replace(", ", "_").replace(" ", "_")
        started = time.perf_counter()
        predict(chosen, surface, lights, oracle, arguments.directions, out)
        if oracle.share == 1.0:
            fit_albedo(chosen, surface, lights[scene.lights[0]], oracle, arguments.albedo_directions, out)
        table[name] = reference_scores(folder, out, arguments.views)
        print(f"{name}: {time.perf_counter() - started:.0f} s", flush=True)
    return table


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--environments", type=Path, required=True)
    parser.add_argument("--directions", type=int, default=128, help="directions per pixel")
    parser.add_argument("--albedo-directions", type=int, default=64, help="directions per training pixel")
    parser.add_argument("--resolution", type=int, default=256, help="cells along the longest side of the box")
    parser.add_argument("--views", type=int, default=0, help="test views, evenly spaced; 0 for all")


def main(arguments: argparse.Namespace) -> dict[str, dict]:
    """Return all figures by scene; prints a table each."""
    figures = {}
    for folder in arguments.scenes:
        table = figures[folder.name] = measure(folder, arguments)
        lights = [
            key for key in next(iter(table.values())) if key.startswith("rgb/") and key.endswith("/psnr")
        ]
        columns = COLUMNS | {f"{key.split('/')[1]} [dB]": key for key in lights}
        print(f"\n{folder.name}, {arguments.directions} directions per pixel\n")
        print("| light transport | " + " | ".join(columns) + " |\n" + "| --- " * (len(columns) + 1) + "|")
        for name, row in table.items():
            digits = [3 if "SSIM" in title else 2 for title in columns]
            values = zip(columns.values(), digits, strict=True)
            cells = [f"{row[key]:.{count}f}" if key in row else "" for key, count in values]
            print(f"| {name} | " + " | ".join(cells) + " |")
    return figures
