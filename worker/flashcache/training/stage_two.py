"""Stage two: materials, light, fast cache and sampler learn together with the NeRF cache (supplement 2.4).

Names: pass A and pass B are two independent estimates of the same pixels; with the same samples in both,
the squared error would gain the estimator's variance (supplement Eq. 2).
"""

import torch
from torch import Tensor

from flashcache.config import StageTwoConfig
from flashcache.data.ray_batches import RayBatch, TrainingPixels
from flashcache.physical.model import InverseModel
from flashcache.randomness import generator_for
from flashcache.training.distil import Distillation
from flashcache.training.joint_losses import (
    Terms,
    cache_terms,
    consistency_terms,
    covered,
    decay_terms,
    environment_terms,
    material_terms,
    metalness_terms,
    physical_loss,
    secondary_terms,
)
from flashcache.training.optimiser import (
    Rates,
    StepRecord,
    build_optimiser,
    parameter_groups,
    set_rates,
    take_step,
)
from flashcache.training.parts import Parts
from flashcache.training.passes import shade
from flashcache.training.schedule import rate_factor
from flashcache.training.stage_one import masked_psnr, mean_terms, numbers
from flashcache.volume.quadrature import composite

STAGE = "joint"


class StageTwo:
    """The state of stage two; call `step` until `finished`."""

    def __init__(
        self, model: InverseModel, pixels: TrainingPixels, config: StageTwoConfig, *, seed: int
    ) -> None:
        self.model, self.pixels, self.config, self.seed = model, pixels, config, seed
        light = Rates(grid=config.environment_rate, network=config.environment_rate)
        groups = [
            (model.materials, config.material_rates),
            (model.environment, light),
            (model.fast, config.fast_rates),
            (model.light_sampler, config.fast_rates),
            (model.nerf.density, config.cache_rates),
            (model.nerf.normals, config.cache_rates),
            (model.nerf.appearance, config.cache_rates),
        ]
        model.nerf.requires_grad_(True)
        model.nerf.proposals.requires_grad_(False)
        self.optimiser = build_optimiser(parameter_groups(groups))
        self.parts = Parts(model, lambda whole: whole, config.num_rays)
        self.distillation: Distillation | None = None
        self.steps_done = 0
        self.num_skipped = 0

    @property
    def num_steps(self) -> int:
        """Number of joint steps, plus the later ones in which only the fast cache trains."""
        return self.config.num_steps + self.config.distil.num_steps

    @property
    def finished(self) -> bool:
        """Whether all steps have been taken."""
        return self.steps_done >= self.num_steps

    def step(self) -> StepRecord:
        """Take one training step."""
        config, step = self.config, self.steps_done
        if step >= config.num_steps:
            return self._distil(step - config.num_steps)
        factor = rate_factor(step, config.num_steps, 0, config.final_rate, config.decay_from)
        set_rates(self.optimiser, factor)
        self.optimiser.zero_grad(set_to_none=False)
        batch = self.draw()

        def loss_of(model: InverseModel, part: int) -> tuple[Tensor, tuple[dict[str, float], Tensor]]:
            terms, picture = self.losses(model, self.parts.of(batch, part), part)
            return torch.stack(list(terms.values())).sum(), (numbers(terms), picture.detach())

        found = self.parts.differentiate(loss_of)
        applied = take_step(self.optimiser)
        self.steps_done += 1
        self.num_skipped += not applied
        terms = mean_terms([of_part for of_part, _ in found])
        return StepRecord(
            step=self.steps_done,
            num_steps=self.num_steps,
            loss=sum(terms.values()),
            psnr=masked_psnr(torch.cat([picture for _, picture in found]), batch),
            terms=terms,
            skipped=not applied,
        )

    def _distil(self, step: int) -> StepRecord:
        """Take one of the last steps, in which only the fast cache trains."""
        config = self.config.distil
        if self.distillation is None:
            self.distillation = Distillation(self.model, self.pixels, config, seed=self.seed)
        factor = rate_factor(step, config.num_steps, 0, config.final_rate, config.decay_from)
        set_rates(self.optimiser, factor, self.model.fast)
        self.optimiser.zero_grad(set_to_none=False)
        loss = self.distillation.differentiate(step)
        applied = take_step(self.optimiser)
        self.steps_done += 1
        self.num_skipped += not applied
        return StepRecord(
            step=self.steps_done,
            num_steps=self.num_steps,
            loss=loss,
            psnr=0.0,
            terms={"fast": loss},
            skipped=not applied,
        )

    def draw(self) -> RayBatch:
        """Return the batch of the next step."""
        generator = generator_for(self.seed, STAGE, self.steps_done, "rays", self.pixels.device)
        return self.pixels.draw(self.config.num_rays, generator)

    def losses(self, model: InverseModel, batch: RayBatch, part: int = 0) -> tuple[Terms, Tensor]:
        """Return the weighted losses of a part of the next step's batch by name, and its physical picture.

        `model` is the stage's own, or a twin of it. The picture is over black.
        """
        config, step = self.config, self.steps_done

        def generator_of(purpose: str) -> torch.Generator:
            name = f"{purpose} {part}"
            return generator_for(self.seed, STAGE, step, name, self.pixels.device)

        generator = generator_of("part")
        with_normals = config.normal_weight > 0.0 and step % config.normal_every == 0
        geometry = model.nerf.trace(
            batch.rays,
            exponent=config.proposal_exponent,
            generator=generator,
            num_derived=round(config.normal_rays * len(batch)) if with_normals else 0,
        )
        appearance = model.nerf.outgoing(geometry, batch.rays.directions, batch.light_index)
        cache = composite(geometry.weights, appearance.radiance)
        terms = cache_terms(model, config, batch, geometry, cache, generator, with_normals=with_normals)
        terms |= decay_terms(model, config)
        first = shade(model, config, batch, geometry, generator_of("pass A"))
        picture = first.picture
        with_second = step >= config.warmup_steps
        if with_second:
            with torch.set_grad_enabled(config.symmetric):
                own = generator_of("pass B")
                second = shade(model, config, batch, geometry, own, supervise=False).picture
            picture = 0.5 * (first.picture + second)
            terms["physical"] = physical_loss(config, batch, cache, first.picture, second)
            if config.symmetric:
                mirrored = physical_loss(config, batch, cache, second, first.picture)
                terms["physical"] = terms["physical"] + mirrored
            if config.consistency_weight:
                points = first.points
                terms |= consistency_terms(
                    model,
                    points,
                    geometry.hidden[first.index],
                    first.estimate,
                    covered(batch, points),
                    config.consistency_weight,
                )
            terms |= material_terms(model, config, batch, appearance, first, generator)
            terms |= environment_terms(model, config, generator)
        terms |= metalness_terms(
            model, config, batch, geometry, first, generator, warming_up=step < config.warmup_steps
        )
        terms |= secondary_terms(model, config, first)
        return terms, picture

    def scale(self) -> dict[str, float]:
        """Return the mean radiance of each light and the mean albedo on the surface.

        The photographs determine their product but not their ratio: a steady drift of the ratio late in
        training shows that the priors no longer constrain it.
        """
        generator = generator_for(self.seed, STAGE, self.steps_done, "scale", self.pixels.device)
        with torch.no_grad():
            batch = self.pixels.draw(256, generator)
            geometry = self.model.nerf.trace(batch.rays, generator=None)
            albedo = self.model.materials(geometry.samples.positions.reshape(-1, 3)).albedo
            seen = composite(geometry.weights, albedo).sum(dim=0) / geometry.weights.sum().clamp_min(1e-6)
            found = {"albedo_mean": float(seen.mean())}
            for index, light in enumerate(self.model.domain.lights):
                image = self.model.environment.image(16, index)
                up = torch.linspace(0.0, torch.pi, 33, device=image.device)[1::2].sin()[:, None, None]
                found[f"environment_mean_{light}"] = float((image * up).mean() / up.mean())
        return found
