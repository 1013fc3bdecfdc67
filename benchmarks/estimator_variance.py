"""Compare estimators of reflected light on a trained run: noise, time, and noise at equal time.

    OMP_NUM_THREADS=1 python -m benchmarks estimator_variance RUN_DIR [--points 512] [--repeats 64]

Every estimator shades the same surface points of the run's scene many times. Columns: `spread`, the standard
deviation of one estimate relative to the mean radiance; `time`, processor time per point in microseconds;
`gain`, how many times less variance than the first row at equal time; `bias`, the deviation of the mean from
the first row's relative to the mean radiance, with its standard error. Only `fast only` should have a bias.
In the rows of *pictures* both lobes share all directions; half of these are drawn from the light sampler or,
as in `lambent evaluate`, from the recovered environment.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import torch
from flashcache.evaluation.lighting import CORRECTION_COUNTS, lit_radiance, sky_sampler
from flashcache.evaluation.monte_carlo import RenderRule
from flashcache.evaluation.views import camera_rays
from flashcache.physical.estimator import DirectionCounts, EstimatorConfig, control_variate
from flashcache.physical.incident import LightSources
from flashcache.physical.model import InverseModel
from flashcache.physical.sampling import EnvironmentMapSampler
from flashcache.physical.shading import ShadingPoints
from flashcache.randomness import generator_for
from flashcache.volume.quadrature import draw_points
from lambent_run.console_reporter import ConsoleReporter
from lambent_run.run.prepare import open_task
from lambent_run.run.tasks.training import load_final, read_scene
from torch import Tensor

DIRECTIONS = 64
"""Of the fast estimate of pictures."""
QUICK = "{run} --points 64 --repeats 8"


@dataclass(frozen=True, kw_only=True)
class Row:
    """What was measured of one estimator."""

    name: str
    rays: str
    spread: float
    time_us: float
    gain: float
    bias: float
    bias_error: float


def estimators(own: EstimatorConfig) -> dict[str, EstimatorConfig]:
    """Return the paper's ablations with its numbers of directions, and the run's own settings."""
    paper = replace(
        own,
        fast=DirectionCounts.split(64),
        exact=DirectionCounts.split(16),
        control_variate="on",
        sampler="vmf",
        stratified=False,
    )
    return {
        "NeRF cache, cosine": replace(paper, control_variate="off", sampler="none"),
        "NeRF cache, light sampler": replace(paper, control_variate="off"),
        "control variate, cosine": replace(paper, sampler="none"),
        "control variate, light sampler": paper,
        "the same, stratified": replace(paper, stratified=True),
        "fast only, light sampler": replace(paper, control_variate="fast_only"),
        "settings of the run": own,
    }


def surface_points(model: InverseModel, cameras: list, count: int) -> ShadingPoints:
    """Return surface points seen by the cameras, drawn by their render weights."""
    parts: list[tuple[Tensor, ...]] = []
    for number, camera in enumerate(cameras):
        rays = camera_rays(model, camera, torch.device("cpu"))
        generator = generator_for(0, "benchmark", number, "points", torch.device("cpu"))
        chosen = torch.randperm(len(rays), generator=generator)[: 20 * count // len(cameras)]
        rays = rays.select(chosen)
        rays = rays.select(rays.far > rays.near)
        geometry = model.nerf.trace(rays, exponent=1.0, generator=None)
        u = torch.rand(len(rays), 1, generator=generator)
        index = draw_points(geometry.weights, u).index[:, 0]
        seen = (geometry.opacity > 0.5).nonzero()[:, 0][: count // len(cameras)]
        flat = (index + geometry.weights.shape[-1] * torch.arange(len(rays)))[seen]
        positions = geometry.samples.positions.reshape(-1, 3)[flat]
        parts.append((positions, geometry.normal[flat], -rays.directions[seen]))
    positions, normal, omega_o = (torch.cat(column) for column in zip(*parts, strict=True))
    return ShadingPoints(positions, normal, omega_o, torch.zeros(len(positions), dtype=torch.long))


Shade = Callable[[torch.Generator], Tensor]
"""Returns an estimate of the radiance [points, 3], from fresh random numbers."""


def as_in_training(model: InverseModel, points: ShadingPoints, config: EstimatorConfig) -> Shade:
    """Return the estimate of a training step with `config`."""
    materials = model.materials(points.positions)

    def shade(generator: torch.Generator) -> Tensor:
        mixture = None
        if config.sampler == "vmf":
            mixture = model.light_sampler(points.positions, points.light_index)
        return control_variate(
            points,
            materials,
            LightSources(model.nerf_source(generator), model.environment, model.limits, model.fast_source()),
            mixture=mixture,
            config=config,
            generator=generator,
        ).rgb

    return shade


def as_in_pictures(model: InverseModel, points: ShadingPoints) -> dict[str, Shade]:
    """Return the estimates of pictures by what their light directions are drawn from."""
    skies = {"light sampler": None, "environment": sky_sampler(model, 0)}

    def shade(generator: torch.Generator, sky: EnvironmentMapSampler | None) -> Tensor:
        rule = RenderRule()
        return lit_radiance(model, points, num_directions=DIRECTIONS, rule=rule, generator=generator, sky=sky)

    return {f"pictures, {name}": partial(shade, sky=sky) for name, sky in skies.items()}


def measure(shade: Shade, repeats: int) -> tuple[Tensor, float]:
    """Return [repeats, points] of mean-channel radiance, and the seconds of processor time per estimate."""
    values = []
    began = time.process_time()
    for repeat in range(repeats):
        generator = generator_for(1, "benchmark", repeat, "estimate", torch.device("cpu"))
        values.append(shade(generator).mean(dim=-1))
    return torch.stack(values), (time.process_time() - began) / repeats


def describe(config: EstimatorConfig) -> str:
    """Return the rays per point as fast + exact."""
    parts = {
        "on": f"{config.fast.total} + {config.exact.total}",
        "off": f"0 + {config.exact.total}",
        "fast_only": f"{config.fast.total} + 0",
    }
    return parts[config.control_variate]


@torch.no_grad()
def trained(run_dir: Path, num_points: int) -> tuple[InverseModel, ShadingPoints, EstimatorConfig]:
    """Return a run's model, points on its surface, and its estimator settings."""
    context = open_task(run_dir, "joint", ConsoleReporter(), "cpu")
    scene = read_scene(context)
    model = load_final(context, scene)
    cameras = [view.camera for view in (scene.test or scene.train)[:4]]
    points = surface_points(model, cameras, num_points)
    if len(points.positions) == 0:
        raise SystemExit("no pixel of the first four views is opaque; give a run that was trained to its end")
    return model, points, context.spec.config.stage_two.estimator


