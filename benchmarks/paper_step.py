"""Measure time and memory of the paper's training steps in each stage, and optionally a training curve.

    OMP_NUM_THREADS=1 python -m benchmarks paper_step [SCENE] [--preset paper_tensoir]
    python -m benchmarks paper_step SCENE --device cuda [--minutes 10] -o OUT

On a processor the batch is a 64th of the preset's and each stage has a process of its own; the memory model
(`flashcache.memory`) says what that batch and the whole one need. Measured peaks are those of the process,
with its programs, on a processor, and of torch's tensors on a GPU, where the batch is whole. With `--minutes`
both stages train for that time together, their schedules shortened to it, and OUT gets curve.json and
curve.png with the PSNR of two test views. Without SCENE a synthetic sphere is photographed.
"""

import argparse
import json
import resource
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from flashcache.config import Config
from flashcache.data.ray_batches import TrainingPixels
from flashcache.data.space import domain_of, placed
from flashcache.evaluation.metrics import over_white, psnr
from flashcache.evaluation.views import render_gbuffer, render_physical
from flashcache.memory import MemoryEstimate, estimate
from flashcache.physical.model import InverseModel
from flashcache.presets import preset
from flashcache.training.stage_one import StageOne
from flashcache.training.stage_two import StageTwo
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.load import load_scene
from lambent_core.scene import Scene, evenly_spaced
from lambent_run.report.predictions import encoded
from lambent_run.run.tasks.training import matrix_precision

QUICK = "--preset tiny --share 16 --steps 2"

STAGES = ("one", "two")
GIB = 2**30
SHARE_OF_STAGE_ONE = 0.6
"""Of the time of a curve."""
POINTS = 8
"""Of a curve, in each stage."""


def read_scene(folder: Path | None, config: Config) -> Scene:
    """Return a capture at the preset's size under its first light, or the synthetic sphere."""
    if folder is None:
        from support.lit_sphere import lit_sphere

        return placed(lit_sphere(num_views=12, side=256), config.space)
    manifest = describe_scene(folder)
    scene = load_scene(folder, manifest, max_side=config.max_side, lights=(manifest.lights[0],))
    return placed(scene, config.space)


def new_model(scene: Scene, config: Config, device: torch.device) -> InverseModel:
    """Return a fresh model."""
    torch.manual_seed(0)
    return InverseModel(config.model, domain_of(scene, config.space, config.model.environment)).to(device)


