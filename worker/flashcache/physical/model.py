"""The whole inverse rendering model: caches, materials, light sampler and the space they live in."""

from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float64
from numpy import ndarray
from torch import nn

from flashcache.caches.environment import Environment, EnvironmentConfig
from flashcache.caches.fast_cache import CacheAnswer, FastCache, FastCacheConfig
from flashcache.caches.nerf_cache import NerfCache, NerfCacheConfig
from flashcache.encoding.occupancy import Occupancy, OccupancyConfig
from flashcache.encoding.turns import LightTurns
from flashcache.fields.materials import MaterialConfig, MaterialField
from flashcache.geometry.rays import Rays
from flashcache.physical.incident import RadianceSource, RayLimits, SecondaryRays
from flashcache.physical.light_sampler import LightSampler, LightSamplerConfig
from flashcache.randomness import in_blocks_of


@dataclass(frozen=True, kw_only=True, slots=True)
class ModelConfig:
    """Sizes of every part of the model."""

    nerf: NerfCacheConfig = field(default_factory=NerfCacheConfig)
    fast: FastCacheConfig = field(default_factory=FastCacheConfig)
    environment: EnvironmentConfig = field(default_factory=EnvironmentConfig)
    materials: MaterialConfig = field(default_factory=MaterialConfig)
    light_sampler: LightSamplerConfig = field(default_factory=LightSamplerConfig)
    occupancy: OccupancyConfig = field(default_factory=OccupancyConfig)


@dataclass(frozen=True, kw_only=True, slots=True)
class Domain:
    """The space that a scene occupies, in scene units: all that a model needs to know about its scene."""

    bounds_min: tuple[float, float, float]
    bounds_max: tuple[float, float, float]
    primary: tuple[float, float]
    """Near and far along camera rays."""
    secondary: tuple[float, float]
    """Near and far along rays that leave a surface."""
    contraction_radius: float
    lights: tuple[str, ...]
    origin_offset: float = 0.0
    """Distance of secondary rays' origins from the surface; 0: a fifth of their near distance."""
    fast_radius: float = 0.0
    """Distance from the origin within which rays teach the fast cache; 0: the contraction radius."""
    rotations_deg: tuple[float, ...] = ()
    """Angle of every light where they are one environment turned about +z; empty where each has its own."""
    known_lights: tuple[str, ...] = ()
    """Lights whose environment is given and not learned; with `rotations_deg`, any name means all."""
    turns: tuple[tuple[float, ...], ...] = ()
    """Where the one light turns from photograph to photograph: its turns, row-major rotations from the world
    to the light's frame, the identity first. A light index is then the number of a turn."""


class InverseModel(nn.Module):
    """Everything that is learned about a scene."""

    def __init__(self, config: ModelConfig, domain: Domain) -> None:
        super().__init__()
        radius, num_lights = domain.contraction_radius, len(domain.lights)
        assert not domain.turns or num_lights == 1, "only one light can turn"
        turns = LightTurns(domain.turns) if domain.turns else None
        near, far = domain.secondary
        self.config = config
        self.domain = domain
        occupancy = None
        if config.occupancy.cells:
            occupancy = Occupancy(domain.bounds_min, domain.bounds_max, config.occupancy.cells)
        self.nerf = NerfCache(config.nerf, radius, num_lights, domain.secondary, turns, occupancy)
        self.environment = Environment(
            config.environment,
            num_lights,
            rotations_deg=domain.rotations_deg,
            known=tuple(domain.lights.index(light) for light in domain.known_lights),
            turns=turns,
        )
        self.materials = MaterialField(config.materials, radius)
        self.fast = FastCache(config.fast, radius, num_lights, domain.secondary, turns=turns)
        self.light_sampler = LightSampler(config.light_sampler, radius, num_lights, turns)
        # Published scenes have a near distance of 0.05 and an offset of 0.01 (authors' code).
        self.limits = RayLimits(near=near, far=far, origin_offset=domain.origin_offset or near / 5.0)

    def light_at(self, light: int, turn: Float64[ndarray, "3 3"] | None) -> int:
        """Return the light index of a photograph under light number `light` with the given turn of the light.

        It is `light` where lights do not turn; a photograph without a turn is lit as the reference.
        """
        turns = self.environment.turns
        if turns is None:
            return light
        return 0 if turn is None else turns.index_of(torch.from_numpy(np.asarray(turn)))

    def ask_nerf(
        self, rays: SecondaryRays, generator: torch.Generator | None, *, jitter: bool = False
    ) -> CacheAnswer:
        """Return the NeRF cache's answers for secondary rays; see `NerfCache.incident`."""
        near = rays.origins.new_full((len(rays),), rays.near)
        far = rays.origins.new_full((len(rays),), rays.far)
        inside = Rays(rays.origins, rays.directions, near, far)
        with in_blocks_of(len(rays) // rays.num_points if rays.num_points else 1):
            return self.nerf.incident(inside, rays.light_index, generator, jitter=jitter)

    def nerf_source(self, generator: torch.Generator | None, *, jitter: bool = False) -> RadianceSource:
        """Return the NeRF cache as a source for estimators; arguments as for `NerfCache.incident`."""
        return lambda rays: self.ask_nerf(rays, generator, jitter=jitter)

    def fast_source(self) -> RadianceSource:
        """Return the fast cache as a source for the estimators."""
        return lambda rays: self.fast(rays.origins, rays.directions, rays.light_index)
