"""Training steps and secondary rays at the paper's sizes on a GPU."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from flashcache.config import Config
from flashcache.data.ray_batches import TrainingPixels
from flashcache.kernels import dispatch
from flashcache.physical.incident import SecondaryRays
from flashcache.presets import preset
from flashcache.training import cuda_graphs as graphs
from flashcache.training.cuda_graphs import CudaCapture
from lambent_core.scene import Scene
from lambent_run.run.tasks.training import matrix_precision
from torch.autograd import DeviceType
from torch.profiler import ProfilerActivity, profile

from benchmarks.gpu_timing import timed
from benchmarks.paper_step import STAGES, new_model, new_stage, peak_bytes, read_scene, with_share

WARM_UP = 5
PROFILED_STEPS = 3
SHOWN = 12
"""Kernels of a profile."""
PROGRESS = 0.5
"""Share of the schedule at which steps are measured: all losses are on there."""
FAST_RAYS, NERF_RAYS = 2**18, 2**16
PAPER_S = {"fast cache": 0.128, "NeRF cache": 1.574}
"""Seconds per million rays in the paper's supplement, on an A100."""


@dataclass(frozen=True, slots=True)
class Way:
    """A way to take training steps."""

    kernels: str
    """As for `dispatch.using`."""
    fixed: bool
    """Shapes are fixed (`flashcache.rows`)."""
    graphs: bool
    """Steps are CUDA graphs."""


WAYS = {
    "graphs": Way("auto", fixed=True, graphs=True),
    "eager": Way("auto", fixed=True, graphs=False),
    "picked rows": Way("auto", fixed=False, graphs=False),
    "plain torch": Way("reference", fixed=True, graphs=False),
}


def steps(scene: Path, name: str, device: torch.device, repeats: int, share: int) -> dict[str, Any]:
    """Return times of steps of both stages of a preset, in all ways to take them on the device."""
    config = with_share(preset(name), share)
    capture = read_scene(scene, config)
    found: dict[str, Any] = {"preset": name, "share": share, "progress": PROGRESS}
    for stage in STAGES:
        found[stage] = {
            name: stage_steps(stage, capture, config, device, repeats, way)
            for name, way in WAYS.items()
            if device.type == "cuda" or not way.graphs
        }
    return found


def stage_steps(
    name: str, scene: Scene, config: Config, device: torch.device, repeats: int, way: Way
) -> dict[str, Any]:
    """Return times, memory, and a profile of steps of one stage in the middle of its schedule."""
    if device.type == "cuda":
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats(device)
    with dispatch.using(way.kernels), matrix_precision(device):
        model = new_model(scene, config, device)
        pixels = TrainingPixels(scene, config.pixels, device)
        capture = CudaCapture(device) if way.graphs else None
        stage = new_stage(name, model, pixels, config, way.fixed, capture)
        stage.steps_done = round(PROGRESS * stage.config.num_steps)
        warm_up = min(WARM_UP, repeats)
        if way.graphs:
            # Steps with and without the loss on normals have graphs of their own.
            warm_up += stage.config.normal_every * (graphs.WARM_UP + graphs.CHECKED)
        times = timed(stage.step, device, repeats, warm_up=warm_up)
        found = {"rays": stage.config.num_rays, "times": times, "peak_bytes": peak_bytes(device)}
        skipped = stage.num_skipped + stage.steps.read()
        found |= {"skipped": skipped, "profile": profiled(stage.step, device)}
        return found | {"problem": stage.graphs.problem}


def profiled(step: Any, device: torch.device) -> dict[str, Any]:
    """Return the time that a device spends in kernels (on a processor, operations) per step, and in which."""
    on_gpu = device.type == "cuda"
    activities = [ProfilerActivity.CPU, *([ProfilerActivity.CUDA] if on_gpu else [])]
    with profile(activities=activities) as run:
        for _ in range(PROFILED_STEPS):
            step()
    rows = [
        (
            each.key,
            (each.self_device_time_total if on_gpu else each.self_cpu_time_total) / 1e3 / PROFILED_STEPS,
            each.count / PROFILED_STEPS,
        )
        for each in run.key_averages()
        if (each.device_type == DeviceType.CUDA) == on_gpu
    ]
    rows.sort(key=lambda row: -row[1])
    return {
        "busy_ms": sum(row[1] for row in rows),
        "calls": sum(row[2] for row in rows),
        "largest": [{"name": name[:80], "ms": ms, "calls": calls} for name, ms, calls in rows[:SHOWN]],
    }


def rays(scene: Path, name: str, device: torch.device, repeats: int, share: int) -> dict[str, Any]:
    """Return times of random secondary rays through the caches of a preset, without and with gradients."""
    config = preset(name)
    model = new_model(read_scene(scene, config), config, device)
    found: dict[str, Any] = {"preset": name}
    generator = torch.Generator(device).manual_seed(0)
    # Drawing some of the points takes random numbers.
    drawn = generator if config.model.nerf.secondary_colours else None
    calls = {
        "fast cache": (model.fast_source(), FAST_RAYS),
        "NeRF cache": (model.nerf_source(drawn), NERF_RAYS),
    }
    for cache, (ask, number) in calls.items():
        batch = secondary_rays(max(1, number // share), config, generator)

        def forward(ask: Any = ask, batch: SecondaryRays = batch) -> None:
            with torch.no_grad():
                ask(batch)

        def both(ask: Any = ask, batch: SecondaryRays = batch) -> None:
            ask(batch).near_radiance.sum().backward()

        with matrix_precision(device):
            found[cache] = {
                "rays": len(batch),
                "forward": timed(forward, device, repeats),
                "with gradient": timed(both, device, repeats),
                "paper_s": PAPER_S[cache],
            }
    return found


def secondary_rays(count: int, config: Config, generator: torch.Generator) -> SecondaryRays:
    """Return rays in all directions from points in the ball that contraction maps to radius 1."""
    device, near_far = generator.device, config.space.secondary
    directions = torch.randn(count, 3, generator=generator, device=device)
    places = torch.randn(count, 3, generator=generator, device=device)
    radii = torch.rand(count, 1, generator=generator, device=device) ** (1.0 / 3.0)
    origins = 0.5 * config.space.contraction_radius * radii * torch.nn.functional.normalize(places, dim=-1)
    index = torch.zeros(count, dtype=torch.long, device=device)
    return SecondaryRays(origins, torch.nn.functional.normalize(directions, dim=-1), *near_far, index)
