"""Time a stage-one training step: compiled encoder with Jacobian normals against eager double backward.

    python -m benchmarks stage_one_step [--preset fast] [--steps 12] [--threads 2]

Both sides take the same steps of the same preset on a synthetic sphere (256 x 256 pixels, every step with
normals), alternating in one process with the same number of threads and float32 products. The other side asks
the torch reference for features and differentiates through the interpolation twice. Figures are wall-clock
seconds, median and range over the steps; the ratio is of the medians.
"""

import argparse
import os
import time
from dataclasses import replace
from unittest.mock import patch

import torch
from flashcache.data.ray_batches import TrainingPixels
from flashcache.fields.density import DensityField, DensitySample
from flashcache.geometry.contraction import contract
from flashcache.kernels import dispatch
from flashcache.physical.model import Domain, InverseModel
from flashcache.presets import preset
from flashcache.training.stage_one import StageOne
from support.lit_sphere import lit_sphere
from torch import Tensor

from benchmarks.claims import Claim, claim, table

QUICK = "--preset tiny --steps 3"
CLAIMS = "--steps 9 --threads 1"


def double_backward(self: DensityField, positions: Tensor) -> tuple[DensitySample, Tensor]:
    """Return what `DensityField.with_gradient` returns, by differentiating through the interpolation."""
    positions = positions.detach().requires_grad_()
    hidden = self.network(self.grid(contract(positions, self.contraction_radius)))
    raw = self.head(hidden)[:, 0]
    (gradient,) = torch.autograd.grad(raw.sum(), positions, create_graph=True)
    return DensitySample(self._density(raw, positions), hidden), gradient


def new_stage(name: str) -> StageOne:
    """Return stage one of a preset, in its phase with all losses on, on the synthetic sphere."""
    scene = lit_sphere(num_views=12, side=256)
    config = replace(preset(name).stage_one, normal_every=1)
    domain = Domain(
        bounds_min=scene.bounds_min,
        bounds_max=scene.bounds_max,
        primary=scene.primary,
        secondary=scene.secondary,
        contraction_radius=scene.contraction_radius,
        lights=scene.lights,
    )
    torch.manual_seed(0)
    model = InverseModel(preset(name).model, domain)
    stage = StageOne(model, TrainingPixels(scene, preset(name).pixels, torch.device("cpu")), config, seed=0)
    stage.steps_done = round(0.7 * config.num_steps)
    return stage


def timed_step(stage: StageOne) -> float:
    """Take one step and return its seconds."""
    started = time.perf_counter()
    stage.step()
    return time.perf_counter() - started


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--steps", type=int, default=12)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)


def main(arguments: argparse.Namespace) -> list[Claim]:
    """Print the two times and their ratio, and return them."""
    name, steps = arguments.preset, arguments.steps
    torch.set_num_threads(arguments.threads)
    compiled, eager = new_stage(name), new_stage(name)
    seconds: dict[str, list[float]] = {"compiled": [], "eager": []}
    for number in range(steps + 2):
        one = timed_step(compiled)
        with (
            patch.object(dispatch, "_CHOICE", "reference"),
            patch.object(DensityField, "with_gradient", double_backward),
        ):
            other = timed_step(eager)
        if number >= 2:  # The first steps compile and warm up.
            seconds["compiled"].append(one)
            seconds["eager"].append(other)
    print(f"preset {name}, {steps} steps each, {arguments.threads} threads, torch {torch.__version__}")
    timings = claim(f"stage one step, {name}", "s", seconds["compiled"], seconds["eager"])
    print(table([timings]))
    return [timings]
