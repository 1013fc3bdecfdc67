"""Scenes for light bakes whose answer is known: every ray from anywhere meets the same wall, half opaque."""

from dataclasses import dataclass

import torch
from flashcache.caches.fast_cache import FastCache, FastCacheConfig
from flashcache.encoding.hash_grid import HashGridConfig
from flashcache.physical.brdf import Materials
from flashcache.physical.incident import RayLimits
from flashcache.physical.shading import ShadingPoints
from flashcache.training.light_bake import Hits


@dataclass(frozen=True)
class Fog:
    """Rays meet a wall of one material with one opacity, wherever they go; it faces their origin."""

    opacity: float
    albedo: float
    limits = RayLimits(near=0.05, far=2.0, origin_offset=0.01)

    def starts(self, count, generator):
        """Return points on the unit sphere that face outwards, seen from random sides."""
        positions, omega_o = torch.nn.functional.normalize(
            torch.randn(2, count, 3, generator=generator), dim=-1
        )
        facing = (positions * omega_o).sum(dim=-1, keepdim=True)
        omega_o = torch.where(facing < 0.0, omega_o - 2.0 * facing * positions, omega_o)
        return ShadingPoints(positions, positions, omega_o, torch.zeros(count, dtype=torch.long))

    def meet(self, rays, generator):
        """Return the wall, half a unit away."""
        opacity = rays.origins.new_full((len(rays),), self.opacity)
        distance = torch.full_like(opacity, 0.5)
        return Hits(opacity, distance, opacity, rays.origins + 0.5 * rays.directions, -rays.directions)

    def materials(self, positions):
        """Return the wall's material: diffuse, with a wide and dim highlight."""
        one = torch.ones_like(positions[:, :1])
        return Materials(self.albedo * torch.ones_like(positions), one, torch.zeros_like(one))


def small_cache(num_lights: int = 1) -> FastCache:
    """Return a fast cache that builds at once; its opacity is one half everywhere."""
    torch.manual_seed(3)
    grid = HashGridConfig(base_resolution=4, finest_resolution=8, num_levels=2, log2_table_size=12)
    config = FastCacheConfig(
        distance_grid=grid,
        feature_grid=grid,
        code_width=8,
        distance_width=8,
        distance_layers=2,
        decoder_widths=(16, 16),
    )
    cache = FastCache(config, 1.0, num_lights, (0.05, 2.0))
    with torch.no_grad():
        cache.distance_head.bias[-1] = -2.0
    return cache
