"""The whole inverse rendering model: caches, materials, light sampler and the space they live in."""

from dataclasses import dataclass, field

import torch
from torch import nn

from flashcache.caches.environment import Environment, EnvironmentConfig
from flashcache.caches.fast_cache import FastCache, FastCacheConfig
from flashcache.caches.nerf_cache import CacheAnswer, NerfCache, NerfCacheConfig
from flashcache.fields.materials import MaterialConfig, MaterialField
from flashcache.geometry.rays import Rays
from flashcache.physical.incident import RadianceSource, RayLimits, SecondaryRays
from flashcache.physical.light_sampler import LightSampler, LightSamplerConfig


@dataclass(frozen=True, kw_only=True, slots=True)
class ModelConfig:
    """Sizes of every part of the model."""

    nerf: NerfCacheConfig = field(default_factory=NerfCacheConfig)
    fast: FastCacheConfig = field(default_factory=FastCacheConfig)
    environment: EnvironmentConfig = field(default_factory=EnvironmentConfig)
    materials: MaterialConfig = field(default_factory=MaterialConfig)
    light_sampler: LightSamplerConfig = field(default_factory=LightSamplerConfig)


@dataclass(frozen=True, kw_only=True, slots=True)
class Domain:
    """The space a scene occupies, scene units; what a model must know of its scene."""

    bounds_min: tuple[float, float, float]
    bounds_max: tuple[float, float, float]
    primary: tuple[float, float]
    """Near and far along camera rays."""
    secondary: tuple[float, float]
    """Near and far along rays that leave a surface."""
    contraction_radius: float
    lights: tuple[str, ...]


class InverseModel(nn.Module):
    """Everything that is learned about a scene."""

    def __init__(self, config: ModelConfig, domain: Domain) -> None:
        super().__init__()
        radius, num_lights = domain.contraction_radius, len(domain.lights)
        near, far = domain.secondary
        self.config = config
        self.domain = domain
        self.nerf = NerfCache(config.nerf, radius, num_lights)
        self.environment = Environment(config.environment, num_lights)
        self.materials = MaterialField(config.materials, radius)
        self.fast = FastCache(config.fast, radius, num_lights, near, far)
        self.light_sampler = LightSampler(config.light_sampler, radius, num_lights)
        self.limits = RayLimits(near=near, far=far)

    def ask_nerf(self, rays: SecondaryRays, generator: torch.Generator | None) -> CacheAnswer:
        """Return what the NeRF cache sees along secondary rays."""
        near = rays.origins.new_full((len(rays),), rays.near)
        far = rays.origins.new_full((len(rays),), rays.far)
        inside = Rays(rays.origins, rays.directions, near, far)
        return self.nerf.incident(inside, rays.light_index, generator)

    def nerf_source(self, generator: torch.Generator | None) -> RadianceSource:
        """Return the NeRF cache as the estimators see it; see `NerfCache.incident` for the generator."""
        return lambda rays: self.ask_nerf(rays, generator)

    def fast_source(self) -> RadianceSource:
        """Return the fast cache as the estimators see it."""
        return lambda rays: self.fast(rays.origins, rays.directions, rays.light_index)
