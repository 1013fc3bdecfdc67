"""A small untrained model whose density is a ball, so that exports have a surface to show."""

from dataclasses import replace

import torch
from flashcache.caches.environment import EnvironmentConfig
from flashcache.caches.fast_cache import FastCacheConfig
from flashcache.caches.nerf_cache import NerfCacheConfig
from flashcache.encoding.hash_grid import HashGrid, HashGridConfig
from flashcache.encoding.occupancy import OccupancyConfig
from flashcache.fields.appearance import AppearanceConfig
from flashcache.fields.density import DensityConfig, NormalConfig
from flashcache.fields.materials import MaterialConfig
from flashcache.physical.light_sampler import LightSamplerConfig
from flashcache.physical.model import Domain, InverseModel, ModelConfig
from flashcache.volume.proposal_sampling import SampleCounts

RADIUS = 0.5
BOUND = 1.2
DENSITY_RESOLUTION = 16


def small_grid(*, half_extent: float = 1.0, num_features: int = 2) -> HashGridConfig:
    """Return a grid with a dense and a hashed level."""
    return HashGridConfig(
        base_resolution=8,
        finest_resolution=40,
        num_levels=2,
        num_features=num_features,
        log2_table_size=12,
        half_extent=half_extent,
    )


def small_config(*, own_normal_grid: bool, softplus_beta: float | None, distance_layers: int) -> ModelConfig:
    """Return sizes that build in milliseconds; the arguments choose between forms the graphs must mirror."""
    density_grid = HashGridConfig(
        base_resolution=DENSITY_RESOLUTION, finest_resolution=DENSITY_RESOLUTION, num_features=1
    )
    density = DensityConfig(grid=density_grid, width=8, num_layers=1, softplus_beta=softplus_beta)
    counts = SampleCounts(first=8, second=8, final=8)
    return ModelConfig(
        nerf=NerfCacheConfig(
            proposals=(density, density),
            density=density,
            normals=NormalConfig(own_grid=small_grid() if own_normal_grid else None, width=8),
            appearance=AppearanceConfig(
                grid=small_grid(),
                bottleneck=8,
                factor_width=8,
                num_degrees=2,
                reflection_width=8,
                reflection_layers=1,
            ),
            primary_counts=counts,
            secondary_counts=counts,
        ),
        fast=FastCacheConfig(
            distance_grid=small_grid(),
            feature_grid=small_grid(half_extent=2.0, num_features=4),
            code_width=8,
            distance_width=16,
            distance_layers=distance_layers,
            decoder_widths=(8, 12),
        ),
        environment=EnvironmentConfig(width=8, num_layers=1, last_width=8),
        materials=MaterialConfig(grid=small_grid(), width=8),
        light_sampler=LightSamplerConfig(grid=small_grid(), width=8, num_lobes=2),
    )


def sphere_model(
    *,
    own_normal_grid: bool = True,
    softplus_beta: float | None = 10.0,
    distance_layers: int = 4,
    lights: tuple[str, ...] = ("day", "night"),
    output_scale: float = 1.0,
    turns: tuple[tuple[float, ...], ...] = (),
    cells: int = 0,
    gloss_grid: bool = False,
) -> InverseModel:
    """Return a model of a ball of radius 0.5 at the origin; all other parameters are random, none is tiny.

    With an `output_scale` the same features lie in tables as many times smaller. With `cells` along a side of
    its box, it knows that the upper quarter of the ball and all outside of it is empty. With `gloss_grid`,
    GGX width and metalness have a grid of their own.
    """
    torch.manual_seed(7)
    config = small_config(
        own_normal_grid=own_normal_grid, softplus_beta=softplus_beta, distance_layers=distance_layers
    )
    config = replace(config, occupancy=OccupancyConfig(cells=cells))
    if gloss_grid:
        own = replace(small_grid(), finest_resolution=20)
        config = replace(config, materials=replace(config.materials, gloss_grid=own))
    domain = Domain(
        bounds_min=(-BOUND,) * 3,
        bounds_max=(BOUND,) * 3,
        primary=(2.0, 5.0),
        secondary=(0.05, 2.0),
        contraction_radius=1.0,
        lights=lights,
        turns=turns,
    )
    model = InverseModel(config, domain)
    with torch.no_grad():
        for name, parameter in model.named_parameters():
            if name.endswith("table"):
                parameter.normal_(std=0.5)
            elif not parameter.any():
                parameter.normal_(std=0.3)
        for field in (model.nerf.density, *model.nerf.proposals):
            make_ball(field)
        for grid in (module for module in model.modules() if isinstance(module, HashGrid)):
            grid.output_scale = output_scale
            grid.table.div_(output_scale)
    if model.nerf.occupancy is not None:
        middles = ((torch.arange(cells) + 0.5) / cells * 2.0 - 1.0) * BOUND
        x, y, z = torch.meshgrid(middles, middles, middles, indexing="ij")
        model.nerf.occupancy.set((x * x + y * y + z * z < 0.8**2) & (z < 0.4))
    return model.eval()


@torch.no_grad()
def make_ball(field: torch.nn.Module, radius: float = RADIUS) -> None:
    """Set the density to about exp(40 (radius - |x|)): the first hidden unit is a distance.

    In contracted coordinates; the field has one level of `DENSITY_RESOLUTION`.
    """
    n = DENSITY_RESOLUTION
    centres = (torch.arange(n) + 0.5) * 2.0 / n - 1.0
    z, y, x = torch.meshgrid(centres, centres, centres, indexing="ij")
    # Shifted upwards, so that the activation is in its linear part.
    field.grid.table.copy_((2.0 - torch.stack([x, y, z], dim=-1).norm(dim=-1)).reshape(-1, 1))
    field.network.layers[0].weight[0] = 1.0
    field.network.layers[0].bias[0] = 0.0
    field.head.weight.zero_()
    field.head.weight[0, 0] = 40.0
    field.head.bias.fill_(-40.0 * (2.0 - radius) + 3.0)
