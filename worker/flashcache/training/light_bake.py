"""Adaptation of the fast cache's radiance to an environment that no photograph shows.

For a secondary ray, the cache should return the premultiplied radiance of its hit point: A L_o(x, -omega),
with the point x and its outgoing radiance L_o under the new environment. L_o is the two-term estimate of
paper Eq. 9: many directions that the adapting cache itself answers, which includes all further bounces, and
a few whose hit points are shaded once more, minus the cache's answer to the same rays. The ends of rays
(opacity, distances, weights of the samples) are geometry and stay as they were trained.
"""

import copy
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor, nn

from flashcache.caches.fast_cache import CacheAnswer, FastCache
from flashcache.config import Rates
from flashcache.errors import ConfigError
from flashcache.geometry.directions import facing
from flashcache.losses.photometric import consistency
from flashcache.physical.brdf import Materials
from flashcache.physical.estimator import DirectionCounts, EstimatorConfig, estimate
from flashcache.physical.incident import Incident, LightSources, RadianceSource, RayLimits, SecondaryRays
from flashcache.physical.sampling import CosineLobe, GgxLobe, Strategy
from flashcache.physical.shading import ShadingPoints
from flashcache.randomness import generator_for
from flashcache.training.distillation_rays import relit_rays
from flashcache.training.optimiser import (
    StepRecord,
    apply_gradients,
    build_optimiser,
    parameter_groups,
    set_rates,
)
from flashcache.training.schedule import rate_factor

STAGE = "bake"
_ESTIMATOR = EstimatorConfig(stratified=True)
_BISECTIONS = 24
_BOUNCES = 4
"""Number of times that the mean is set before the first step; each adds one more reflection."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LightBakeConfig:
    """Settings of a light bake; every number is ours, because the paper has no such step."""

    num_steps: int = 300
    num_points: int = 96
    """Surface points per step whose secondary rays are trained."""
    taught: DirectionCounts = field(default_factory=lambda: DirectionCounts(cosine=2, sampler=0, specular=2))
    """Secondary rays per point, distributed as in relighting."""
    fast: DirectionCounts = field(default_factory=lambda: DirectionCounts.split(16))
    """Directions per hit point that the adapting cache answers."""
    exact: DirectionCounts = field(default_factory=lambda: DirectionCounts(cosine=1, sampler=1, specular=2))
    """Directions of the correction; none disables it."""
    last: DirectionCounts = field(default_factory=lambda: DirectionCounts(cosine=1, sampler=1, specular=2))
    """Directions that shade what a ray of the correction meets."""
    rates: Rates = field(default_factory=lambda: Rates(grid=1e-2, network=2e-3))
    final_rate: float = 0.05
    """Share of the peak rates at the last step."""

    def __post_init__(self) -> None:
        if self.num_steps < 1 or self.num_points < 1:
            raise ConfigError("a light bake needs at least one step and one point")
        for name in ("taught", "fast", "last"):
            counts: DirectionCounts = getattr(self, name)
            if counts.cosine + counts.sampler < 1 or counts.specular < 1:
                raise ConfigError(
                    f"{name} needs at least one diffuse and one specular direction, got {counts}"
                )


class Hits(NamedTuple):
    """The hit points of secondary rays: one each, drawn in proportion to its share of the ray."""

    opacity: Float[Tensor, " rays"]
    distance: Float[Tensor, " rays"]
    weight: Float[Tensor, " rays"]
    """Factor of the point's radiance; its mean is the opacity."""
    positions: Float[Tensor, "rays 3"]
    normal: Float[Tensor, "rays 3"]


@runtime_checkable
class BakeScene(Protocol):
    """The frozen part: shape and materials."""

    @property
    def limits(self) -> RayLimits:
        """The limits of secondary rays."""

    def starts(self, count: int, generator: torch.Generator) -> ShadingPoints:
        """Return at most `count` surface points, as cameras around the object see them."""

    def meet(self, rays: SecondaryRays, generator: torch.Generator) -> Hits:
        """Return the hit points of secondary rays."""

    def materials(self, positions: Float[Tensor, "points 3"]) -> Materials:
        """Return the materials at points."""


@runtime_checkable
class KnownLight(Protocol):
    """An environment and its sampler."""

    @property
    def sampler(self) -> Strategy: ...

    def __call__(self, directions: Tensor, light_index: Tensor) -> Tensor:
        """Return radiance [rays, 3] from unit directions [rays, 3]; the index is ignored."""


def adaptable(fast: FastCache, light: int) -> FastCache:
    """Return a copy of a fast cache with the head of training light `light` alone, its geometry frozen."""
    adapted = copy.deepcopy(fast)
    if fast.num_lights > 1:
        head = nn.Linear(fast.decoder_head.in_features, 3).to(fast.decoder_head.weight)
        rows = slice(3 * light, 3 * light + 3)
        with torch.no_grad():
            head.weight.copy_(fast.decoder_head.weight[rows])
            head.bias.copy_(fast.decoder_head.bias[rows])
        adapted.decoder_head, adapted.num_lights = head, 1
    adapted.requires_grad_(False)
    for part in (adapted.feature_grid, adapted.decoder, adapted.decoder_head):
        part.requires_grad_(True)
    return adapted


