"""Measure relighting from a bundle: time per ray of both readers, noise, and the gain of one bounce.

    OMP_NUM_THREADS=1 python -m benchmarks relighting BUNDLE SCENE --environments DIR [--views N]

SCENE is the scene folder the bundle was trained on, with test views under other lights; DIR holds their
maps as <light>.hdr. Times are processor seconds of one thread. Quality is PSNR of encoded pictures over
white, with the median albedo ratio of the test views applied, as in `lambent evaluate`.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from flashcache.evaluation.metrics import median_albedo_ratio
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.load import load_scene
from lambent_core.colour import srgb_from_linear
from lambent_core.scene import View
from lambent_relight import Bundle, Camera, Environment, Renderer, load_bundle, load_environment

QUICK = "{bundle} {sample} --environments {maps} --views 1 --samples 8"

NUM_RAYS = 20_000


def seconds(task: Callable[[], object]) -> float:
    """Return the processor time of `task`."""
    started = time.process_time()
    task()
    return time.process_time() - started


def print_reader_times(bundle: Bundle, camera: Camera) -> None:
    """Print microseconds per camera ray, secondary ray and material point, for both readers."""
    rng = np.random.default_rng(0)
    low, high = (
        np.array(corner) for corner in (bundle.manifest.bounds.minimum, bundle.manifest.bounds.maximum)
    )
    points = rng.uniform(low, high, (NUM_RAYS, 3)).astype(np.float32)
    directions = rng.normal(size=(NUM_RAYS, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    origin, direction = camera.resized(64, 64).rays()
    print("| reader | camera ray | secondary ray | material point |\n| --- | --- | --- | --- |")
    for reader in ("onnx", "fused"):
        caches = Renderer(bundle, num_threads=1, reader=reader).caches
        tasks = (
            (lambda c=caches: c.gbuffer(origin, direction), len(origin)),
            (lambda c=caches: c.secondary(points, directions), NUM_RAYS),
            (lambda c=caches: c.material(points), NUM_RAYS),
        )
        for task, _ in tasks:
            task()
        figures = [f"{min(seconds(task) for _ in range(3)) / count * 1e6:.1f}" for task, count in tasks]
        print(f"| {caches.name} | {' | '.join(figures)} |")


def camera_of(view: View) -> Camera:
    """Return a test view's camera as the relighting package has it."""
    names = ("width", "height", "focal_x", "focal_y", "centre_x", "centre_y", "camera_to_world")
    return Camera(name=view.name, **{name: getattr(view.camera, name) for name in names})


def albedo_ratio(renderer: Renderer, views: list[View]) -> np.ndarray:
    """Return the median factor from predicted to true albedo over the pixels that the object covers."""
    pairs = []
    for view in views:
        truth = view.truth["albedo"].reshape(-1, 4)
        inside = truth[:, 3] > 0.5
        pairs.append((truth[inside, :3], renderer.caches.gbuffer(*camera_of(view).rays()).albedo[inside]))
    return median_albedo_ratio(*(np.concatenate(part) for part in zip(*pairs, strict=True)))


def encoded_over_white(rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Return sRGB-encoded colours composited over white in encoded values."""
    return srgb_from_linear(rgb) * alpha + (1.0 - alpha)


def print_bounce_gain(
    renderer: Renderer,
    views: list[View],
    light: str,
    environment: Environment,
    ratio: np.ndarray,
    sample_counts: list[int],
) -> None:
    """Print PSNR, noise and time for direct light alone and with one bounce, per number of directions."""
    for num_samples in sample_counts:
        for indirect in (False, True):
            errors, noise, spent = [], [], 0.0
            for view in views:
                started = time.process_time()
                picture = renderer.render(
                    camera_of(view),
                    environment,
                    spp=num_samples,
                    indirect=indirect,
                    albedo_ratio=ratio,
                )
                spent += time.process_time() - started
                truth = view.images[light]
                wanted = encoded_over_white(truth[..., :3], truth[..., 3:])
                shown = encoded_over_white(picture.rgb, picture.opacity)
                errors.append(float(np.mean((shown - wanted) ** 2)))
                inside = picture.opacity[..., 0] > 0.9
                error = picture.standard_error[inside].mean(axis=-1)
                noise.append(float(np.median(error / picture.rgb[inside].mean(axis=-1))))
            psnr = float(np.mean(-10.0 * np.log10(errors)))
            row = (light, num_samples, "one bounce" if indirect else "direct", f"{psnr:.2f}")
            print(
                "|", " | ".join(map(str, (*row, f"{np.mean(noise):.3f}", f"{spent / len(views):.2f}"))), "|"
            )


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("bundle", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--environments", type=Path, required=True)
    parser.add_argument("--samples", type=int, nargs="+", default=[16, 64, 256])
    parser.add_argument("--views", type=int, default=8)


def main(arguments: argparse.Namespace) -> None:
    """Measure and print the tables of docs/benchmarks/relighting.md."""
    bundle = load_bundle(arguments.bundle)
    scene = load_scene(arguments.scene, describe_scene(arguments.scene), max_side=128)
    views = list(scene.test)[:: max(1, len(scene.test) // arguments.views)][: arguments.views]
    print_reader_times(bundle, camera_of(views[0]))
    renderer = Renderer(bundle, num_threads=1)
    ratio = albedo_ratio(renderer, views)
    for view in views:
        renderer.view(camera_of(view), 2)
    columns = ("light", "directions", "", "PSNR [dB]", "noise", "s per picture")
    print("\n|", " | ".join(columns), "|\n|", " | ".join("---" for _ in columns), "|")
    for light in scene.relight_lights:
        environment = load_environment(arguments.environments / f"{light}.hdr")
        print_bounce_gain(renderer, views, light, environment, ratio, arguments.samples)
