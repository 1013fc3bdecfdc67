"""Train stage one with several settings and say how long each takes to reach a quality.

    python -m benchmarks time_to_quality SUITE/cowcrate SUITE/goldbowl --seeds 0 1 2 -o OUT \
        --variant base --variant 'half: stage_one.num_rays=512 stage_one.num_steps=2400'

A variant is a name and the settings by which it differs from `--preset`. Each is trained with each seed on
each scene; about `--marks` times on the way, evenly spaced in steps, the cache's picture and normals of
`--views` test views are compared with the truth, over white on the whole frame, in encoded values. Time is
that of the steps and of what they need before (visual hull, pixels), without reading the capture: `--clock`
says whether the wall's, on all cores, or that of one process on the processor, which tells little of a busy
neighbour.
Curves are kept in OUT/<scene>_<variant>_<seed>.json, and a finished one is not repeated. Prints the mean
seconds to each of `--levels` [dB] and the last figures.
"""

import argparse
import json
import math
import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, TypedDict

import numpy as np
from flashcache.data.hull import fit_occupancy
from flashcache.evaluation.metrics import over_white
from flashcache.evaluation.views import render_surface
from flashcache.physical.model import InverseModel
from flashcache.training.stage_one import StageOne
from lambent_core.scene import Scene, View, evenly_spaced
from lambent_core.startup import prepare
from lambent_run.console_reporter import ConsoleReporter
from lambent_run.report.predictions import encoded
from lambent_run.run.hashes import PREPARATION
from lambent_run.run.pipeline import run_pipeline
from lambent_run.run.prepare import device_for, open_task
from lambent_run.run.spec import RunSpec
from lambent_run.run.tasks.training import (
    new_model,
    processes_for,
    read_scene,
    training_pixels,
)

from benchmarks.switches import add_variants

QUICK = (
    "{sample} --preset tiny --marks 2 --views 1 --seeds 0 --variant base --variant few:stage_one.num_rays=128"
)


ANTIALIAS = 2
"""Rays along each side of a pixel, as in the presets' evaluation: with one, sharp outlines score less."""

Clock = Literal["wall", "processor"]


class Mark(TypedDict):
    """The quality after some training."""

    step: int
    wall: float
    """Seconds of training, by the clock on the wall."""
    processor: float
    """Seconds of training, of all threads together."""
    psnr: float
    """Of the cache's picture [dB], from the mean squared error over all views."""
    normals: float
    """Mean angle to the true normals inside the masks [deg]; NaN where the capture has none."""


