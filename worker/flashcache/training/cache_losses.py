"""The losses of stage one: pictures, masks, proposals, normals and the priors on shape."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.caches.nerf_cache import Geometry
from flashcache.config import StageOneConfig
from flashcache.data.ray_batches import RayBatch
from flashcache.losses.normals import normal_consistency, orientation
from flashcache.losses.photometric import cache_photometric, carving, mask_loss
from flashcache.losses.priors import grid_decay
from flashcache.losses.proposal import distortion, interlevel
from flashcache.losses.shape import emptiness, flatness, recession, tangent_steps
from flashcache.parallel.ranks import own_count, whole_count
from flashcache.physical.model import InverseModel
from flashcache.randomness import generator_for, integers, uniform
from flashcache.rows import shapes_are_fixed
from flashcache.training.optimiser import Number
from flashcache.training.parts import numbers
from flashcache.training.schedule import proposal_exponent, ramp
from flashcache.volume.proposal_sampling import midpoints
from flashcache.volume.quadrature import composite, draw_points

STAGE = "cache"

Corner = tuple[float, float, float]
Found = tuple[dict[str, Number], Tensor]
"""The values of the terms, and the premultiplied picture [rays, 3]."""


class CachePhase(NamedTuple):
    """What is computed in a step of stage one."""

    with_normals: bool
    with_specular: bool
    carves: bool
    with_distortion: bool
    with_flatness: bool


class CacheNumbers(NamedTuple):
    """Numbers that change from step to step within a phase."""

    exponent: Number
    """Of the proposal weights."""
    normal_weight: Number
    flatness_weight: Number


@dataclass
class CacheLosses:
    """The losses of a part of a batch in stage one; `flashcache.training.parts.Losses`."""

    config: StageOneConfig
    seed: int
    box: tuple[Corner, Corner]
    """Corners of the scene, scene units."""
    _known_box: Tensor | None = field(default=None, init=False)
    _known_cells: Tensor | None = field(default=None, init=False)
    _held: CacheNumbers | None = field(default=None, init=False)
    """The numbers of the next step with fixed shapes, on the device."""

    def __call__(
        self, model: InverseModel, batch: RayBatch, step: int, part: int, count: int
    ) -> tuple[Tensor, Found]:
        """Return the loss of one part of a batch, its terms, and its picture."""
        config, phase = self.config, self.phase(step)
        numbers_now = self._held if shapes_are_fixed() and self._held is not None else self.numbers(step)
        generator = generator_for(self.seed, STAGE, step, f"part {part}", batch.colour.device)
        num_derived = own_count(round(config.normal_rays * whole_count(len(batch))))
        geometry = model.nerf.trace(
            batch.rays,
            exponent=numbers_now.exponent,
            generator=generator,
            num_derived=num_derived if phase.with_normals else 0,
        )
        terms, picture = self._picture_terms(model, batch, geometry, phase, generator)
        terms |= proposal_terms(geometry, config.interlevel_weight, config.interlevel_blur)
        terms |= shape_terms(
            batch,
            geometry,
            normal_weight=numbers_now.normal_weight,
            normal_weight_gradient=config.normal_weight_gradient,
            orientation_weight=config.orientation_weight if phase.with_normals else 0.0,
            orientation_derived=config.orientation_derived,
            distortion_weight=config.distortion_weight if phase.with_distortion else 0.0,
        )
        flatness_weight = numbers_now.flatness_weight if phase.with_flatness else None
        terms |= self._shape_prior_terms(
            model, batch, geometry, phase.carves, flatness_weight, count, generator
        )
        if config.grid_decay:
            densities = (*model.nerf.proposals, model.nerf.density)
            terms["grid_decay"] = config.grid_decay * grid_decay(density.grid for density in densities)
        loss = torch.stack(list(terms.values())).sum()
        return loss, (numbers(terms), picture.detach())

    def phase(self, step: int) -> CachePhase:
        """Return what is computed in a step."""
        config, fraction = self.config, step / self.config.num_steps
        return CachePhase(
            with_normals=bool(self.numbers(step).normal_weight > 0.0) and step % config.normal_every == 0,
            with_specular=fraction >= config.specular_from,
            carves=fraction < config.carving_share,
            with_distortion=fraction >= config.distortion_from,
            with_flatness=bool(self.numbers(step).flatness_weight > 0.0),
        )

    def numbers(self, step: int) -> CacheNumbers:
        """Return the numbers that change from step to step."""
        config, fraction = self.config, step / self.config.num_steps
        rise = ramp(fraction, *config.normal_ramp)
        return CacheNumbers(
            exponent=proposal_exponent(fraction, config.proposal_exponent),
            normal_weight=config.normal_start + (config.normal_weight - config.normal_start) * rise,
            flatness_weight=config.shape_prior.flatness_weight * rise,
        )

    def prepare(self, step: int, device: torch.device) -> None:
        """Put the numbers of a step on the device, where steps with fixed shapes find them."""
        if self._held is None:
            self._held = CacheNumbers(*(torch.zeros((), device=device) for _ in CacheNumbers._fields))
        for place, value in zip(self._held, self.numbers(step), strict=True):
            torch.as_tensor(place).fill_(value)

    def _picture_terms(
        self,
        model: InverseModel,
        batch: RayBatch,
        geometry: Geometry,
        phase: CachePhase,
        generator: torch.Generator,
    ) -> tuple[dict[str, Tensor], Tensor]:
        """Return the losses on the picture, and the premultiplied picture itself."""
        config = self.config
        appearance = model.nerf.outgoing(
            geometry,
            batch.rays.directions,
            batch.light_index,
            with_specular=phase.with_specular,
        )
        picture = composite(geometry.weights, appearance.radiance)
        opacity = geometry.opacity
        if phase.carves:
            loss = carving(picture, opacity, batch.colour, batch.coverage, batch.clipped)
            return {"carving": loss}, picture
        background = torch.ones_like(batch.colour)
        if config.random_background:
            background = uniform(batch.colour.shape, generator, batch.colour.device)
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
        carves: bool,
        flatness_weight: Number | None,
        count: int,
        generator: torch.Generator,
    ) -> dict[str, Tensor]:
        """Return the priors on shape that have a weight now (decision 0014)."""
        config, terms = self.config.shape_prior, {}
        if config.recession_weight and carves:
            inside = midpoints(geometry.samples.distances) - batch.rays.near[:, None]
            terms["recession"] = config.recession_weight * recession(
                geometry.weights, inside / self._half_diagonal, batch.coverage
            )
        if flatness_weight is not None:
            terms["flatness"] = flatness_weight * self._flatness(model, batch, geometry, count, generator)
        if config.emptiness_weight:
            points = self.anywhere(model, own_count(config.emptiness_points // count), generator)
            empty = emptiness(model.nerf.density.density(points), config.emptiness_step * self._half_diagonal)
            terms["emptiness"] = config.emptiness_weight * empty
        return terms

    def anywhere(
        self, model: InverseModel, count: int, generator: torch.Generator
    ) -> Float[Tensor, "points 3"]:
        """Return random points of the space in which the model may hold something."""
        device, occupancy = generator.device, model.nerf.occupancy
        u = uniform((count, 3), generator, device)
        if occupancy is None:
            if self._known_box is None:
                self._known_box = torch.tensor(self.box, device=device)
            low, high = self._known_box
            return low + u * (high - low)
        cells = self._cells(model)
        index = integers(len(cells), count, generator, device)
        return occupancy.low + (cells[index] + u) * occupancy.size

    def _cells(self, model: InverseModel) -> Tensor:
        """Return the indices [cells, 3] of the occupied cells, which do not change during the stage."""
        if self._known_cells is None:
            assert model.nerf.occupancy is not None
            self._known_cells = model.nerf.occupancy.cells.nonzero()
        return self._known_cells

    @property
    def _half_diagonal(self) -> float:
        return 0.5 * math.dist(*self.box)

    def _flatness(
        self,
        model: InverseModel,
        batch: RayBatch,
        geometry: Geometry,
        parts: int,
        generator: torch.Generator,
    ) -> Tensor:
        config = self.config.shape_prior
        count = own_count(min(config.flatness_rays // parts, whole_count(len(batch))))
        weights = geometry.weights[:count].detach()
        u = uniform((count, 1), generator, weights.device)
        row = weights.shape[-1] * torch.arange(count, device=weights.device)
        index = draw_points(weights, u).index[:, 0] + row
        normal = geometry.normal[index]
        nearby = geometry.samples.positions.reshape(-1, 3)[index] + tangent_steps(
            normal, config.flatness_step * self._half_diagonal, generator
        )
        moved = model.nerf.normals(nearby, model.nerf.density(nearby).hidden)
        seen = weights.sum(dim=-1) * (batch.coverage[:count] > 0.5)
        return flatness(normal, moved, seen)


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
    normal_weight: Number,
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
