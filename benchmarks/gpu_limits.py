"""The kernels of a GPU at the paper's sizes, against what moving their bytes takes at least."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from flashcache.encoding.directional import IntegratedDirectionalEncoding
from flashcache.encoding.hash_grid import HashGrid, HashGridConfig
from flashcache.encoding.occupancy import Occupancy
from flashcache.geometry.rays import Rays
from flashcache.kernels import dispatch
from torch import Tensor

from benchmarks.gpu_timing import bandwidth, timed

FLOAT = 4
"""Bytes."""
COPIED_BYTES = 2**30
GRIDS = {
    "density grid": HashGridConfig(finest_resolution=2048, num_features=4, log2_table_size=19),
    "proposal grid": HashGridConfig(finest_resolution=1024, num_features=1, log2_table_size=19),
}
FEATURE_GRID = HashGridConfig(num_features=4, log2_table_size=19, half_extent=2.0)
SAMPLES = 8
POINTS, RAYS, CELLS = 2**19, 2**18, 96
"""Points of 16384 camera rays; secondary rays of a step of stage two, rounded up; cells along a side."""

Call = Callable[[], object]


@dataclass(frozen=True, kw_only=True, slots=True)
class Case:
    """An operation, its gradient where it has one, and the bytes of their arguments and results.

    `bytes` counts each tensor once, and of a table no more than all of it. `rows` are the bytes of table
    rows, each as often as it is read; the gradient adds as many.
    """

    name: str
    make: Callable[[], tuple[Call, Call | None]]
    """Builds both calls, for the kernels that are chosen when it is called."""
    bytes: int
    rows: int = 0
    gradient_bytes: int = 0


def differentiable(
    function: Callable[[], Tensor | tuple[Tensor, ...]], inputs: tuple[Tensor, ...] = ()
) -> tuple[Call, Call]:
    """Return a call without gradients, and one that differentiates the sum of the results.

    Gradients by `inputs` are not kept.
    """

    def forward() -> None:
        with torch.no_grad():
            function()

    results = function()
    results = (results,) if isinstance(results, Tensor) else results
    upstream = [torch.ones_like(result) for result in results]

    def backward() -> None:
        for tensor in inputs:
            tensor.grad = None
        torch.autograd.backward(results, upstream, retain_graph=True)

    return forward, backward


def points_of(count: int, device: torch.device) -> Tensor:
    """Return points along random rays through the cube, ray after ray, 32 on each."""
    generator = torch.Generator(device).manual_seed(0)
    ends = 2.0 * torch.rand(2, max(1, count // 32), 1, 3, generator=generator, device=device) - 1.0
    return torch.lerp(ends[0], ends[1], torch.linspace(0.0, 1.0, 32, device=device)[:, None]).reshape(-1, 3)


def new_grid(config: HashGridConfig, device: torch.device) -> HashGrid:
    """Return a grid as in training, with a gradient that is added to in place."""
    grid = HashGrid(config).to(device)
    grid.in_place_gradient = True
    grid.table.grad = torch.zeros_like(grid.table)
    return grid


def grid_cases(name: str, config: HashGridConfig, points: Tensor) -> list[Case]:
    """Return the look-up of features, and that of features and Jacobian."""
    grid = new_grid(config, points.device)
    table, outputs = FLOAT * grid.table.numel(), FLOAT * len(points) * grid.out_features
    rows = 8 * outputs
    positions, once = 3 * FLOAT * len(points), min(table, rows)
    return [
        Case(
            name=f"{name}, features",
            make=lambda: differentiable(lambda: grid(points)),
            bytes=positions + once + outputs,
            rows=rows,
            gradient_bytes=positions + outputs + 2 * once,
        ),
        Case(
            name=f"{name}, features and Jacobian",
            make=lambda: differentiable(lambda: grid.encode_with_jacobian(points)),
            bytes=positions + once + 4 * outputs,
            rows=rows,
            gradient_bytes=positions + 4 * outputs + 2 * once,
        ),
    ]


def mixture_case(count: int, device: torch.device) -> Case:
    """Return the fast cache's features along rays, with gradients by table, points and weights."""
    grid = new_grid(FEATURE_GRID, device)
    points = 2.0 * points_of(count * SAMPLES, device)[: count * SAMPLES].reshape(-1, SAMPLES, 3)
    weights = torch.rand(points.shape[:2], device=device)
    points.requires_grad_()
    weights.requires_grad_()
    table, outputs = FLOAT * grid.table.numel(), FLOAT * len(points) * grid.out_features
    rows, inputs = 8 * SAMPLES * outputs, 4 * FLOAT * weights.numel()
    once = min(table, rows)
    return Case(
        name="fast cache, features along rays",
        make=lambda: differentiable(lambda: grid.mixture(points, weights, 2.0), (points, weights)),
        bytes=inputs + once + outputs,
        rows=rows,
        gradient_bytes=2 * inputs + outputs + 3 * once,
    )


