"""Measure the gain of a fast cache adapted to a light: refined pictures with and without it, against truth.

    OMP_NUM_THREADS=1 python -m benchmarks bake_light RUN SCENE --environments DIR -o DIR [--steps N]

RUN is a run folder of `lambent train` on SCENE, whose test views exist under other lights; their maps are
<light>.hdr. Each light is baked once with the run (its NeRF cache in the second term) and once with the
run's bundle alone. The median albedo ratio of the views is applied, as in `lambent evaluate`, and baked in.
Prints a Markdown table of PSNR in dB over encoded values over white, the share of bounced light, and the
processor time of a bake.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from flashcache.training.light_bake import LightBakeConfig
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.load import load_scene
from lambent_core.scene import View
from lambent_relight import Environment, Renderer, load_bundle, load_environment
from lambent_run.console_reporter import ConsoleReporter
from lambent_run.run.bake import BakeRequest, bake_light

from benchmarks.relighting import albedo_ratio, camera_of, encoded_over_white

QUICK = "{run} {sample} --environments {maps} --views 1 --samples 8 --steps 20 --lights studio --kinds bundle"


def psnr(
    renderer: Renderer,
    views: list[View],
    light: str,
    environment: Environment,
    ratio: np.ndarray,
    **way: object,
) -> tuple[float, float]:
    """Return the mean PSNR of refined pictures, and the mean share of light that bounced."""
    errors, shares = [], []
    for view in views:
        picture = renderer.render(camera_of(view), environment, albedo_ratio=ratio, **way)
        truth = view.images[light]
        wanted = encoded_over_white(truth[..., :3], truth[..., 3:])
        errors.append(float(np.mean((encoded_over_white(picture.rgb, picture.opacity) - wanted) ** 2)))
        weight = picture.opacity
        total = float((picture.rgb * weight).sum())
        shares.append(float((picture.indirect * weight).sum()) / total if total else 0.0)
    return float(np.mean(-10.0 * np.log10(errors))), float(np.mean(shares))


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("run", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--environments", type=Path, required=True)
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--steps", type=int, default=0)
    parser.add_argument("--lights", default="", help="names with commas; all test lights by default")
    parser.add_argument("--kinds", default="run,bundle", help="what is baked from, with commas")


def main(chosen: argparse.Namespace) -> None:
    """Bake, render and print."""
    scene = load_scene(chosen.scene, describe_scene(chosen.scene), max_side=128)
    views = list(scene.test)[:: max(1, len(scene.test) // chosen.views)][: chosen.views]
    bundle = chosen.run / "bundle"
    plain = Renderer(load_bundle(bundle))
    ratio = albedo_ratio(plain, views)
    config = LightBakeConfig()
    config = replace(config, num_steps=chosen.steps) if chosen.steps else config
    sources = {"run": chosen.run, "bundle": bundle}
    kinds = [kind for kind in chosen.kinds.split(",") if kind]
    lights = [name for name in chosen.lights.split(",") if name] or list(scene.relight_lights)
    columns = ["light", "direct", "one bounce", "transport", *(f"adapted, {kind}" for kind in kinds)]
    columns += ["bounced light: transport / " + " / ".join(kinds), "bake [s]"]
    print("| " + " | ".join(columns) + " |\n" + "| --- " * len(columns) + "|", flush=True)
    for light in lights:
        path = chosen.environments / f"{light}.hdr"
        environment = load_environment(path)
        way = {"spp": chosen.samples}
        row = [
            psnr(plain, views, light, environment, ratio, indirect=False, **way),
            psnr(plain, views, light, environment, ratio, bounces="one", **way),
            psnr(plain, views, light, environment, ratio, bounces="transport", **way),
        ]
        seconds = []
        for kind in kinds:
            source = sources[kind]
            out = chosen.out / f"{kind}_{light}"
            if not out.exists():
                began = time.process_time()
                request = BakeRequest(
                    environment=path, albedo_ratio=tuple(float(v) for v in ratio), config=config
                )
                with ConsoleReporter(as_json=False) as reporter:
                    bake_light(source, out, request, reporter)
                seconds.append(time.process_time() - began)
            adapted = Renderer(load_bundle(out))
            row.append(psnr(adapted, views, light, environment, ratio, bounces="adapted", **way))
        figures = [f"{value:.2f}" for value, _ in row]
        shares = " / ".join(f"{share:.3f}" for _, share in row[2:])
        spent = " / ".join(f"{value:.0f}" for value in seconds) or "-"
        print("| " + " | ".join([light, *figures, shares, spent]) + " |", flush=True)
