"""Small caches whose parameters are random, with outputs that vary as much as those of trained ones."""

from dataclasses import replace

import torch
from flashcache.caches.nerf_cache import NerfCache, NerfCacheConfig
from flashcache.encoding.hash_grid import HashGridConfig
from flashcache.encoding.occupancy import Occupancy
from flashcache.fields.appearance import AppearanceConfig
from flashcache.fields.density import DensityConfig, NormalConfig
from flashcache.geometry.rays import Rays
from flashcache.volume.proposal_sampling import SampleCounts

GRID = HashGridConfig(finest_resolution=64, log2_table_size=12)
PROPOSAL = DensityConfig(grid=replace(GRID, num_features=1), width=16, num_layers=1)
CONFIG = NerfCacheConfig(
    proposals=(PROPOSAL, replace(PROPOSAL, num_layers=2, softplus_beta=None)),
    density=DensityConfig(grid=replace(GRID, output_scale=2.0), width=24, num_layers=1, bias=0.5),
    normals=NormalConfig(own_grid=GRID, width=16),
    appearance=AppearanceConfig(
        grid=GRID,
        bottleneck=12,
        factor_width=8,
        num_degrees=4,
        view_frequencies=2,
        reflection_width=20,
        reflection_layers=2,
    ),
    secondary_counts=SampleCounts(first=12, second=10, final=8),
    secondary_colours=1,
)
SHAPES = {
    "small": CONFIG,
    "joined": replace(
        CONFIG, appearance=replace(CONFIG.appearance, reflection_layers=4, view_frequencies=-1)
    ),
    "linear normals": replace(CONFIG, normals=NormalConfig()),
    "flattened": replace(CONFIG, exponent=0.4),
}


def trained_like(config: NerfCacheConfig = CONFIG, num_lights: int = 1, *, cells: bool = True) -> NerfCache:
    """Return a cache, with `cells` in a box whose middle is empty."""
    torch.manual_seed(0)
    occupancy = None
    if cells:
        occupancy = Occupancy((-0.9, -0.8, -1.0), (0.9, 1.0, 0.8), 24)
        places = torch.stack(torch.meshgrid(*[torch.linspace(-1.0, 1.0, 24)] * 3, indexing="ij"), dim=-1)
        radius = places.norm(dim=-1)
        occupancy.set((radius > 0.35) & (radius < 0.9))
    made = NerfCache(config, 1.2, num_lights, (0.05, 2.0), occupancy=occupancy)
    with torch.no_grad():
        for name, parameter in made.named_parameters():
            if name.endswith("table"):
                parameter.normal_(0.0, 0.5)
            if name.endswith("bias"):
                parameter.normal_(0.0, 0.3)
    return made


def secondary_rays(count: int, seed: int = 1) -> Rays:
    """Return rays from points in and around the box; some meet no cell."""
    generator = torch.Generator().manual_seed(seed)
    origins = 0.7 * torch.randn(count, 3, generator=generator)
    directions = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)
    return Rays(origins, directions, torch.full((count,), 0.05), torch.full((count,), 2.0))