@torch.no_grad()
def compare(model: InverseModel, points: ShadingPoints, own: EstimatorConfig, repeats: int) -> list[Row]:
    """Return one row per estimator."""
    rows: list[Row] = []
    reference: tuple[Tensor, float] | None = None
    trained_with = estimators(own)
    shades = {name: as_in_training(model, points, config) for name, config in trained_with.items()}
    rays = {name: describe(config) for name, config in trained_with.items()}
    for name, shade in (shades | as_in_pictures(model, points)).items():
        measure(shade, 2)
        values, seconds = measure(shade, repeats)
        variance = float(values.var(dim=0).mean())
        mean = values.mean(dim=1)
        if reference is None:
            reference = (mean, variance * seconds)
        level = float(reference[0].mean())
        error = (float(mean.var()) / repeats + float(reference[0].var()) / repeats) ** 0.5
        rows.append(
            Row(
                name=name,
                rays=rays.get(name, f"{DIRECTIONS} + {CORRECTION_COUNTS.total}"),
                spread=variance**0.5 / level,
                time_us=seconds / len(points.positions) * 1e6,
                gain=reference[1] / (variance * seconds),
                bias=float(mean.mean() - reference[0].mean()) / level,
                bias_error=error / level,
            )
        )
    return rows


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("run_dir", type=Path)
    parser.add_argument("--points", type=int, default=512)
    parser.add_argument("--repeats", type=int, default=64)


def main(arguments: argparse.Namespace) -> list[dict]:
    """Return the rows of the table, printed."""
    model, points, own = trained(arguments.run_dir, arguments.points)
    rows = compare(model, points, own, arguments.repeats)
    print(f"{'estimator':32}{'fast + exact':>14}{'spread':>9}{'time':>9}{'gain':>8}{'bias':>20}")
    for row in rows:
        bias = f"{100 * row.bias:+.2f} % +- {100 * row.bias_error:.2f}"
        print(f"{row.name:32}{row.rays:>14}{row.spread:9.3f}{row.time_us:9.1f}{row.gain:8.2f}{bias:>20}")
    return [asdict(row) for row in rows]