def directional_case(points: Tensor) -> Case:
    """Return the directional encoding of as many directions as points."""
    encoding = IntegratedDirectionalEncoding(5).to(points.device)
    directions = torch.nn.functional.normalize(points, dim=-1).requires_grad_()
    blur = torch.rand(len(points), 1, device=points.device, requires_grad=True)
    inputs, outputs = 4 * FLOAT * len(points), FLOAT * len(points) * encoding.out_features
    return Case(
        name="directional encoding",
        make=lambda: differentiable(lambda: encoding(directions, blur), (directions, blur)),
        bytes=inputs + outputs,
        gradient_bytes=2 * inputs + outputs,
    )


def march_case(count: int, device: torch.device) -> Case:
    """Return the search for the occupied stretches of rays around a ball."""
    occupancy = Occupancy((-1.0,) * 3, (1.0,) * 3, CELLS)
    axis = torch.linspace(-1.0, 1.0, CELLS)
    middles = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), dim=-1)
    occupancy.set(middles.norm(dim=-1) < 0.6)
    occupancy = occupancy.to(device)
    generator = torch.Generator(device).manual_seed(0)
    directions = torch.randn(count, 3, generator=generator, device=device)
    directions = torch.nn.functional.normalize(directions, dim=-1)
    aims = torch.rand(count, 3, generator=generator, device=device) - 0.5
    near = torch.full((count,), 2.0, device=device)
    rays = Rays(aims - 4.0 * directions, directions, near, near + 4.0)
    return Case(
        name="stretches in occupied cells",
        make=lambda: (lambda: occupancy.narrowed(rays), None),
        bytes=10 * FLOAT * count + CELLS**3,
    )


def optimiser_case(device: torch.device) -> Case:
    """Return a step of Adam on the density grid."""
    grid = new_grid(GRIDS["density grid"], device)
    optimiser = torch.optim.Adam([grid.table], fused=True)
    return Case(
        name="step of Adam on the density grid",
        make=lambda: (optimiser.step, None),
        bytes=7 * FLOAT * grid.table.numel(),
    )


def measured(case: Case, device: torch.device, repeats: int, bytes_per_s: float) -> list[dict[str, Any]]:
    """Return a row for the operation and one for its gradient, each also in plain torch."""
    times = {}
    for choice, count in (("auto", repeats), ("reference", max(2, repeats // 4))):
        with dispatch.using(choice):
            calls = case.make()
            times[choice] = [call and timed(call, device, count, cold=True) for call in calls]
    rows = []
    names = (case.name, f"{case.name}: gradient")
    sizes = ((case.bytes, case.rows), (case.gradient_bytes, 2 * case.rows))
    for name, (least, rows_bytes), fast, plain in zip(
        names, sizes, times["auto"], times["reference"], strict=True
    ):
        if fast is not None:
            limit_ms = 1e3 * least / bytes_per_s
            row = {"name": name, "bytes": least, "row_bytes": rows_bytes, "limit_ms": limit_ms}
            rows.append(row | {"kernel": fast, "plain": plain})
    return rows


def kernels(device: torch.device, repeats: int, share: int) -> dict[str, Any]:
    """Return the measured bandwidth and a row per operation, for sizes divided by `share`."""
    bytes_per_s = bandwidth(device, COPIED_BYTES // share)
    points = points_of(POINTS // share, device)
    makers: list[Callable[[], list[Case]]] = [
        *(lambda name=name, grid=grid: grid_cases(name, grid, points) for name, grid in GRIDS.items()),
        lambda: [mixture_case(RAYS // share, device)],
        lambda: [directional_case(points)],
        lambda: [march_case(max(1, POINTS // (32 * share)), device)],
        lambda: [optimiser_case(device)],
    ]
    rows = [row for make in makers for case in make() for row in measured(case, device, repeats, bytes_per_s)]
    return {"bytes_per_s": bytes_per_s, "share": share, "rows": rows}
