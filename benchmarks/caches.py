"""Time queries of the caches without gradients: compiled functions against torch with the compiled encoder.

    OMP_NUM_THREADS=1 python -m benchmarks caches [--presets fast quick] [--rays 1648] [--repeats 31]

The model is random, with parameters that vary as much as those of a trained one; a shell of cells may hold
something, and three fifths of the NeRF cache's rays miss it. Figures are microseconds of this thread's
processor time per ray or point, median and range; both sides take turns. The last column is the largest
difference between their answers, of all but one percent of the numbers.
"""

import argparse
import statistics
import time
from collections.abc import Callable, Sequence

import torch
from flashcache.geometry.rays import Rays
from flashcache.kernels import dispatch
from flashcache.physical.model import Domain, InverseModel
from flashcache.presets import preset
from torch import Tensor

from benchmarks.claims import Claim, claim

QUICK = "--presets tiny --rays 200 --repeats 3"
CLAIMS = "--presets fast --repeats 21"


def model_of(name: str) -> InverseModel:
    """Return a model of a preset whose answers vary from ray to ray."""
    torch.manual_seed(0)
    domain = Domain(
        bounds_min=(-1.0,) * 3,
        bounds_max=(1.0,) * 3,
        primary=(2.0, 6.0),
        secondary=(0.05, 2.0),
        contraction_radius=1.5,
        lights=("one",),
    )
    model = InverseModel(preset(name).model, domain)
    with torch.no_grad():
        for key, parameter in model.named_parameters():
            if key.endswith("table"):
                parameter.normal_(0.0, 0.3)
        model.fast.distance_head.weight.normal_(0.0, 0.3)
    if model.nerf.occupancy is not None:
        count = len(model.nerf.occupancy.cells)
        axis = torch.linspace(-1.0, 1.0, count)
        radius = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), dim=-1).norm(dim=-1)
        model.nerf.occupancy.set((radius > 0.4) & (radius < 0.65))
    return model


def rays_from_surface(count: int) -> tuple[Tensor, Tensor]:
    """Return rays from points around the shell, 16 each, in all directions."""
    generator = torch.Generator().manual_seed(1)
    points = torch.nn.functional.normalize(torch.randn(count // 16 + 1, 3, generator=generator), dim=-1)
    directions = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)
    return 0.66 * points.repeat_interleave(16, dim=0)[:count], directions


def queries(model: InverseModel, num_rays: int) -> dict[str, tuple[int, Callable[[], Sequence[Tensor]]]]:
    """Return the queries by name, each with its number of rays or points."""
    nerf, light = model.nerf, torch.zeros(4 * num_rays, dtype=torch.long)
    origins, directions = rays_from_surface(4 * num_rays)
    near, far = (torch.full((num_rays,), limit) for limit in (model.limits.near, model.limits.far))
    some = Rays(origins[:num_rays], directions[:num_rays], near, far)
    with torch.no_grad():
        hidden = nerf.density(origins).hidden
    normal = torch.nn.functional.normalize(origins, dim=-1)
    return {
        "secondary rays": (
            num_rays,
            lambda: nerf.incident(some, light[:num_rays], torch.Generator().manual_seed(2)),
        ),
        "fast cache": (4 * num_rays, lambda: model.fast(origins, directions, light)[:3]),
        "radiance of points": (
            4 * num_rays,
            lambda: nerf.appearance(origins, hidden, normal, directions, light),
        ),
    }


def seconds(query: Callable[[], Sequence[Tensor]]) -> float:
    """Return the processor time of one query."""
    start = time.thread_time()
    query()
    return time.thread_time() - start


def difference(query: Callable[[], Sequence[Tensor]]) -> float:
    """Return the largest difference between both sides' answers, of all but one percent of the numbers."""
    compiled = query()
    with dispatch.using("encoder"):
        expected = query()
    apart = torch.cat([(a - b).abs().reshape(-1) for a, b in zip(compiled, expected, strict=True)])
    return float(apart.quantile(0.99))


def figures(times: list[float], count: int) -> str:
    """Return median and range in microseconds per ray."""
    median, least, most = (1e6 * of(times) / count for of in (statistics.median, min, max))
    return f"{median:6.2f} ({least:.2f} to {most:.2f})"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("--presets", nargs="+", default=["fast", "quick"])
    parser.add_argument("--rays", type=int, default=1648)
    parser.add_argument("--repeats", type=int, default=31)


@torch.no_grad()
def main(arguments: argparse.Namespace) -> list[Claim]:
    """Print the table, and return what it says of compiled queries against torch's."""
    torch.set_num_threads(1)
    rows = []
    print(f"{'preset':7}{'query':20}{'number':>7}  {'compiled':24}{'torch':24}{'ratio':>6}{'apart':>10}")
    for name in arguments.presets:
        for query_name, (count, query) in queries(model_of(name), arguments.rays).items():
            apart = difference(query)
            compiled, eager = [], []
            for _ in range(arguments.repeats):
                compiled.append(seconds(query))
                with dispatch.using("encoder"):
                    eager.append(seconds(query))
            ratio = statistics.median(compiled) / statistics.median(eager)
            print(
                f"{name:7}{query_name:20}{count:7}  {figures(compiled, count):24}{figures(eager, count):24}"
                f"{ratio:6.2f}{apart:10.1e}",
                flush=True,
            )
            sides = ([1e6 * value / count for value in times] for times in (compiled, eager))
            rows.append(claim(f"{query_name}, {name}, without gradients", "us", *sides))
    return rows