class LightBake:
    """The state of a light bake; call `step` until `finished`. `model` is the adapting fast cache."""

    def __init__(
        self,
        fast: FastCache,
        scene: BakeScene,
        light: KnownLight,
        config: LightBakeConfig,
        *,
        brightness: float,
        seed: int,
    ) -> None:
        """`fast` is changed; `brightness` (mean radiance of the light) is the unit of the loss."""
        self.model, self.scene, self.light = fast, scene, light
        self.config, self.brightness, self.seed = config, max(brightness, 1e-8), seed
        parts = [(part, config.rates) for part in (fast.feature_grid, fast.decoder, fast.decoder_head)]
        self.optimiser = build_optimiser(parameter_groups(parts))
        self.steps_done = 0
        self.num_skipped = 0

    @property
    def finished(self) -> bool:
        """Whether all steps have been taken."""
        return self.steps_done >= self.config.num_steps

    def step(self) -> StepRecord:
        """Take one step."""
        config, step = self.config, self.steps_done
        set_rates(self.optimiser, rate_factor(step, config.num_steps, 0, config.final_rate, 0.0))
        generator = generator_for(self.seed, STAGE, step, "rays", next(self.model.parameters()).device)
        with torch.no_grad():
            rays = self.taught_rays(generator)
            if step == 0:
                for _ in range(_BOUNCES):
                    self._calibrate(rays, self.radiance(rays, generator))
            wanted = self.radiance(rays, generator)
        answer = self.model(rays.origins, rays.directions, rays.light_index)
        unit = self.brightness
        # Relative to the cache's own answer: dark places count, and noise of the target shifts no mean.
        loss = consistency(answer.near_radiance / unit, wanted / unit, torch.ones_like(answer.opacity))
        applied = apply_gradients(self.optimiser, loss)
        self.steps_done += 1
        self.num_skipped += not applied
        residual = (answer.near_radiance.detach() - wanted).mean(dim=0) / unit
        return StepRecord(
            step=self.steps_done,
            num_steps=config.num_steps,
            loss=float(residual.abs().mean()),
            psnr=0.0,
            terms={"bias": float(residual.mean())},
            skipped=not applied,
        )

    def _calibrate(self, rays: SecondaryRays, wanted: Float[Tensor, "rays 3"]) -> None:
        """Shift the colour's biases until the mean radiance fits, by bisection: the mean rises with them.

        The new light may be any number of times as bright as the trained one.
        """
        head = self.model.decoder_head
        trained = head.bias.clone()
        low, high = torch.full_like(trained, -20.0), torch.full_like(trained, 20.0)
        high = high + wanted.mean(dim=0).clamp_min(0.0) * 4.0
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            head.bias.copy_(trained + middle)
            mean = self._fast(rays).near_radiance.mean(dim=0)
            above = mean > wanted.mean(dim=0)
            low, high = torch.where(above, low, middle), torch.where(above, middle, high)

    def taught_rays(self, generator: torch.Generator) -> SecondaryRays:
        """Return secondary rays as relighting draws them: around the normal and around the mirror lobe."""
        points = self.scene.starts(self.config.num_points, generator)
        alpha = self.scene.materials(points.positions).alpha
        return relit_rays(points, alpha, self.config.taught, self.scene.limits, generator)

    def radiance(self, rays: SecondaryRays, generator: torch.Generator) -> Float[Tensor, "rays 3"]:
        """Return an estimate of the premultiplied radiance that arrives along `rays` from what they meet.

        Its mean is the physical model's, but for how far the cache is from its own equilibrium in what comes
        by two bounces more. Source: paper Eqs. 9 and 11.
        """
        met = self.scene.meet(rays, generator)
        points = _points(met, rays)
        materials = self.scene.materials(points.positions)
        radiance = self._shaded(points, materials, self._fast, self.config.fast, generator)
        if self.config.exact.total:
            radiance = radiance + self._shaded(
                points,
                materials,
                lambda rays: self._correction(rays, generator),
                self.config.exact,
                generator,
            )
        return met.weight[:, None] * radiance

    def _shaded(
        self,
        points: ShadingPoints,
        materials: Materials,
        source: RadianceSource,
        counts: DirectionCounts,
        generator: torch.Generator,
    ) -> Tensor:
        # Lobes with directions of their own: the loss is sensitive to noise, and white walls are diffuse.
        sampler, shared = self.light.sampler, counts.specular // 2
        lobe = GgxLobe(points.omega_o, points.normal, materials.alpha)
        return estimate(
            points,
            materials,
            LightSources(source, self.light, self.scene.limits),
            diffuse=[(CosineLobe(points.normal), counts.cosine), (sampler, counts.sampler)],
            specular=[(lobe, counts.specular - shared), (sampler, shared)],
            config=_ESTIMATOR,
            generator=generator,
        ).rgb

    def _fast(self, rays: SecondaryRays) -> CacheAnswer:
        return self.model(rays.origins, rays.directions, rays.light_index)

    def _correction(self, rays: SecondaryRays, generator: torch.Generator) -> Incident:
        """Return what rays meet, shaded once more, minus the cache's answer.

        The estimator adds (1 - opacity) times the environment: an opacity of 1 + A - a makes that (a - A).
        """
        met = self.scene.meet(rays, generator)
        points = _points(met, rays)
        materials = self.scene.materials(points.positions)
        shaded = self._shaded(points, materials, self._fast, self.config.last, generator)
        known = self._fast(rays)
        near = met.weight[:, None] * shaded - known.near_radiance
        return Incident(near, 1.0 + met.opacity - known.opacity, met.distance)


def _points(met: Hits, rays: SecondaryRays) -> ShadingPoints:
    """Return the met points as surfaces that face where their rays came from."""
    omega_o = -rays.directions
    return ShadingPoints(met.positions, facing(met.normal, omega_o), omega_o, rays.light_index)
