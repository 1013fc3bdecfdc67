"""Compare the memory that a training step takes with what `lambent train --dry-run` says.

    python -m benchmarks memory_model [--presets fast long] [--factor 8]

For each preset and stage a process of its own takes steps of `--factor` times the preset's rays on a
synthetic sphere, late in the training: as many as outweigh what libraries and the allocator keep. Measured is
the growth of the resident memory over that of the model with its gradients and moments, in one run each;
estimated is `MemoryEstimate.activations` of the same batch.
"""

import argparse
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import torch
from flashcache.config import Config
from flashcache.data.ray_batches import TrainingPixels
from flashcache.data.space import domain_of
from flashcache.memory import estimate
from flashcache.physical.model import InverseModel
from flashcache.presets import preset
from flashcache.training.stage_one import StageOne
from flashcache.training.stage_two import StageTwo
from support.lit_sphere import lit_sphere

QUICK = "--presets tiny --factor 1"

STAGES = ("cache", "joint")
LATE = 0.9
"""Share of the training at which it is measured, as in the estimate: all losses are on."""


def config_of(name: str, factor: int) -> Config:
    """Return a preset with `factor` times its rays, and normals in every step."""
    config = preset(name)
    one, two = config.stage_one, config.stage_two
    return replace(
        config,
        stage_one=replace(one, num_rays=factor * one.num_rays, normal_every=1),
        stage_two=replace(two, num_rays=factor * two.num_rays, normal_every=1),
    )


def resident(key: str) -> int:
    """Return bytes of this process's resident memory: VmRSS now, VmHWM at most."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return 1024 * int(next(line for line in lines if line.startswith(key)).split()[1])


def measure(name: str, stage: str, factor: int) -> int:
    """Return the bytes by which steps grow this process."""
    config, scene = config_of(name, factor), lit_sphere()
    torch.manual_seed(0)
    model = InverseModel(config.model, domain_of(scene, config.space, config.model.environment))
    pixels = TrainingPixels(scene, config.pixels, torch.device("cpu"))

    def made(rays: int) -> StageOne | StageTwo:
        if stage == "cache":
            trained: StageOne | StageTwo = StageOne(
                model, pixels, replace(config.stage_one, num_rays=rays), seed=0
            )
        else:
            trained = StageTwo(model, pixels, replace(config.stage_two, num_rays=rays), seed=0)
        trained.steps_done = round(LATE * trained.config.num_steps)
        return trained

    small = made(8)
    small.step()  # Compiles kernels and creates the moments.
    whole = made(config.stage_one.num_rays if stage == "cache" else config.stage_two.num_rays)
    whole.optimiser = small.optimiser
    for parameter in model.parameters():
        if parameter.grad is not None:
            parameter.grad.fill_(0.0)  # Zeros take no memory before they are written.
    before = resident("VmRSS")
    for _ in range(2):
        whole.step()
    return resident("VmHWM") - before


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("--presets", nargs="+", default=["fast", "long"])
    parser.add_argument("--factor", type=int, default=8)
    parser.add_argument("--measure", nargs=2, metavar=("PRESET", "STAGE"), help=argparse.SUPPRESS)


def main(arguments: argparse.Namespace) -> list[dict[str, float | str]]:
    """Print and return what was estimated and measured."""
    torch.set_num_threads(1)
    if arguments.measure:
        name, stage = arguments.measure
        print(f"bytes {measure(name, stage, arguments.factor)}")
        return []
    rows: list[dict[str, float | str]] = []
    print("| preset | stage | rays | estimated [MB] | measured [MB] | ratio |\n" + "| --- " * 6 + "|")
    for name in arguments.presets:
        config = config_of(name, arguments.factor)
        estimates = {one.stage: one.activations for one in estimate(config)}
        for stage in STAGES:
            command = [sys.executable, "-m", "benchmarks", "memory_model", "--factor", str(arguments.factor)]
            command += ["--measure", name, stage, "-o", str(arguments.out / f"{name}_{stage}")]
            printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
            measured = int(next(line for line in printed.splitlines() if line.startswith("bytes")).split()[1])
            rays = (config.stage_one if stage == "cache" else config.stage_two).num_rays
            ratio = estimates[stage] / measured
            rows.append({"preset": name, "stage": stage, "ratio": ratio})
            print(
                f"| {name} | {stage} | {rays} | {estimates[stage] / 1e6:.0f} | {measured / 1e6:.0f} "
                f"| {ratio:.2f} |",
                flush=True,
            )
    return rows
