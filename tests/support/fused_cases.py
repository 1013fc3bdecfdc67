"""Inputs on which fused kernels of a GPU are compared with plain torch, and what they give there.

Everything is computed on the device and in the precision of its inputs, by the product's own functions: fused
where `dispatch.is_fused` says so, in plain torch elsewhere.
"""

import torch
from flashcache.caches.fast_cache import FastCache, FastCacheConfig
from flashcache.encoding.directional import IntegratedDirectionalEncoding
from flashcache.encoding.hash_grid import HashGrid, HashGridConfig
from flashcache.encoding.occupancy import Occupancy
from flashcache.geometry.rays import Rays
from flashcache.kernels import dispatch
from torch import Tensor, nn

Answers = dict[str, Tensor]

GRIDS = {
    "2 features": HashGridConfig(finest_resolution=64, log2_table_size=12, half_extent=2.0),
    "3 features": HashGridConfig(num_features=3, num_levels=2, log2_table_size=12, half_extent=2.0),
    "8 features": HashGridConfig(num_features=8, num_levels=3, log2_table_size=12, output_scale=10.0),
}
DEGREES = (1, 3, 5)
RADIUS = 1.5


def _random(*shape: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(sum(shape)))


def _leaf(values: Tensor, like: Tensor) -> Tensor:
    return values.to(like).requires_grad_()


def mixture(grid: HashGrid, num_rays: int = 150, num_samples: int = 5) -> Answers:
    """Return a mixture, with points in and around the ball of contraction, and its gradients."""
    with torch.no_grad():
        grid.table.copy_(_random(*grid.table.shape))
    points = RADIUS * _random(num_rays, num_samples, 3)
    points[0] = 0.0
    points[1, :, 0] = 1e6
    points, weights = _leaf(points, grid.table), _leaf(_random(num_rays, num_samples), grid.table)
    mixed = grid.mixture(points, weights, RADIUS)
    mixed.backward(_random(*mixed.shape).to(mixed))
    return {"mixture": mixed, "points": points.grad, "weights": weights.grad, "table": grid.table.grad}


def fast_cache(device: torch.device) -> Answers:
    """Return the fast cache's answers, and the gradients of its parameters and inputs."""
    torch.manual_seed(0)
    sizes = {"code_width": 8, "distance_width": 8, "distance_layers": 2, "decoder_widths": (8, 8)}
    config = FastCacheConfig(
        distance_grid=GRIDS["2 features"], feature_grid=GRIDS["2 features"], num_samples=5, **sizes
    )
    cache = FastCache(config, RADIUS, 2, (0.05, 2.0))
    for parameter in cache.parameters():
        nn.init.normal_(parameter, std=0.3)
    cache = cache.to(device)
    table = cache.feature_grid.table
    origins, directions = _leaf(_random(60, 3), table), _leaf(_random(61, 3)[1:], table)
    found = cache(origins, directions, torch.arange(60, device=device) % 2)
    found.near_radiance.backward(_random(60, 3).to(table))
    named = {name: parameter.grad for name, parameter in cache.named_parameters()}
    return {"radiance": found.near_radiance, "origins": origins.grad, "directions": directions.grad} | named


def directional(encoding: IntegratedDirectionalEncoding, count: int = 70) -> Answers:
    """Return encoded directions, poles among them, and the gradients by direction and blur."""
    directions = torch.nn.functional.normalize(_random(count, 3), dim=-1)
    directions[0], directions[1] = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([0.0, 0.0, -1.0])
    blur = _random(count, 1).abs()
    blur[2] = 0.0
    directions, blur = _leaf(directions, encoding.rates), _leaf(blur, encoding.rates)
    encoded = encoding(directions, blur)
    encoded.backward(_random(*encoded.shape).to(encoded))
    return {"encoded": encoded, "directions": directions.grad, "blur": blur.grad}


def stretches(device: torch.device, count: int = 200) -> Answers:
    """Return the stretches of rays of different lengths through a lattice with a ball."""
    occupancy = Occupancy((-1.0, -1.0, -2.0), (1.0, 1.0, 2.0), 24)
    axis = torch.arange(24) - 11.5
    middles = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), dim=-1)
    occupancy.set(middles.norm(dim=-1) < 7.0)
    directions = torch.nn.functional.normalize(_random(count, 3), dim=-1)
    near = 2.0 * _random(count).abs()
    rays = Rays(
        0.5 * _random(count + 1, 3)[1:] - 3.0 * directions,
        directions,
        near,
        near + 3.0 * _random(count + 2)[2:].abs(),
    )
    rays.far[0] = rays.near[0]
    rays = Rays(*(part.to(device) for part in (rays.origins, rays.directions, rays.near, rays.far)))
    narrow = occupancy.to(device).narrowed(rays)
    return {"near": narrow.near, "far": narrow.far}


def answers(name: str, device: torch.device, dtype: torch.dtype = torch.float32) -> dict[str, Answers]:
    """Return what the operation `name` gives in its cases."""
    if name == "mixture":
        return {case: mixture(HashGrid(config).to(device, dtype)) for case, config in GRIDS.items()}
    if name == "directional":
        encodings = {f"{count} degrees": IntegratedDirectionalEncoding(count) for count in DEGREES}
        return {case: directional(encoding.to(device, dtype)) for case, encoding in encodings.items()}
    return {"ball": stretches(device)}


def assert_as_exact(name: str, found: dict[str, Answers], device: torch.device) -> None:
    """Assert that an operation is as close to double precision as plain torch in single precision is."""
    with dispatch.using("reference"):
        plain = answers(name, device)
        exact = answers(name, device, torch.float64)
    for case, wanted in exact.items():
        assert found[case].keys() == wanted.keys()
        for what, value in wanted.items():
            errors = [(one[case][what].double() - value).abs().max() for one in (found, plain)]
            allowed = 3.0 * errors[1] + 1e-6 * value.abs().max().clamp_min(1.0)
            assert errors[0] <= allowed, (case, what, errors)