def with_share(config: Config, share: int) -> Config:
    """Return the configuration with batches of one `share`-th of the rays."""
    return replace(
        config,
        stage_one=replace(config.stage_one, num_rays=max(2, config.stage_one.num_rays // share)),
        stage_two=replace(config.stage_two, num_rays=max(2, config.stage_two.num_rays // share)),
    )


def new_stage(name: str, model: InverseModel, pixels: TrainingPixels, config: Config) -> StageOne | StageTwo:
    """Return a stage ready for its first step."""
    if name == "one":
        return StageOne(model, pixels, config.stage_one, seed=0)
    return StageTwo(model, pixels, config.stage_two, seed=0)


def peak_bytes(device: torch.device) -> int:
    """Return the largest memory so far: of torch on a GPU, of the whole process elsewhere."""
    if device.type == "cuda":
        return torch.cuda.max_memory_allocated(device)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def measure(
    stage_name: str, scene: Scene, config: Config, device: torch.device, steps: int
) -> dict[str, Any]:
    """Return seconds and loss of each step, and the memory behind them in bytes."""
    model = new_model(scene, config, device)
    pixels = TrainingPixels(scene, config.pixels, device)
    stage = new_stage(stage_name, model, pixels, config)
    before = peak_bytes(device)
    seconds, losses = [], []
    for _ in range(steps):
        started = time.perf_counter()
        with matrix_precision(device):
            losses.append(stage.step().read().loss)
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        seconds.append(time.perf_counter() - started)
    trained = sum(one.numel() for group in stage.optimiser.param_groups for one in group["params"])
    return {
        "stage": stage_name,
        "rays": (config.stage_one if stage_name == "one" else config.stage_two).num_rays,
        "seconds": seconds,
        "losses": losses,
        "parameters": sum(one.numel() for one in model.parameters()),
        "trained": trained,
        "before": before,
        "peak": peak_bytes(device),
        "skipped": stage.num_skipped,
    }


def measure_apart(arguments: argparse.Namespace, stage: str, share: int) -> dict[str, Any]:
    """Return the result of `measure` in its own process, because a memory peak cannot be reset."""
    command = [
        sys.executable,
        "-m",
        "benchmarks",
        "paper_step",
        "--preset",
        arguments.preset,
        "--steps",
        str(arguments.steps),
    ]
    command += ["--share", str(share), "--only", stage]
    command += [str(arguments.scene)] if arguments.scene else []
    return json.loads(
        subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1]
    )


def describe(step: dict[str, Any]) -> str:
    """Return one line about a measurement."""
    steps = ", ".join(f"{seconds:.2f}" for seconds in step["seconds"])
    rest = f"peak {step['peak'] / GIB:.2f} GiB, {step['skipped']} skipped"
    return f"stage {step['stage']}, {step['rays']} rays: steps of {steps} s, {rest}"


def describe_estimate(estimate: MemoryEstimate) -> str:
    """Return one line with the result of the memory model."""
    names = ("parameters", "gradients", "moments", "activations")
    sizes = ", ".join(f"{name} {getattr(estimate, name) / GIB:.2f}" for name in names)
    stage = STAGES[("cache", "joint").index(estimate.stage)]
    count = f"{estimate.num_parameters / 1e6:.1f} M parameters"
    return f"  stage {stage}: {estimate.total / GIB:.2f} GiB ({sizes}; {count})"


def on_processor(arguments: argparse.Namespace, whole: Config, config: Config) -> None:
    """Print steps of a small batch, and the memory model's results for it and for the whole batch."""
    for name in STAGES:
        print(describe(measure_apart(arguments, name, arguments.share)))
    for title, one, device in (
        (f"1/{arguments.share} of the batch, on a processor", config, "cpu"),
        ("the whole batch, on a processor", whole, "cpu"),
        ("the whole batch, on a GPU", whole, "cuda"),
    ):
        print(f"memory model of {title}:")
        print(*(describe_estimate(step) for step in estimate(one, device=device)), sep="\n")


def on_gpu(arguments: argparse.Namespace, scene: Scene, config: Config, device: torch.device) -> None:
    """Print steps of the batch on a GPU, and the memory model's result for it."""
    print(torch.cuda.get_device_name(device))
    for name, expected in zip(STAGES, estimate(config, device="cuda"), strict=True):
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats(device)
        print(describe(measure(name, scene, config, device, arguments.steps)))
        print("  memory model:", describe_estimate(expected).strip())


def curve(scene: Scene, config: Config, device: torch.device, minutes: float) -> list[dict[str, Any]]:
    """Train both stages within `minutes` and return the PSNR of two test views at points in training time.

    The numbers of steps follow from the time of a few steps; all schedules are shares of them.
    """
    model = new_model(scene, config, device)
    pixels = TrainingPixels(scene, config.pixels, device)
    views = evenly_spaced(scene.test or scene.train, 2)
    points, spent = [], 0.0
    for name, share in zip(STAGES, (SHARE_OF_STAGE_ONE, 1.0 - SHARE_OF_STAGE_ONE), strict=True):
        probe = measure(name, scene, config, device, 6)["seconds"]
        steps = max(POINTS, round(60.0 * minutes * share / float(np.median(probe[2:]))))
        stage = new_stage(name, model, pixels, shortened(config, steps))
        while not stage.finished:
            started = time.perf_counter()
            with matrix_precision(device):
                stage.step()
            if device.type == "cuda":
                torch.cuda.synchronize(device)
            spent += time.perf_counter() - started
            if stage.finished or stage.steps_done % max(1, steps // POINTS) == 0:
                row = {"stage": name, "step": stage.steps_done, "steps": steps, "seconds": round(spent, 2)}
                points.append(row | figures(model, scene, views, physical=name == "two"))
                print(json.dumps(points[-1]), flush=True)
    return points


def shortened(config: Config, steps: int) -> Config:
    """Return the configuration with `steps` in each stage and warm-ups of the same share."""
    one, two = config.stage_one, config.stage_two
    return replace(
        config,
        stage_one=replace(one, num_steps=steps, warmup_steps=one.warmup_steps * steps // one.num_steps),
        stage_two=replace(two, num_steps=steps, warmup_steps=two.warmup_steps * steps // two.num_steps),
    )


def figures(model: InverseModel, scene: Scene, views: tuple, *, physical: bool) -> dict[str, float]:
    """Return the PSNR over white in encoded values of the cache's and the physically based pictures."""
    light = scene.lights[0]
    scores: dict[str, list[float]] = {"cache [dB]": []}
    for view in views:
        image = view.images[light]
        truth = over_white(encoded(image[..., :3], image[..., 3:]))
        buffer = render_gbuffer(model, view.camera)
        straight = buffer.cache_rgb / np.maximum(buffer.opacity, 1e-6)
        scores["cache [dB]"].append(psnr(over_white(encoded(straight, buffer.opacity)), truth))
        if physical:
            seen = render_physical(model, view.camera)
            score = psnr(over_white(encoded(seen.rgb, seen.opacity)), truth)
            scores.setdefault("physically based [dB]", []).append(score)
    return {name: float(np.mean(values)) for name, values in scores.items()}


def plot(points: list[dict[str, Any]], path: Path, title: str) -> None:
    """Write the curve as a picture."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panel = plt.subplots(figsize=(7, 4), layout="constrained")
    for name in ("cache [dB]", "physically based [dB]"):
        known = [(point["seconds"] / 60.0, point[name]) for point in points if name in point]
        if known:
            panel.plot(*zip(*known, strict=True), ".-", label=name)
    panel.set(xlabel="training time [min]", ylabel="PSNR of two test views [dB]", title=title)
    panel.legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("scene", type=Path, nargs="?")
    parser.add_argument("--preset", default="paper_tensoir")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--steps", type=int, default=3)
    parser.add_argument("--share", type=int, default=0, help="the batch's divisor; 64, on a GPU 1")
    parser.add_argument("--minutes", type=float, default=0.0, help="train for that long and draw a curve")
    parser.add_argument("--only", choices=STAGES, help=argparse.SUPPRESS)


def main(arguments: argparse.Namespace) -> None:
    """Measure steps, or draw a curve."""
    device = torch.device(arguments.device)
    if device.type == "cuda" and not torch.cuda.is_available():
        raise SystemExit("--device cuda: torch finds no GPU")
    arguments.share = arguments.share or (1 if device.type == "cuda" else 64)
    whole = preset(arguments.preset)
    config = with_share(whole, arguments.share)
    if arguments.only:
        scene = read_scene(arguments.scene, config)
        print(json.dumps(measure(arguments.only, scene, config, device, arguments.steps)))
        return
    print(f"preset {arguments.preset}, torch {torch.__version__}, {torch.get_num_threads()} threads")
    if arguments.minutes:
        points = curve(read_scene(arguments.scene, config), config, device, arguments.minutes)
        (arguments.out / "curve.json").write_text(json.dumps(points, indent=1) + "\n")
        plot(
            points,
            arguments.out / "curve.png",
            f"{arguments.preset}, 1/{arguments.share} of its batch, {device}",
        )
    elif device.type == "cuda":
        on_gpu(arguments, read_scene(arguments.scene, config), config, device)
    else:
        on_processor(arguments, whole, config)