def quality(model: InverseModel, scene: Scene, views: int) -> tuple[float, float]:
    """Return PSNR [dB] and angle [deg] of the cache on test views; see `Mark`."""
    errors, angles = [], []
    light = scene.lights[0]
    for view in evenly_spaced(scene.test, views):
        truth = view.images[light]
        buffer = render_surface(model, view.camera, antialias=ANTIALIAS)
        straight = buffer.cache_rgb / np.maximum(buffer.opacity, 1e-6)
        shown = over_white(encoded(straight, buffer.opacity))
        difference = shown - over_white(encoded(truth[..., :3], truth[..., 3:]))
        # What was cut off is white in both.
        errors.append(float(np.square(difference).mean()) * truth[..., 3].size / _frame(view))
        if "normal" in view.truth:
            inside = truth[..., 3] > 0.5
            cosine = (buffer.normal * view.truth["normal"][..., :3]).sum(axis=-1)[inside]
            angles.append(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    angle = float(np.concatenate(angles).mean()) if angles else math.nan
    return -10.0 * math.log10(max(statistics.fmean(errors), 1e-10)), angle


def _frame(view: View) -> int:
    """Return the pixels of a view with its margins."""
    camera, margins = view.camera, view.margins
    return (camera.width + margins.left + margins.right) * (camera.height + margins.top + margins.bottom)


def curve(run: Path, seed: int, settings: dict[str, str], arguments: argparse.Namespace) -> list[Mark]:
    """Return the marks of one training."""
    spec = RunSpec.from_options(arguments.scene, preset=arguments.preset, overrides=settings, seed=seed)
    with ConsoleReporter(run) as reporter:
        run_pipeline(spec, run, device_for(run), reporter, PREPARATION)
        context = open_task(run, "cache", reporter)
        scene = read_scene(context)
        model = new_model(context, scene)
        config, used = spec.config.stage_one, [0.0, 0.0]
        marks: list[Mark] = []
        every = math.ceil(config.num_steps / arguments.marks)
        # The processor's clock is that of this process.
        rays = config.num_rays if arguments.clock == "wall" else 1
        with processes_for(context, rays) as processes:
            with counted(used):
                fit_occupancy(model, scene)
                pixels = training_pixels(context, scene, model)
                stage = StageOne(model, pixels, config, seed=seed, processes=processes)
            while not stage.finished:
                with counted(used):
                    stage.step()
                if stage.steps_done % every and not stage.finished:
                    continue
                psnr, normals = quality(model, scene, arguments.views)
                wall, processor = used
                mark = Mark(step=stage.steps_done, wall=wall, processor=processor, psnr=psnr, normals=normals)
                marks.append(mark)
                print(f"  {json.dumps({name: round(value, 2) for name, value in mark.items()})}", flush=True)
    return marks


@contextmanager
def counted(used: list[float]) -> Iterator[None]:
    """Add the seconds that pass in the context, on the wall and of the processor."""
    began = time.perf_counter(), time.process_time()
    yield
    used[0] += time.perf_counter() - began[0]
    used[1] += time.process_time() - began[1]


def seconds_to(marks: list[Mark], level: float, clock: Clock) -> float:
    """Return the seconds after which a curve reaches `level` [dB], or infinity; linear between marks."""
    before = Mark(step=0, wall=0.0, processor=0.0, psnr=0.0, normals=math.nan)
    for mark in marks:
        if mark["psnr"] >= level:
            share = (level - before["psnr"]) / (mark["psnr"] - before["psnr"])
            return before[clock] + share * (mark[clock] - before[clock])
        before = mark
    return math.inf


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--preset", default="fast")
    add_variants(parser, "stage one")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--marks", type=int, default=8)
    parser.add_argument("--views", type=int, default=4, help="test views, evenly spaced")
    parser.add_argument("--clock", choices=("wall", "processor"), default="wall")
    parser.add_argument("--levels", nargs="+", type=float, default=[30.0, 32.0, 34.0], help="dB")


def main(arguments: argparse.Namespace) -> None:
    """Train what is not there yet and print the table."""
    prepare()
    levels = arguments.levels
    rows = []
    for scene in arguments.scenes:
        arguments.scene = scene
        for name, settings in arguments.variant or [("base", {})]:
            curves = []
            for seed in arguments.seeds:
                kept = arguments.out / f"{scene.name}_{name}_{seed}.json"
                if not kept.exists():
                    print(f"{scene.name}, {name}, seed {seed}", flush=True)
                    run = arguments.out / "runs" / kept.stem
                    marks = curve(run, seed, settings, arguments)
                    kept.write_text(json.dumps({"settings": settings, "marks": marks}, indent=1))
                curves.append(json.loads(kept.read_text())["marks"])
            clock, last = arguments.clock, [marks[-1] for marks in curves]
            reached = [
                statistics.fmean(seconds_to(marks, level, clock) for marks in curves) for level in levels
            ]
            figures = [statistics.fmean(mark[key] for mark in last) for key in (clock, "psnr", "normals")]
            spread = statistics.stdev(mark["psnr"] for mark in last) if len(last) > 1 else 0.0
            rows.append(
                f"| {scene.name} | {name} | "
                + " | ".join(f"{value:.0f}" for value in reached)
                + f" | {figures[0]:.0f} | {figures[1]:.2f} ± {spread:.2f} | {figures[2]:.1f} |"
            )
    print(
        "| scene | variant | "
        + " | ".join(f"{level:g} dB [s]" for level in levels)
        + " | all [s] | [dB] | [deg] |"
    )
    print("| --- " * (5 + len(levels)) + "|")
    print("\n".join(rows))
