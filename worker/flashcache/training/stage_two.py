"""Stage two: materials, light, fast cache and sampler learn together with the NeRF cache (supplement 2.4).

Names: pass A and pass B are two independent estimates of the same pixels; with the same samples in both,
the squared error would gain the estimator's variance (supplement Eq. 2).
"""

import functools
from collections.abc import Callable

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
    apply_gradients,
    build_optimiser,
    parameter_groups,
    set_rates,
    take_step,
)
from flashcache.training.passes import shade
from flashcache.training.schedule import rate_factor
from flashcache.training.second_pass import SecondPass, half_the_threads
from flashcache.training.stage_one import masked_psnr
from flashcache.volume.quadrature import composite

STAGE = "joint"


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
            (model.nerf.density, config.cache_rates),
            (model.nerf.normals, config.cache_rates),
            (model.nerf.appearance, config.cache_rates),
        ]
        model.nerf.requires_grad_(True)
        model.nerf.proposals.requires_grad_(False)
        self.optimiser = build_optimiser(parameter_groups(parts))
        self.second = SecondPass(model, config)
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
        with half_the_threads(self.second.parallel and step >= config.warmup_steps):
            terms, picture, batch, collect = self.losses()
            loss = torch.stack(list(terms.values())).sum()
            applied = apply_gradients(self.optimiser, loss, collect)
        self.steps_done += 1
        self.num_skipped += not applied
        return StepRecord(
            step=self.steps_done,
            num_steps=self.num_steps,
            loss=float(loss.detach()),
            psnr=masked_psnr(picture.detach(), batch),
            terms={name: float(value.detach()) for name, value in terms.items()},
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

    def losses(self) -> tuple[Terms, Tensor, RayBatch, Callable[[], None] | None]:
        """Return the weighted losses of the next step by name, its physical picture over black, its batch.

        The last result adds the gradients that reach the model through pass B, where it has any.
        """
        config, model, step = self.config, self.model, self.steps_done
        device = self.pixels.device
        generator = generator_for(self.seed, STAGE, step, "rays", device)
        batch = self.pixels.draw(config.num_rays, generator)
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
        with_second = step >= config.warmup_steps
        if with_second:
            self.second.start(batch, geometry, generator_for(self.seed, STAGE, step, "pass B", device))
        first = shade(model, config, batch, geometry, generator_for(self.seed, STAGE, step, "pass A", device))
        picture, collect = first.picture, None
        if with_second:
            second = self.second.result().picture
            picture = 0.5 * (first.picture + second.detach())
            terms["physical"] = physical_loss(config, batch, cache, first.picture, second)
            if config.symmetric:
                leaf = second.detach().requires_grad_()
                other = physical_loss(config, batch, cache, leaf, first.picture)
                self.second.differentiate(second, *torch.autograd.grad(other, leaf))
                terms["physical"] = terms["physical"] + other.detach()
                collect = functools.partial(self.second.collect, geometry)
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
        return terms, picture, batch, collect

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
