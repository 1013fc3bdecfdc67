"""Stage one: the NeRF cache learns to reproduce the photographs (supplement 2.4)."""

import math
from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.caches.nerf_cache import Geometry
from flashcache.color import srgb_from_linear
from flashcache.config import StageOneConfig
from flashcache.data.ray_batches import RayBatch, TrainingPixels
from flashcache.losses.grid_decay import grid_decay
from flashcache.losses.normals import normal_consistency, orientation
from flashcache.losses.photometric import cache_photometric, carving, mask_loss
from flashcache.losses.proposal import distortion, interlevel
from flashcache.losses.shape import emptiness, flatness, recession, tangent_steps
from flashcache.physical.model import InverseModel
from flashcache.randomness import generator_for
from flashcache.training.occupied import keep_filled
from flashcache.training.optimiser import (
    StepRecord,
    build_optimiser,
    parameter_groups,
    set_rates,
    take_step,
)
from flashcache.training.parts import Parts
from flashcache.training.schedule import proposal_exponent, ramp, rate_factor
from flashcache.volume.proposal_sampling import midpoints
from flashcache.volume.quadrature import composite, draw_points

STAGE = "cache"


class StageOne:
    """The state of stage one; call `step` until `finished`."""

    def __init__(
        self, model: InverseModel, pixels: TrainingPixels, config: StageOneConfig, *, seed: int
    ) -> None:
        self.model, self.pixels, self.config, self.seed = model, pixels, config, seed
        self.optimiser = build_optimiser(parameter_groups([(model.nerf, config.rates)]))
        self.parts = Parts(model, lambda whole: whole.nerf, config.num_rays)
        scene = pixels.scene
        self.box = scene.bounds_min, scene.bounds_max
        self.half_diagonal = 0.5 * math.dist(*self.box)
        occupancy = model.nerf.occupancy
        self.cells = torch.empty(0, 3) if occupancy is None else occupancy.cells.nonzero()
        self.steps_done = 0
        self.num_skipped = 0

    @property
    def finished(self) -> bool:
        """Whether all steps have been taken."""
        return self.steps_done >= self.config.num_steps

    def step(self) -> StepRecord:
        """Take one training step; after the last one, what is empty is ruled out."""
        config, step = self.config, self.steps_done
        generator = generator_for(self.seed, STAGE, step, "rays", self.pixels.device)
        batch = self.pixels.draw(config.num_rays, generator)
        linear = config.decay == "linear"
        factor = rate_factor(step, config.num_steps, config.warmup_steps, config.final_rate, linear=linear)
        set_rates(self.optimiser, factor)
        self.optimiser.zero_grad(set_to_none=False)
        found = self.parts.differentiate(lambda model, part: self._losses(model, batch, part))
        applied = take_step(self.optimiser)
        self.steps_done += 1
        self.num_skipped += not applied
        if self.finished:
            keep_filled(self.model.nerf)
        terms = mean_terms([of_part for of_part, _ in found])
        return StepRecord(
            step=self.steps_done,
            num_steps=config.num_steps,
            loss=sum(terms.values()),
            psnr=masked_psnr(torch.cat([picture for _, picture in found]), batch),
            terms=terms,
            skipped=not applied,
        )

    def _losses(
        self, model: InverseModel, batch: RayBatch, part: int
    ) -> tuple[Tensor, tuple[dict[str, float], Tensor]]:
        """Return the loss of one part of a batch, its terms, and its premultiplied picture."""
        config, step = self.config, self.steps_done
        fraction = step / config.num_steps
        generator = generator_for(self.seed, STAGE, step, f"part {part}", self.pixels.device)
        batch = self.parts.of(batch, part)
        normal_weight = self._normal_weight(fraction)
        with_normals = normal_weight > 0.0 and step % config.normal_every == 0
        geometry = model.nerf.trace(
            batch.rays,
            exponent=proposal_exponent(fraction, config.proposal_exponent),
            generator=generator,
            num_derived=round(config.normal_rays * len(batch)) if with_normals else 0,
        )
        terms, picture = self._picture_terms(model, batch, geometry, fraction, generator)
        terms |= proposal_terms(geometry, config.interlevel_weight, config.interlevel_blur)
        terms |= shape_terms(
            batch,
            geometry,
            normal_weight=normal_weight,
            normal_weight_gradient=config.normal_weight_gradient,
            orientation_weight=config.orientation_weight if with_normals else 0.0,
            orientation_derived=config.orientation_derived,
            distortion_weight=config.distortion_weight if fraction >= config.distortion_from else 0.0,
        )
        terms |= self._shape_prior_terms(model, batch, geometry, fraction, generator)
        if config.grid_decay:
            densities = (*model.nerf.proposals, model.nerf.density)
            terms["grid_decay"] = config.grid_decay * grid_decay(density.grid for density in densities)
        loss = torch.stack(list(terms.values())).sum()
        return loss, (numbers(terms), picture.detach())

    def _picture_terms(
        self,
        model: InverseModel,
        batch: RayBatch,
        geometry: Geometry,
        fraction: float,
        generator: torch.Generator,
    ) -> tuple[dict[str, Tensor], Tensor]:
        """Return the losses on the picture, and the premultiplied picture itself."""
        config = self.config
        appearance = model.nerf.outgoing(
            geometry,
            batch.rays.directions,
            batch.light_index,
            with_specular=fraction >= config.specular_from,
        )
        picture = composite(geometry.weights, appearance.radiance)
        opacity = geometry.opacity
        if fraction < config.carving_share:
            loss = carving(picture, opacity, batch.colour, batch.coverage, batch.clipped)
            return {"carving": loss}, picture
        background = torch.ones_like(batch.colour)
        if config.random_background:
            background = torch.rand(batch.colour.shape, generator=generator, device=batch.colour.device)
        seen = picture + (1.0 - opacity)[:, None] * background
        terms = {"colour": cache_photometric(seen, batch.over(background), batch.clipped)}
        if config.mask_weight:
            terms["mask"] = config.mask_weight * mask_loss(opacity, batch.coverage)
        return terms, picture

    def _shape_prior_terms(
        self,
        model: InverseModel,
        batch: RayBatch,
        geometry: Geometry,
        fraction: float,
        generator: torch.Generator,
    ) -> dict[str, Tensor]:
        """Return the priors on shape that have a weight now (decision 0014)."""
        config, terms = self.config.shape_prior, {}
        if config.recession_weight and fraction < self.config.carving_share:
            inside = midpoints(geometry.samples.distances) - batch.rays.near[:, None]
            terms["recession"] = config.recession_weight * recession(
                geometry.weights, inside / self.half_diagonal, batch.coverage
            )
        rise = ramp(fraction, *self.config.normal_ramp)
        if config.flatness_weight and rise > 0.0:
            terms["flatness"] = (
                config.flatness_weight * rise * self._flatness(model, batch, geometry, generator)
            )
        if config.emptiness_weight:
            points = self._anywhere(model, config.emptiness_points // self.parts.count, generator)
            empty = emptiness(model.nerf.density.density(points), config.emptiness_step * self.half_diagonal)
            terms["emptiness"] = config.emptiness_weight * empty
        return terms

    def _anywhere(
        self, model: InverseModel, count: int, generator: torch.Generator
    ) -> Float[Tensor, "points 3"]:
        """Return random points of the space in which the model may hold something."""
        device, occupancy = self.pixels.device, model.nerf.occupancy
        u = torch.rand(count, 3, generator=generator, device=device)
        if occupancy is None:
            low, high = (torch.tensor(corner, device=device) for corner in self.box)
            return low + u * (high - low)
        index = torch.randint(len(self.cells), (count,), generator=generator, device=device)
        return occupancy.low + (self.cells[index] + u) * occupancy.size

    def _flatness(
        self, model: InverseModel, batch: RayBatch, geometry: Geometry, generator: torch.Generator
    ) -> Tensor:
        config = self.config.shape_prior
        count = min(config.flatness_rays // self.parts.count, len(batch))
        weights = geometry.weights[:count].detach()
        u = torch.rand(count, 1, generator=generator, device=weights.device)
        row = weights.shape[-1] * torch.arange(count, device=weights.device)
        index = draw_points(weights, u).index[:, 0] + row
        normal = geometry.normal[index]
        nearby = geometry.samples.positions.reshape(-1, 3)[index] + tangent_steps(
            normal, config.flatness_step * self.half_diagonal, generator
        )
        moved = model.nerf.normals(nearby, model.nerf.density(nearby).hidden)
        seen = weights.sum(dim=-1) * (batch.coverage[:count] > 0.5)
        return flatness(normal, moved, seen)

    def _normal_weight(self, fraction: float) -> float:
        config = self.config
        rise = ramp(fraction, *config.normal_ramp)
        return config.normal_start + (config.normal_weight - config.normal_start) * rise


def numbers(terms: Mapping[str, Tensor]) -> dict[str, float]:
    """Return the values of loss terms."""
    return {name: float(value.detach()) for name, value in terms.items()}


def mean_terms(parts: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the mean of the parts' loss terms, by name."""
    return {name: sum(part[name] for part in parts) / len(parts) for name in parts[0]}


def proposal_terms(geometry: Geometry, weight: float, blur: tuple[float, float]) -> dict[str, Tensor]:
    """Return the interlevel losses, one per proposal round."""
    edges, final = geometry.samples.edges, geometry.weights.detach()
    return {
        f"interlevel_{level}": weight * interlevel(proposal, edges, final, half_width)
        for level, (proposal, half_width) in enumerate(zip(geometry.samples.proposals, blur, strict=True))
    }


def shape_terms(
    batch: RayBatch,
    geometry: Geometry,
    *,
    normal_weight: float,
    normal_weight_gradient: float,
    orientation_weight: float,
    orientation_derived: float,
    distortion_weight: float,
) -> dict[str, Tensor]:
    """Return the losses on normals and on the spread of weights that have a weight above zero."""
    terms = {}
    if geometry.derived is not None:
        num_samples = geometry.weights.shape[-1]
        num_rays = len(geometry.derived) // num_samples
        weights, points = geometry.weights[:num_rays], slice(0, num_rays * num_samples)
        terms["normals"] = normal_weight * normal_consistency(
            weights, geometry.normal[points], geometry.derived, normal_weight_gradient
        )
        if orientation_weight:
            directions = batch.rays.directions[:num_rays]
            backwards = orientation(weights, geometry.normal[points], directions)
            if orientation_derived:
                backwards = backwards + orientation_derived * orientation(
                    weights, geometry.derived, directions
                )
            terms["orientation"] = orientation_weight * backwards
    if distortion_weight:
        terms["distortion"] = distortion_weight * distortion(geometry.samples, geometry.weights)
    return terms


def masked_psnr(premultiplied: Tensor, batch: RayBatch) -> float:
    """Return the PSNR [dB] of a batch on sRGB values, over pixels that the object covers."""
    covered = batch.coverage > 0.5
    if not bool(covered.any()):
        return 0.0
    wanted = (batch.colour * batch.coverage[:, None])[covered]
    difference = srgb_from_linear(premultiplied[covered].clamp(0.0, 1.0)) - srgb_from_linear(wanted)
    return float(-10.0 * torch.log10(difference.square().mean().clamp_min(1e-10)))
