"""Time the compiled encoder against the torch reference, side by side in one run.

    OMP_NUM_THREADS=1 python -m benchmarks kernels
    python -m benchmarks kernels --device cuda --rays 65536

Each row is one step on points along rays. `features` is forward and backward; `normals` is a density with its
gradient by position and a loss on both: from features and Jacobian on the compiled side, by eager double
backward on the other. Figures are milliseconds of processor time in this thread, or of time until a GPU has
finished, medians of the repeats, which alternate. The ratio is reference / compiled. `gathers` is the time of
the same number of row reads alone, from random places of the same table: what no forward pass is faster than.
"""

import argparse
import math
import statistics
import time
from collections.abc import Callable

import numpy as np
import torch
from flashcache.encoding.hash_grid import HashGrid, HashGridConfig
from flashcache.kernels import reference
from torch import Tensor

from benchmarks.ceilings import gather
from benchmarks.claims import Claim, claim, in_turns

QUICK = "--rays 256 --repeats 4"
CLAIMS = "--repeats 7"

GRIDS = {
    "6 levels x 1, 2^15": (
        HashGridConfig(finest_resolution=128, num_levels=6, num_features=1, log2_table_size=15),
        32,
    ),
    "6 levels x 2, 2^15": (HashGridConfig(finest_resolution=128, num_levels=6, log2_table_size=15), 32),
    "8 levels x 2, 2^17": (HashGridConfig(num_levels=8), 16),
    "8 levels x 4, 2^19": (HashGridConfig(finest_resolution=2048, num_features=4, log2_table_size=19), 16),
}


def points_on_rays(num_rays: int, num_samples: int) -> Tensor:
    """Return equidistant points along random rays through the unit cube, ray after ray."""
    generator = torch.Generator().manual_seed(0)
    origins = torch.rand(num_rays, 1, 3, generator=generator) * 0.6 - 0.3
    directions = torch.nn.functional.normalize(torch.randn(num_rays, 1, 3, generator=generator), dim=-1)
    return (origins + directions * torch.linspace(-0.8, 0.8, num_samples)[:, None]).reshape(-1, 3)


def features_step(encode: Callable[[Tensor], Tensor], z: Tensor, table: Tensor) -> None:
    """Encode `z` and send a gradient back to the table."""
    table.grad = None
    encode(z).sum().backward()


def jacobian_step(grid: HashGrid, network: torch.nn.Module, z: Tensor) -> None:
    """Density and its gradient from features and Jacobian; backward from a loss on both."""
    grid.table.grad = None
    features, jacobian = grid.encode_with_jacobian(z)
    density = network(features)
    (by_feature,) = torch.autograd.grad(density.sum(), features, create_graph=True)
    gradient = (by_feature[:, :, None] * jacobian).sum(dim=1)
    (gradient.square().sum() + density.sum()).backward()


def double_backward_step(grid: HashGrid, network: torch.nn.Module, z: Tensor) -> None:
    """Do the same by differentiating through the interpolation twice."""
    grid.table.grad = None
    z = z.detach().requires_grad_()
    density = network(reference.encode(z, grid.table, grid.layout))
    (gradient,) = torch.autograd.grad(density.sum(), z, create_graph=True)
    (gradient.square().sum() + density.sum()).backward()


def seconds(device: torch.device) -> float:
    """Return the processor time of this thread, or the time when the GPU has finished what it was given."""
    if device.type == "cpu":
        return time.thread_time()
    torch.cuda.synchronize(device)
    return time.perf_counter()


def gathers_in(z: Tensor, grid: HashGrid, repeats: int) -> float:
    """Return the milliseconds of the row reads of one interpolation alone, at random: a lower limit."""
    rows = np.random.default_rng(0).integers(0, len(grid.table), 8 * len(grid.layout.levels) * len(z))
    table = np.ascontiguousarray(grid.table.detach().numpy()[:, :1].repeat(2, axis=1))
    values = in_turns({"gathers": lambda: gather(table, rows)}, repeats, time.thread_time)["gathers"]
    return 1e3 * statistics.median(values)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("--rays", type=int, default=1024)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--device", type=torch.device, default=torch.device("cpu"))


def main(arguments: argparse.Namespace) -> list[Claim]:
    """Print the table and return its rows."""
    torch.set_num_threads(1)
    device, claims = arguments.device, []
    print(f"{'grid':22}{'points':>8}{'step':>10}{'compiled':>10}{'reference':>11}{'ratio':>7}{'gathers':>9}")
    for name, (config, num_samples) in GRIDS.items():
        z = points_on_rays(arguments.rays, num_samples).to(device)
        grid = HashGrid(config).to(device)
        torch.nn.init.normal_(grid.table)
        network = torch.nn.Sequential(
            torch.nn.Linear(grid.out_features, 64), torch.nn.Softplus(beta=10.0), torch.nn.Linear(64, 1)
        ).to(device)
        steps = {
            "features": (
                lambda grid=grid, z=z: features_step(grid, z, grid.table),
                lambda grid=grid, z=z: features_step(
                    lambda z: reference.encode(z, grid.table, grid.layout), z, grid.table
                ),
            ),
            "normals": (
                lambda grid=grid, network=network, z=z: jacobian_step(grid, network, z),
                lambda grid=grid, network=network, z=z: double_backward_step(grid, network, z),
            ),
        }
        limit = gathers_in(z, grid, arguments.repeats) if device.type == "cpu" else math.nan
        for kind, (compiled, eager) in steps.items():
            ways = {"ours": compiled, "reference": eager}
            timings = in_turns(ways, arguments.repeats, lambda: seconds(device))
            ours, other = ([1e3 * value for value in timings[way]] for way in ways)
            one = claim(f"grid {name}, {kind}", "ms", ours, other)
            claims.append(one)
            fast, slow = one["ours"]["median"], one["reference"]["median"]
            print(
                f"{name:22}{len(z):8}{kind:>10}{fast:10.2f}{slow:11.2f}{one['ratio']:7.1f}{limit:9.2f}",
                flush=True,
            )
    return claims
