"""Stage two: materials, light, fast cache and sampler learn together with the NeRF cache (supplement 2.4).

Names: pass A and pass B are two independent estimates of the same pixels; with the same samples in both,
the squared error would gain the estimator's variance (supplement Eq. 2).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from flashcache.caches.nerf_cache import Geometry
from flashcache.config import StageTwoConfig
from flashcache.data.ray_batches import RayBatch, TrainingPixels
from flashcache.fields.appearance import Appearance
from flashcache.losses.consistency import consistency
from flashcache.losses.fast_cache import fast_cache_loss
from flashcache.losses.light_sampler import light_sampler_loss
from flashcache.losses.photometric import cache_photometric, mask_loss, physical_photometric
from flashcache.losses.smoothness import pseudo_albedo, smoothness
from flashcache.physical.brdf import Materials
from flashcache.physical.estimator import control_variate
from flashcache.physical.light_sampler import VmfMixture
from flashcache.physical.model import InverseModel
from flashcache.physical.shading import Estimate, ShadingPoints
from flashcache.randomness import generator_for
from flashcache.training.optimiser import (
    Rates,
    StepRecord,
    apply_gradients,
    build_optimiser,
    parameter_groups,
    set_rates,
)
from flashcache.training.schedule import rate_factor
from flashcache.training.stage_one import masked_psnr, shape_terms
from flashcache.volume.quadrature import PointDraw, composite, draw_points, median_point

STAGE = "joint"


@dataclass(frozen=True, slots=True)
class Pass:
    """One independent estimate of a batch of pixels: K shaded points per ray."""

    picture: Tensor
    """Premultiplied radiance [rays, 3]."""
    estimate: Estimate
    points: ShadingPoints
    materials: Materials
    mixture: VmfMixture | None
    index: Tensor
    """Position of each shaded point among all points of the batch."""


class StageTwo:
    """The state of stage two; call `step` until `finished`."""

    def __init__(
        self, model: InverseModel, pixels: TrainingPixels, config: StageTwoConfig, *, seed: int
    ) -> None:
        self.model, self.pixels, self.config, self.seed = model, pixels, config, seed
        light = Rates(grid=config.environment_rate, network=config.environment_rate)
        parts = [
            (model.materials, config.material_rates),
            (model.environment, light),
            (model.fast, config.fast_rates),
            (model.light_sampler, config.fast_rates),
        ]
        if config.cache_weight:
            parts += [
                (part, config.cache_rates)
                for part in (model.nerf.density, model.nerf.normals, model.nerf.appearance)
            ]
        model.nerf.requires_grad_(bool(config.cache_weight))
        model.nerf.proposals.requires_grad_(False)
        self.optimiser = build_optimiser(parameter_groups(parts))
        self.steps_done = 0
        self.num_skipped = 0

    @property
    def finished(self) -> bool:
        """Whether all steps have been taken."""
        return self.steps_done >= self.config.num_steps

    def step(self) -> StepRecord:
        """Take one training step."""
        config, step = self.config, self.steps_done
        device = self.pixels.device
        generator = generator_for(self.seed, STAGE, step, "rays", device)
        batch = self.pixels.draw(config.num_rays, generator)
        with_normals = bool(config.cache_weight and config.normal_weight) and step % config.normal_every == 0
        geometry = self.model.nerf.trace(
            batch.rays,
            exponent=config.proposal_exponent,
            generator=generator,
            num_derived=round(config.normal_rays * len(batch)) if with_normals else 0,
        )
        appearance = self.model.nerf.outgoing(geometry, batch.rays.directions, batch.light_index)
        cache = composite(geometry.weights, appearance.radiance)
        terms: dict[str, Tensor] = {}
        if config.cache_weight:
            terms |= self._cache_terms(batch, geometry, cache, generator, with_normals)
        first = self.shade(batch, geometry, generator_for(self.seed, STAGE, step, "pass A", device))
        picture = first.picture
        if step >= config.warmup_steps:
            with torch.set_grad_enabled(config.symmetric):
                second = self.shade(batch, geometry, generator_for(self.seed, STAGE, step, "pass B", device))
            picture = 0.5 * (first.picture + second.picture.detach())
            terms |= self._physical_terms(batch, cache, first, second)
            terms |= self._consistency_terms(batch, geometry, first)
            terms |= self._material_terms(batch, geometry, appearance, first, generator)
        terms |= self._secondary_terms(first)
        loss = torch.stack(list(terms.values())).sum()
        factor = rate_factor(step, config.num_steps, 0, config.final_rate, config.decay_from)
        set_rates(self.optimiser, factor)
        applied = apply_gradients(self.optimiser, loss)
        self.steps_done += 1
        self.num_skipped += not applied
        return StepRecord(
            step=self.steps_done,
            num_steps=config.num_steps,
            loss=float(loss.detach()),
            psnr=masked_psnr(picture.detach(), batch),
            terms={name: float(value.detach()) for name, value in terms.items()},
            skipped=not applied,
        )

    def scale(self) -> dict[str, float]:
        """Return the mean radiance of each light and the mean albedo on the surface.

        Their product is fixed by the photographs and their ratio is not: a steady drift of the ratio late in
        training says that the priors lost hold of it.
        """
        generator = generator_for(self.seed, STAGE, self.steps_done, "scale", self.pixels.device)
        with torch.no_grad():
            batch = self.pixels.draw(256, generator)
            geometry = self.model.nerf.trace(batch.rays, exponent=1.0, generator=None)
            albedo = self.model.materials(geometry.samples.positions.reshape(-1, 3)).albedo
            seen = composite(geometry.weights, albedo).sum(dim=0) / geometry.weights.sum().clamp_min(1e-6)
            found = {"albedo_mean": float(seen.mean())}
            for index, light in enumerate(self.model.domain.lights):
                image = self.model.environment.image(16, index)
                up = torch.linspace(0.0, torch.pi, 33, device=image.device)[1::2].sin()[:, None, None]
                found[f"environment_mean_{light}"] = float((image * up).mean() / up.mean())
        return found

    def shade(self, batch: RayBatch, geometry: Geometry, generator: torch.Generator) -> Pass:
        """Return one estimate of the batch from K points per ray (paper Eqs. 9 and 11)."""
        config, model = self.config, self.model
        weights = geometry.weights.detach()
        num_rays, num_samples = weights.shape
        if config.points == "depth":
            draw: PointDraw = median_point(weights)
        else:
            u = torch.rand(num_rays, config.points_per_ray, generator=generator, device=weights.device)
            draw = draw_points(weights, u)
        row = num_samples * torch.arange(num_rays, device=weights.device)[:, None]
        index = (draw.index + row).reshape(-1)
        repeats = draw.index.shape[-1]
        points = ShadingPoints(
            positions=geometry.samples.positions.reshape(-1, 3)[index],
            normal=geometry.normal[index],
            omega_o=-batch.rays.directions.repeat_interleave(repeats, dim=0),
            light_index=batch.light_index.repeat_interleave(repeats),
        )
        materials = model.materials(points.positions)
        mixture = None
        if config.estimator.sampler == "vmf":
            mixture = model.light_sampler(points.positions, points.light_index)
        estimate = control_variate(
            points,
            materials,
            nerf=model.nerf_source(generator),
            fast=model.fast_source(),
            environment=model.environment,
            mixture=mixture,
            limits=model.limits,
            config=config.estimator,
            generator=generator,
        )
        picture = (draw.weight[..., None] * estimate.rgb.reshape(num_rays, repeats, 3)).sum(dim=1)
        return Pass(picture, estimate, points, materials, mixture, index)

    def _cache_terms(
        self,
        batch: RayBatch,
        geometry: Geometry,
        cache: Tensor,
        generator: torch.Generator,
        with_normals: bool,
    ) -> dict[str, Tensor]:
        """Return the losses that keep the NeRF cache true to the photographs."""
        config = self.config
        background = torch.ones_like(batch.colour)
        if config.random_background:
            background = torch.rand(background.shape, generator=generator, device=background.device)
        opacity, weight = geometry.opacity, torch.ones_like(geometry.opacity)
        seen = cache + (1.0 - opacity)[:, None] * background
        terms = {"colour": config.cache_weight * cache_photometric(seen, batch.over(background), weight)}
        if config.mask_weight:
            terms["mask"] = config.mask_weight * mask_loss(opacity, batch.coverage, weight)
        terms |= shape_terms(
            batch,
            geometry,
            normal_weight=config.normal_weight,
            normal_weight_gradient=config.normal_weight_gradient,
            orientation_weight=config.orientation_weight if with_normals else 0.0,
            distortion_weight=config.distortion_weight,
        )
        if config.grid_decay:
            tables = (self.model.nerf.density.grid, self.model.materials.grid, self.model.light_sampler.grid)
            decay = torch.stack([grid.table.square().mean() for grid in tables]).sum()
            terms["grid_decay"] = 0.5 * config.grid_decay * decay
        return terms

    def _physical_terms(self, batch: RayBatch, cache: Tensor, first: Pass, second: Pass) -> dict[str, Tensor]:
        """Return the photometric loss of the physically based pictures over black."""
        covered = (batch.coverage > 0.0).to(cache.dtype)
        wanted = batch.colour * batch.coverage[:, None]
        loss = physical_photometric(wanted, first.picture, second.picture, cache, covered)
        if self.config.symmetric:
            loss = 0.5 * (loss + physical_photometric(wanted, second.picture, first.picture, cache, covered))
        return {"physical": self.config.physical_weight * loss}

    def _consistency_terms(self, batch: RayBatch, geometry: Geometry, first: Pass) -> dict[str, Tensor]:
        """Return the losses that move the cache's heads towards the physical estimates."""
        weight = self.config.consistency_weight
        if not weight or not self.config.cache_weight:
            return {}
        points = first.points
        heads = self.model.nerf.appearance(
            points.positions,
            geometry.hidden[first.index].detach(),
            points.normal.detach(),
            points.omega_o,
            points.light_index,
        )
        covered = self._covered(batch, points)
        estimate = first.estimate
        pairs = {
            "diffuse": (heads.diffuse, estimate.diffuse),
            "specular": (heads.specular, estimate.specular),
            "irradiance": (heads.irradiance, estimate.irradiance),
        }
        return {
            f"consistency_{name}": weight * consistency(head, physical, covered)
            for name, (head, physical) in pairs.items()
        }

    def _material_terms(
        self,
        batch: RayBatch,
        geometry: Geometry,
        appearance: Appearance,
        first: Pass,
        generator: torch.Generator,
    ) -> dict[str, Tensor]:
        """Return the priors on materials and light."""
        config, points = self.config, first.points
        terms = {}
        if config.smoothness_weight:
            shape, device = points.positions.shape, points.positions.device
            step = config.smoothness_step * torch.randn(shape, generator=generator, device=device)
            nearby = points.positions + step
            with torch.no_grad():
                hidden = self.model.nerf.density(nearby).hidden
                moved = self.model.nerf.appearance(
                    nearby, hidden, points.normal, points.omega_o, points.light_index
                )
                guess = pseudo_albedo(appearance.diffuse[first.index], appearance.irradiance[first.index])
                guess_nearby = pseudo_albedo(moved.diffuse, moved.irradiance)
            terms["smoothness"] = config.smoothness_weight * smoothness(
                first.materials,
                self.model.materials(nearby),
                guess,
                guess_nearby,
                self._covered(batch, points),
            )
        if config.grey_weight:
            device = points.positions.device
            directions = torch.randn(256, 3, generator=generator, device=device)
            directions = torch.nn.functional.normalize(directions, dim=-1)
            lights = len(self.model.domain.lights)
            index = torch.randint(lights, (256,), generator=generator, device=device)
            sky = self.model.environment(directions, index)
            terms["grey"] = config.grey_weight * (sky - sky.mean(dim=-1, keepdim=True)).abs().mean()
        return terms

    def _secondary_terms(self, first: Pass) -> dict[str, Tensor]:
        """Return the losses that train the fast cache and the light sampler on the exact rays."""
        exact = first.estimate.exact
        terms: dict[str, Tensor] = {}
        if exact is None:
            return terms
        if exact.fast is not None:
            limits = self.model.limits
            radius = self.model.domain.contraction_radius
            inside = (exact.rays.origins.norm(dim=-1) < radius).to(exact.nerf.opacity.dtype)
            terms["fast"] = fast_cache_loss(exact.fast, exact.nerf, inside, limits)
        if first.mixture is not None:
            terms["sampler"] = light_sampler_loss(first.mixture, exact)
        return terms

    def _covered(self, batch: RayBatch, points: ShadingPoints) -> Tensor:
        repeats = len(points.positions) // len(batch)
        return (batch.coverage > 0.0).repeat_interleave(repeats).to(points.positions.dtype)
